# SPDX-License-Identifier: Apache-2.0
"""Lower ends of upright edges on the floor: how far upright objects are, from one camera.

Frames of doors and windows, cupboards and corners of a room are upright, and an upright object is no further away than
where its lower end would meet the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# An edge is upright to within this, at least so long, and its lower end so far below the horizon and from the picture's
# border (share of its longer side).
_UPRIGHT_DEG, _MIN_SPAN_DEG, _BELOW_HORIZON_DEG, _RIM_SHARE = 2.0, 2.5, 1.0, 0.02
# Sigma of an end, seen from the camera.
_END_DEG = 0.2


@dataclass(frozen=True)
class GroundContacts:
    """Lower ends of upright edges on the floor.

    Attributes:
        place_m: x and y.
        towards: unit, from the camera.
        sigma_m: along that.
        camera: index of that camera.
    """

    place_m: Float[np.ndarray, "N 2"]
    towards: Float[np.ndarray, "N 2"]
    sigma_m: Float[np.ndarray, " N"]
    camera: Integer[np.ndarray, " N"]


def find_ground_contacts(cameras: Sequence[Camera], rooms: Sequence[RoomPicture], floor_m: float) -> GroundContacts:
    """Lower ends of the upright edges in all cameras' pictures of the room; z is up."""
    found = [_contacts_in_view(v, *one, floor_m) for v, one in enumerate(zip(cameras, rooms, strict=True))]
    return GroundContacts(*(np.concatenate([getattr(one, f.name) for one in found]) for f in fields(GroundContacts)))


def _contacts_in_view(view: int, camera: Camera, room: RoomPicture, floor_m: float) -> GroundContacts:
    ends_px = room.edges_px.reshape(-1, 2, 2)
    rays = camera.unproject(ends_px, np.ones(ends_px.shape[:2])) - camera.centre_m
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    across = np.cross(rays[:, 0], rays[:, 1])
    tilt_deg = np.degrees(np.arcsin(np.abs(across[:, 2]) / np.maximum(np.linalg.norm(across, axis=-1), 1e-12)))
    elevation_deg = np.degrees(np.arcsin(rays[..., 2].clip(-1, 1)))
    every, low = np.arange(len(rays)), elevation_deg.argmin(1)
    lower, lower_px, down_deg = rays[every, low], ends_px[every, low], -elevation_deg[every, low]
    rim_px = _RIM_SHARE * max(camera.wh)
    inside = ((lower_px > rim_px) & (lower_px < np.array(camera.wh) - rim_px)).all(-1)
    span_deg = np.ptp(elevation_deg, axis=1)
    height_m = camera.centre_m[2] - floor_m
    kept = (tilt_deg < _UPRIGHT_DEG) & (span_deg > _MIN_SPAN_DEG) & (down_deg > _BELOW_HORIZON_DEG) & inside
    kept &= height_m > 0
    lower, down = lower[kept], np.radians(down_deg[kept])
    towards = lower[:, :2] / np.maximum(np.linalg.norm(lower[:, :2], axis=-1, keepdims=True), 1e-12)
    # d(h / tan a) = h / sin² a da
    sigma_m = height_m / np.sin(down) ** 2 * np.radians(_END_DEG)
    place_m = camera.centre_m[:2] + height_m / np.tan(down)[:, None] * towards
    return GroundContacts(place_m, towards, sigma_m, np.full(len(towards), view))
