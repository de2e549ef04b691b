# SPDX-License-Identifier: Apache-2.0
"""A camera as described in a foreign file, and the checks that all readers of such files share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.lens_kinds import coefficients
from studiorecon.errors import UserError
from studiorecon.geometry.rotations import exp, project_to_so3
from studiorecon.scene.capture_yaml import MAX_FOCAL_PX, MIN_FOCAL_PX
from studiorecon.scene.user_values import numbers, short_text

if TYPE_CHECKING:
    from jaxtyping import Float, Num

Pose = tuple[np.ndarray, float]
"""``camera_from_world`` (4, 4), rigid, and the scale that its rotation had in the file."""
_MAX_SCALE = 1e9
_AGAIN = "calibrate this camera again"
# Share of the longer side of the picture. Lower values belong to lenses of 160° without any distortion, higher ones to
# telescopes.
_MIN_FOCAL, _MAX_FOCAL = 0.09, 100.0
_MAX_SIDE_PX = 65_536
_MAX_COEFFICIENT = 1e4
_MAX_LENGTH = 1e9
# Share of the picture's size: cropping a corner of a sensor moves the principal point outside, but not a whole picture
# further.
_MAX_OFF_CENTRE = 1.5
# A lens shift or an asymmetric crop moves it by less; 0, which programs write for an unknown one, is 0.5 away.
_MAX_USUAL_OFF_CENTRE = 0.3
# Pixels are square within a percent; squeezed films are scaled by a third or more.
_MAX_APART = 1.2
# Share of the focal length: a skew moves the edge of a usual picture by half of it.
_MAX_SKEW = 0.01
# Largest error, after a file's rounding, of a number that should be 0 or 1.
_ROUNDING = 1e-6
# Rotations of three digits are scaled by less.
_MAX_UNSAID_SCALE = 1e-3


@dataclass(frozen=True)
class RawCamera:
    """One camera as described in its file: axes and pixel centres already ours, world and unit still the file's.

    Attributes:
        wh: calibrated size; (0, 0) when the file has none.
        intrinsics: pixel centres at +0.5; ``check_camera`` removes scale and skew of the file.
        model, distortion: as in ``scene.camera.Lens``.
        camera_from_world: rigid, OpenCV axes.
        scale: of the file's pose, which was removed.
    """

    name: str
    wh: tuple[int, int]
    intrinsics: Num[np.ndarray, "3 3"]
    model: str
    distortion: Num[np.ndarray, " C"]
    camera_from_world: Num[np.ndarray, "4 4"]
    scale: float = 1.0


def _focal_range_px(wh: tuple[int, int]) -> tuple[float, float]:
    longer = max(wh)
    return (_MIN_FOCAL * longer, _MAX_FOCAL * longer) if longer else (MIN_FOCAL_PX, MAX_FOCAL_PX)


def check_focal_px(given: Mapping[str, float], size: Mapping[str, tuple[int, int]]) -> Mapping[str, float]:
    """The user's focal lengths by camera; raises UserError for one that no lens has for pictures of its ``size``."""
    for camera, (width, height) in size.items():
        least, most = _focal_range_px((width, height))
        if not least <= given.get(camera, least) <= most:
            raise UserError(
                f"capture.yaml: focal_px of {camera} is {given[camera]:g}; for pictures of {width}×{height} it must "
                f"be from {least:g} to {most:g} pixels"
            )
    return given


