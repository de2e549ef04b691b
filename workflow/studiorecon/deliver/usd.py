# SPDX-License-Identifier: Apache-2.0
"""``deliver.usd``: writes the 4D scene as one OpenUSD stage, ``deliver/scene.usdc``, only on request.

z up, metres, one time code per frame. The room is a ``ParticleField3DGaussianSplat`` (OpenUSD 26.03), people are
``UsdSkel`` bodies in the colours of their Gaussians, objects are moving particle fields, cameras ``UsdGeom``'s.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.deliver.body_colours import body_colours
from studiorecon.deliver.finished import read_finished
from studiorecon.deliver.gltf import continuous_quaternions, srgb_to_linear
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import atomic_path
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import RigidObject
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Integer

# Width of every camera's film in UsdGeom's unit; only its ratio to the focal length matters.
_APERTURE = 36.0
_CLIPPING_M = 0.05, 1000.0
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def pxr() -> Any:
    """The library, imported late because it is rarely needed; raises UserError with a remedy if it cannot load."""
    try:
        import pxr
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdSkel, UsdVol, Vt  # noqa: F401

        if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
            raise ImportError("a schema for Gaussians needs 26.03 or later")
    except (ImportError, OSError) as error:
        raise UserError(
            f"deliver/scene.usdc is written by usd-core, which cannot be loaded ({error}); install the extra usd "
            "(uv run --extra usd, or pip install 'studiorecon[usd]'); the other files do not need it"
        ) from None
    return pxr


def add_gaussians(stage: Any, path: str, own: Gaussians, provenance: Integer[np.ndarray, " N"]) -> Any:
    """A prim of N Gaussians with ``primvars:provenance`` (0 measured, 1 inferred, 2 invented)."""
    usd = pxr()
    splat = usd.UsdVol.ParticleField3DGaussianSplat.Define(stage, path)
    scales_m = np.exp(own.log_scales)
    splat.CreatePositionsAttr(_vectors(own.means_m))
    splat.CreateOrientationsAttr(_quaternions(own.unit_quaternions))
    splat.CreateScalesAttr(_vectors(scales_m))
    splat.CreateOpacitiesAttr(usd.Vt.FloatArray.FromNumpy(own.opacities))
    splat.CreateRadianceSphericalHarmonicsDegreeAttr(own.sh_degree)
    splat.CreateRadianceSphericalHarmonicsCoefficientsAttr(_vectors(own.sh.reshape(own.count * own.sh.shape[1], 3)))
    if own.count:
        # Standard deviations within which other programs draw a Gaussian.
        reach_m = 3.0 * scales_m.max(axis=1, keepdims=True)
        splat.CreateExtentAttr(
            _vectors(np.stack([(own.means_m - reach_m).min(axis=0), (own.means_m + reach_m).max(axis=0)]))
        )
    shown = usd.UsdGeom.PrimvarsAPI(splat)
    names, vertex = usd.Sdf.ValueTypeNames, usd.UsdGeom.Tokens.vertex
    colour = shown.CreatePrimvar("displayColor", names.Color3fArray, vertex)
    colour.Set(_vectors(srgb_to_linear(0.5 + SH_C0 * own.sh[:, 0])))
    shown.CreatePrimvar("provenance", names.IntArray, vertex).Set(_whole(provenance))
    return splat


def add_body(stage: Any, path: str, person: Avatar) -> None:
    """The shaped T-pose with skeleton and motion, interpolated frames included, invisible while the person is away.

    All weights of every vertex are kept. UsdSkel cannot represent pose correctives of an SMPL file.
    """
    usd, body = pxr(), person.model
    root = usd.UsdSkel.Root.Define(stage, path)
    if not person.present.all():
        seen = root.CreateVisibilityAttr()
        for frame, there in enumerate(person.present):
            seen.Set(usd.UsdGeom.Tokens.inherited if there else usd.UsdGeom.Tokens.invisible, frame)
    rest_m = body.rest_joints(person.betas)
    names: list[str] = []
    for joint, parent in zip(body.names, body.parents):
        names.append(f"{names[parent]}/{joint}" if parent >= 0 else joint)
    offsets_m = rest_m - np.where(body.parents[:, None] >= 0, rest_m[np.maximum(body.parents, 0)], 0)
    skeleton = usd.UsdSkel.Skeleton.Define(stage, f"{path}/skeleton")
    skeleton.CreateJointsAttr(names)
    skeleton.CreateBindTransformsAttr(_places(rest_m))
    skeleton.CreateRestTransformsAttr(_places(offsets_m))
    motion = usd.UsdSkel.Animation.Define(stage, f"{path}/motion")
    motion.CreateJointsAttr(names)
    motion.CreateScalesAttr(usd.Vt.Vec3hArray([usd.Gf.Vec3h(1)] * len(names)))
    turns = continuous_quaternions(rotations.to_quaternion(rotations.exp(person.poses.reshape(person.frames, -1, 3))))
    places, turned = motion.CreateTranslationsAttr(), motion.CreateRotationsAttr()
    for frame in range(person.frames):
        offsets_m[0] = person.trans[frame]
        places.Set(_vectors(offsets_m), frame)
        turned.Set(_quaternions(turns[frame]), frame)
    mesh = usd.UsdGeom.Mesh.Define(stage, f"{path}/body")
    mesh.CreatePointsAttr(_vectors(body.rest_vertices(person.betas)))
    mesh.CreateFaceVertexCountsAttr(_whole(np.full(len(body.faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(_whole(body.faces.reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)
    colours = body_colours(person)
    if colours:
        mesh.CreateDisplayColorPrimvar(usd.UsdGeom.Tokens.vertex).Set(_vectors(srgb_to_linear(colours.rgb)))
        marks = usd.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "provenance", usd.Sdf.ValueTypeNames.IntArray, usd.UsdGeom.Tokens.vertex
        )
        marks.Set(_whole(colours.provenance))
    bones = max(int((body.weights > 0).sum(axis=1).max()), 1)
    strongest = np.argsort(-body.weights, axis=1, kind="stable")[:, :bones]
    shares = np.take_along_axis(body.weights, strongest, axis=1).astype(np.float32)
    binding = usd.UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, bones).Set(_whole(np.where(shares > 0, strongest, 0).reshape(-1)))
    binding.CreateJointWeightsPrimvar(False, bones).Set(usd.Vt.FloatArray.FromNumpy(shares.reshape(-1)))
    binding.CreateGeomBindTransformAttr(usd.Gf.Matrix4d(1))
    for prim in (root.GetPrim(), skeleton.GetPrim()):
        usd.UsdSkel.BindingAPI.Apply(prim).CreateAnimationSourceRel().SetTargets([motion.GetPath()])


def add_thing(stage: Any, path: str, thing: RigidObject) -> None:
    """An object at its position in every frame, invisible in frames in which its position is unknown."""
    usd = pxr()
    splat = add_gaussians(stage, path, thing.gaussians, thing.provenance)
    place, seen = splat.AddTransformOp(), splat.CreateVisibilityAttr()
    for frame in range(len(thing.centres_m)):
        there = bool(thing.present[frame])
        seen.Set(usd.UsdGeom.Tokens.inherited if there else usd.UsdGeom.Tokens.invisible, frame)
        if there:
            place.Set(usd.Gf.Matrix4d(thing.pose_at(frame).T.tolist()), frame)


def add_camera(stage: Any, path: str, camera: Camera) -> None:
    """A training camera: its pinhole with the principal point as an offset of the film."""
    usd, made = pxr(), pxr().UsdGeom.Camera.Define(stage, path)
    made.AddTransformOp().Set(usd.Gf.Matrix4d((camera.world_from_camera @ _OPENGL_FROM_OPENCV).T.tolist()))
    (width, height), (fx, fy), (cx, cy) = camera.wh, camera.focal_px, camera.principal_px
    focal = _APERTURE * fx / width
    made.CreateFocalLengthAttr(focal)
    made.CreateHorizontalApertureAttr(_APERTURE)
    made.CreateVerticalApertureAttr(focal * height / fy)
    made.CreateHorizontalApertureOffsetAttr(focal * (width - 2 * cx) / (2 * fx))
    made.CreateVerticalApertureOffsetAttr(focal * (2 * cy - height) / (2 * fy))
    made.CreateClippingRangeAttr(usd.Gf.Vec2f(*_CLIPPING_M))


def run(
    manifest: Path,
    model: Path,
    files: SceneFiles,
    stage: Written,
) -> None:
    """Write the ``stage`` (USD, binary) of the finished scene."""
    usd = pxr()
    finished = read_finished(manifest, model, files)
    with atomic_path(stage) as partial:
        partial.unlink(missing_ok=True)
        made = usd.Usd.Stage.CreateNew(str(partial))
        usd.UsdGeom.SetStageUpAxis(made, usd.UsdGeom.Tokens.z)
        usd.UsdGeom.SetStageMetersPerUnit(made, 1.0)
        made.SetTimeCodesPerSecond(finished.capture.fps)
        made.SetFramesPerSecond(finished.capture.fps)
        made.SetStartTimeCode(0)
        made.SetEndTimeCode(finished.capture.frames - 1)
        made.SetDefaultPrim(usd.UsdGeom.Xform.Define(made, "/scene").GetPrim())
        add_gaussians(made, "/scene/room", finished.room, finished.provenance)
        for person in finished.people:
            add_body(made, f"/scene/people/{person.person}", person)
        for thing in finished.things:
            add_thing(made, f"/scene/things/{thing.person}", thing)
        for index, camera in enumerate(finished.cameras):
            # A prim's name must be a word; usdview shows the user's name of the camera.
            path = f"/scene/cameras/camera{index}"
            add_camera(made, path, camera)
            made.GetPrimAtPath(path).SetDisplayName(camera.name)
        made.GetRootLayer().Save()
        del made
    say(f"scene.usdc: {finished.contents}, {stage.stat().st_size / 1e6:.1f} MB; opens in usdview: {stage}")


def _vectors(values: np.ndarray) -> Any:
    return pxr().Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _quaternions(wxyz: np.ndarray) -> Any:
    """Quaternions of the library, which stores the real part last."""
    return pxr().Vt.QuatfArray.FromNumpy(np.ascontiguousarray(wxyz[:, [1, 2, 3, 0]], np.float32))


def _whole(values: np.ndarray) -> Any:
    return pxr().Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def _places(points_m: np.ndarray) -> Any:
    """One transform per point that moves the origin to it."""
    gf = pxr().Gf
    return pxr().Vt.Matrix4dArray([gf.Matrix4d(1).SetTranslate(gf.Vec3d(*map(float, point))) for point in points_m])
