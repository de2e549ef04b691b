# SPDX-License-Identifier: Apache-2.0
"""The scene as a USD stage, read back by usd-core: its own skinning, its own cameras."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.hands import scale_hands
from studiorecon.body.model import BodyModel
from studiorecon.deliver import usd
from studiorecon.errors import UserError
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.rigid_object import RigidObject

from tests.made.scene import FPS, FRAMES, avatar, render_options, write_scene
from tests.made.steps import call

TAKEN = ("manifest", "model", "background", "provenance", "gaussians", "avatars", "body")


@pytest.fixture
def loads() -> None:
    try:
        usd.pxr()
    except UserError as refusal:
        pytest.skip(str(refusal))


def options(folder: Path, people: int) -> dict:
    given = render_options(folder, "orbit", people)
    return {name: given[name] for name in TAKEN} | {"objects": [], "stage": folder / "deliver/scene.usdc"}


@pytest.mark.usefixtures("loads")
def test_usd_core_skins_the_bodies_and_sees_through_the_cameras(tmp_path: Path, root: Path) -> None:
    from pxr import Usd, UsdGeom, UsdSkel

    cameras = write_scene(tmp_path, root, people=2, filmed=False)["training"]
    given = options(tmp_path, 2)
    call(usd.run, **given)
    written = given["stage"].read_bytes()
    call(usd.run, **given)
    assert given["stage"].read_bytes() == written, "the same scene, the same bytes"
    stage = Usd.Stage.Open(str(given["stage"]))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert (UsdGeom.GetStageMetersPerUnit(stage), stage.GetTimeCodesPerSecond()) == (1.0, FPS)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)

    room, own = stage.GetPrimAtPath("/scene/room"), read_ply(given["background"])
    assert room.GetTypeName() == "ParticleField3DGaussianSplat"
    read = {name: room.GetAttribute(name).Get() for name in ("positions", "scales", "opacities", "orientations")}
    assert np.asarray(read["positions"]) == pytest.approx(own.means_m)
    assert np.asarray(read["scales"]) == pytest.approx(np.exp(own.log_scales))
    assert np.asarray(read["opacities"]) == pytest.approx(scipy.special.expit(own.logit_opacities))
    assert [q.real for q in read["orientations"][:5]] == pytest.approx(own.quaternions[:5, 0])
    harmonics = np.asarray(room.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    assert harmonics.reshape(own.sh.shape) == pytest.approx(own.sh)
    assert room.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == own.sh_degree
    assert set(room.GetAttribute("primvars:provenance").Get()) == {0, 1, 2}

    model = BodyModel.load(given["body"])
    for k in range(2):
        person = read_avatar(given["gaussians"][k], given["avatars"][k], model)
        cache, prim = UsdSkel.Cache(), stage.GetPrimAtPath(f"/scene/people/p{k}")
        cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
        skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath(f"/scene/people/p{k}/skeleton")))
        mesh = stage.GetPrimAtPath(f"/scene/people/p{k}/body")
        expected = model.vertices(person.poses, person.betas, person.trans)
        for frame in (0, FRAMES - 1):
            points = UsdGeom.Mesh(mesh).GetPointsAttr().Get()
            assert cache.GetSkinningQuery(mesh).ComputeSkinnedPoints(
                skeleton.ComputeSkinningTransforms(frame), points, frame
            )
            assert np.abs(np.asarray(points) - expected[frame]).max() < 1e-4
        assert len(UsdGeom.Mesh(mesh).GetDisplayColorAttr().Get()) == model.vertex_count

    point = np.array([0.3, -0.2, 1.1])
    for index, camera in enumerate(cameras):
        prim = stage.GetPrimAtPath(f"/scene/cameras/camera{index}")
        assert prim.GetDisplayName() == camera.name
        frustum = UsdGeom.Camera(prim).GetCamera(0).frustum
        x, y, _ = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(tuple(point))
        seen = (x + 1) / 2 * camera.wh[0], (1 - y) / 2 * camera.wh[1]
        assert seen == pytest.approx(camera.project(point)[0], abs=1e-3)


@pytest.mark.usefixtures("loads")
def test_a_principal_point_off_the_middle_is_kept(root: Path, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    camera = write_scene(tmp_path, root, people=0, filmed=False)["training"][1]
    intrinsics = camera.intrinsics + np.array([[5.0, 0, 9], [0, -3, -7], [0, 0, 0]])
    shifted, stage = replace(camera, intrinsics=intrinsics), Usd.Stage.CreateInMemory()
    usd.add_camera(stage, "/c", shifted)
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/c")).GetCamera(0).frustum
    x, y, _ = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform((0.3, -0.2, 1.1))
    seen = (x + 1) / 2 * camera.wh[0], (1 - y) / 2 * camera.wh[1]
    assert seen == pytest.approx(shifted.project(np.array([0.3, -0.2, 1.1]))[0], abs=1e-3)


@pytest.mark.usefixtures("loads")
def test_a_thing_is_where_it_is_and_hidden_where_nobody_knows(tmp_path: Path, root: Path) -> None:
    from pxr import Usd, UsdGeom

    write_scene(tmp_path, root, people=0, filmed=False)
    own = read_ply(tmp_path / "background/scene.ply").take(np.arange(4))
    places, present = np.array([[1.0, 2, 3], [np.nan] * 3, [1, 2, 4]]), np.array([True, False, True])
    thing = RigidObject("o0", own, np.zeros(4, np.uint8), places, present, present, 0.1)
    stage = Usd.Stage.CreateInMemory()
    usd.add_thing(stage, "/o0", thing)
    imageable = UsdGeom.Xformable(stage.GetPrimAtPath("/o0"))
    assert [imageable.ComputeVisibility(t) for t in range(3)] == ["inherited", "invisible", "inherited"]
    assert tuple(imageable.GetLocalTransformation(2).ExtractTranslation()) == (1, 2, 4)


def test_without_usd_core_it_says_which_extra_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(UserError, match=r"scene\.usdc is written by usd-core.*extra usd.*other files do not"):
        usd.pxr()


@pytest.mark.usefixtures("loads")
def test_a_person_is_hidden_while_away(tmp_path: Path, root: Path) -> None:
    from pxr import Usd, UsdGeom

    write_scene(tmp_path, root, people=1, filmed=False)
    given = options(tmp_path, 1)
    person = read_avatar(given["gaussians"][0], given["avatars"][0], BodyModel.load(given["body"]))
    stage = Usd.Stage.CreateInMemory()
    usd.add_body(stage, "/always", person)
    usd.add_body(stage, "/late", replace(person, present=np.arange(FRAMES) >= 2))
    late, mesh = (UsdGeom.Imageable(stage.GetPrimAtPath(path)) for path in ("/late", "/late/body"))
    for one in (late, mesh):
        assert [one.ComputeVisibility(t) for t in range(4)] == ["invisible", "invisible", "inherited", "inherited"]
    assert not stage.GetPrimAtPath("/always").GetAttribute("visibility").HasAuthoredValue()


@pytest.mark.usefixtures("loads")
def test_fingers_bend_the_skin(root: Path) -> None:
    from pxr import Usd, UsdGeom, UsdSkel

    body = BodyModel.load(root / "resources/body.npz")
    plain, rng = avatar(body, np.random.default_rng(1), "p0"), np.random.default_rng(2)
    poses = np.concatenate([plain.poses, rng.normal(0, 0.3, (len(plain.poses), 90))], axis=1)
    skeleton = scale_hands(body, np.array([1.1, 0.9]))
    stage = Usd.Stage.CreateInMemory()
    usd.add_body(stage, "/p0", replace(plain, model=skeleton, poses=poses, hand_scale=np.array([1.1, 0.9])))
    cache, mesh = UsdSkel.Cache(), stage.GetPrimAtPath("/p0/body")
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/p0")), Usd.PrimDefaultPredicate)
    joints = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/p0/skeleton")))
    points = UsdGeom.Mesh(mesh).GetPointsAttr().Get()
    assert cache.GetSkinningQuery(mesh).ComputeSkinnedPoints(joints.ComputeSkinningTransforms(1), points, 1)
    assert np.abs(np.asarray(points) - skeleton.vertices(poses, plain.betas, plain.trans)[1]).max() < 1e-4