def check_camera(name: str, camera: RawCamera, source: str) -> tuple[RawCamera, list[str]]:
    """The camera with intrinsics in the form of all later steps, and a sentence for every number that was left out.

    Raises UserError with camera, number and likely cause for an impossible size, lens or position.
    """
    where = f"camera {name} in {source}"
    longer = max(camera.wh)
    if min(camera.wh) < 0 or longer > _MAX_SIDE_PX or (0 in camera.wh and longer):
        raise UserError(f"{where}: its pictures are {camera.wh[0]}×{camera.wh[1]} pixels; correct the size")
    intrinsics, notes = _pinhole(camera.intrinsics, where)
    if abs(camera.scale - 1) > _MAX_UNSAID_SCALE:
        notes.append(f"{where}: a scale of {camera.scale:.4g} was removed from its rotation")
    least, most = _focal_range_px(camera.wh)
    for axis, focal in (("fx", intrinsics[0, 0]), ("fy", intrinsics[1, 1])):
        if not least <= focal <= most:
            size = f" for pictures of {camera.wh[0]}×{camera.wh[1]}" if longer else ""
            raise UserError(
                f"{where}: its focal length {axis} is {focal:g} pixels{size}, which no lens has; "
                + ("is it in millimetres? It must be in pixels" if 0 < focal < least else "calibrate this camera again")
            )
    centre = intrinsics[:2, 2]
    if longer and not (np.abs(centre / camera.wh - 0.5) < _MAX_OFF_CENTRE).all():
        raise UserError(
            f"{where}: its principal point is ({centre[0]:g}, {centre[1]:g}), far outside of its pictures of "
            f"{camera.wh[0]}×{camera.wh[1]}; is the size another camera's?"
        )
    if longer and not (np.abs(centre / camera.wh - 0.5) < _MAX_USUAL_OFF_CENTRE).all():
        notes.append(
            f"{where}: its principal point ({centre[0]:g}, {centre[1]:g}) is far from the middle of its pictures of "
            f"{camera.wh[0]}×{camera.wh[1]}, which only happens for a cropped corner"
        )
    if (apart := intrinsics[0, 0] / intrinsics[1, 1]) > _MAX_APART or apart < 1 / _MAX_APART:
        notes.append(
            f"{where}: its focal lengths fx {intrinsics[0, 0]:g} and fy {intrinsics[1, 1]:g} mean pixels {apart:.3g} "
            "times as high as wide; check the numbers, unless the picture is squeezed"
        )
    if not (np.isfinite(camera.distortion).all() and (np.abs(camera.distortion) < _MAX_COEFFICIENT).all()):
        raise UserError(f"{where}: its distortion {camera.distortion.tolist()} is no lens's; calibrate it again")
    if not (np.isfinite(camera.camera_from_world).all() and (np.abs(camera.camera_from_world) < _MAX_LENGTH).all()):
        raise UserError(f"{where}: its position is not finite; calibrate this camera again")
    return replace(camera, intrinsics=intrinsics), notes


def _pinhole(matrix: Num[np.ndarray, "3 3"], where: str) -> tuple[Float[np.ndarray, "3 3"], list[str]]:
    """Intrinsics without scale and skew, and sentences about these."""
    scale = float(matrix[2, 2])
    if not (np.isfinite(matrix).all() and scale > 0 and (matrix > 0)[[0, 1], [0, 1]].all()):
        raise UserError(
            f"{where}: its camera matrix {np.round(matrix, 3).tolist()} is not finite, or has a focal length or a "
            f"last number that is not above 0; {_AGAIN}"
        )
    intrinsics = matrix / scale
    if np.abs(intrinsics[[1, 2, 2], [0, 0, 1]]).max() > _ROUNDING:
        raise UserError(
            f"{where}: its camera matrix {np.round(intrinsics, 3).tolist()} has numbers below the diagonal; "
            "write it row by row, with the principal point in its last column"
        )
    notes = (
        [] if abs(scale - 1) < _ROUNDING else [f"{where}: its camera matrix was divided by its last number, {scale:g}"]
    )
    skew = float(intrinsics[0, 1])
    if abs(skew) > _MAX_SKEW * intrinsics[0, 0]:
        raise UserError(
            f"{where}: the skew of its camera matrix is {skew:g} pixels, which no camera's sensor has; {_AGAIN}"
        )
    if abs(skew) > _ROUNDING:
        notes.append(f"{where}: the skew of its camera matrix, {skew:.3g} pixels, was left out")
        intrinsics[0, 1] = 0.0
    return intrinsics, notes


