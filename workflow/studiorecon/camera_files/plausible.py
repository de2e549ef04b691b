# SPDX-License-Identifier: Apache-2.0
"""Whether a camera that somebody's file describes can be one: finite, and with a lens in pixels."""

from __future__ import annotations

import numpy as np

from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.errors import UserError

# Of the longer side of the picture. Below stand lenses of 160° without any distortion, above telescopes.
_LEAST_FOCAL, _MOST_FOCAL = 0.09, 100.0
_MOST_SIDE_PX = 65_536
# Without a size: millimetres of a lens end where pixels of a video's begin.
_LEAST_FOCAL_PX, _MOST_FOCAL_PX = 50.0, 1e6
_MOST_COEFFICIENT = 1e4
_MOST_LENGTH = 1e9


def check_camera(name: str, camera: RawCamera, source: str) -> None:
    """Raises UserError that names camera, number and likely cause for a size, focal length, principal point, distortion
    or place that no camera has."""
    where = f"camera {name} in {source}"
    longer = max(camera.wh)
    if min(camera.wh) < 0 or longer > _MOST_SIDE_PX or (0 in camera.wh and longer):
        raise UserError(f"{where}: its pictures are {camera.wh[0]}×{camera.wh[1]} pixels; correct the size")
    least, most = (_LEAST_FOCAL * longer, _MOST_FOCAL * longer) if longer else (_LEAST_FOCAL_PX, _MOST_FOCAL_PX)
    for axis, focal in (("fx", camera.intrinsics[0, 0]), ("fy", camera.intrinsics[1, 1])):
        if not (np.isfinite(focal) and focal > 0):
            raise UserError(f"{where}: its focal length {axis} is {focal:g}; calibrate this camera again")
        if not least <= focal <= most:
            size = f" for pictures of {camera.wh[0]}×{camera.wh[1]}" if longer else ""
            raise UserError(
                f"{where}: its focal length {axis} is {focal:g} pixels{size}, which no lens has; "
                + ("is it in millimetres? It must be in pixels" if focal < least else "calibrate this camera again")
            )
    if not np.isfinite(camera.intrinsics).all():
        raise UserError(f"{where}: its principal point is not finite; calibrate this camera again")
    centre = camera.intrinsics[:2, 2]
    if longer and not (np.abs(centre / camera.wh - 0.5) < 1.5).all():
        raise UserError(
            f"{where}: its principal point is ({centre[0]:g}, {centre[1]:g}), far outside of its pictures of "
            f"{camera.wh[0]}×{camera.wh[1]}; is the size another camera's?"
        )
    if not (np.isfinite(camera.distortion).all() and (np.abs(camera.distortion) < _MOST_COEFFICIENT).all()):
        raise UserError(f"{where}: its distortion {camera.distortion.tolist()} is no lens's; calibrate it again")
    if not (np.isfinite(camera.camera_from_world).all() and (np.abs(camera.camera_from_world) < _MOST_LENGTH).all()):
        raise UserError(f"{where}: it stands at no finite place; calibrate this camera again")