def raw_camera(
    name: str,
    where: str,
    wh: object,
    intrinsics: object,
    pose: Pose,
    distortion: object = None,
    model: str = "opencv",
    *,
    integer_centres: bool = True,
) -> RawCamera:
    """The camera of a file whose values are not checked yet; ``where`` begins the sentences of refusals.

    ``wh``: two numbers; ``intrinsics``: 3×3, or fx, fy, cx, cy; ``integer_centres``: the file has pixel centres at
    whole numbers, not at +0.5 (C07). Raises UserError unless these are numbers, as many as there must be.
    """
    size = numbers(wh, f"{where}: its size").reshape(-1)
    if len(size) != 2 or (size % 1).any():
        raise UserError(f"{where}: its size is {short_text(size.tolist())}; it must be width and height in pixels")
    given = numbers(intrinsics, f"{where}: its camera matrix").reshape(-1)
    if len(given) == 4:
        given = np.array([given[0], 0, given[2], 0, given[1], given[3], 0, 0, 1])
    if len(given) != 9:
        raise UserError(f"{where}: its camera matrix holds {len(given)} numbers; it must be 3×3")
    shift = np.eye(3)
    shift[:2, 2] = 0.5 if integer_centres else 0.0
    terms = coefficients(model, distortion, where)
    return RawCamera(name, (int(size[0]), int(size[1])), shift @ given.reshape(3, 3), model, terms, *pose)


def rigid_camera_from_world(rotation: object, translation: object, where: str) -> Pose:
    """Rigid transform of x_camera = rotation · X + translation, and the scale that was factored out.

    ``rotation``: 3×3, or an axis times its angle in radians. A uniformly scaled block [cR | ct] gives the same picture
    as [R | t]. The rotation is projected to the nearest one (C01). Raises UserError for a reflection, for a block that
    is not a scaled rotation, and for other numbers than these.
    """
    block, shift = numbers(rotation, f"{where}: its rotation"), numbers(translation, f"{where}: its translation")
    for what, given, counts in (("rotation", block, (3, 9)), ("translation", shift, (3,))):
        if given.size not in counts:
            wanted = "3×3, or an axis times its angle" if len(counts) > 1 else "3 numbers"
            raise UserError(f"{where}: its {what} holds {given.size} numbers; it must be {wanted}")
    if block.size == 3 and np.linalg.norm(block) > 2 * np.pi:
        raise UserError(
            f"{where}: its rotation is an axis times an angle of {np.linalg.norm(block):.4g}, more than a full turn in "
            "radians; write radians, not degrees"
        )
    block = block.reshape(3, 3) if block.size == 9 else exp(block.reshape(3))
    # A damaged number may have any size: overflow is refused below.
    with np.errstate(all="ignore"):
        determinant = np.linalg.det(block)
    if not (np.isfinite(determinant) and determinant != 0 and np.abs(block).max() < _MAX_SCALE):
        raise UserError(f"{where}: the 3×3 block is no rotation (it holds {np.abs(block).max():.3g}); {_AGAIN}")
    if determinant < 0:
        raise UserError(
            f"{where}: the rotation has determinant {determinant:.3g}, a mirror image and not a camera; "
            "an axis was negated once too often when the file was written"
        )
    scale = determinant ** (1 / 3)
    off = np.abs((block / scale).T @ (block / scale) - np.eye(3)).max()
    if off > 0.02:
        raise UserError(
            f"{where}: the 3×3 block is not a rotation (RᵀR differs from I by "
            f"{off:.3f}); check the order of its numbers"
        )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = project_to_so3(block / scale), shift.reshape(3) / scale
    return pose, float(scale)


def pose_rows(block: object, where: str) -> Float[np.ndarray, "3 4"]:
    """The rotation and translation of a 3×4 or 4×4 pose; raises UserError for another shape or last row."""
    given = numbers(block, where)
    if given.size not in (12, 16):
        raise UserError(f"{where} holds {given.size} numbers; write 3×4 or 4×4")
    rows = given.reshape(-1, 4)
    if not np.allclose(rows[3:], [0, 0, 0, 1]):
        raise UserError(f"{where} has the last row {rows[3].tolist()}; it must be 0 0 0 1")
    return rows[:3]


def camera_from_world_of_rows(block: object, where: str) -> Pose:
    """``rigid_camera_from_world`` of a 3×4 or 4×4 pose; raises UserError for another shape or last row too."""
    rows = pose_rows(block, f"{where}: its pose")
    return rigid_camera_from_world(rows[:3, :3], rows[:3, 3], where)


def camera_from_world_of_pose(world_from_camera: object, where: str) -> Pose:
    """The same of a 3×4 or 4×4 ``world_from_camera`` whose rotation block may include a scale."""
    pose, scale = camera_from_world_of_rows(world_from_camera, where)
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3] * scale
    return inverse, scale
