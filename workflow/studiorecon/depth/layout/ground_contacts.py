# SPDX-License-Identifier: Apache-2.0
"""Walls without matches, located by the lower ends of upright edges on the floor.

Frames of doors and windows, cupboards and corners of a room are upright, and an upright object is no further away than
where its lower end would meet the floor. A hidden lower end makes that too far, and furniture is nearer; of a wall
itself many edges meet the floor in one line. One camera is enough, where a match needs two that see the same piece of
wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.camera_path import scene_centre
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# An edge is upright to within this, at least so long, and its lower end so far below the horizon and from the picture's
# border (share of its longer side).
_UPRIGHT_DEG, _MIN_SPAN_DEG, _BELOW_HORIZON_DEG, _RIM_SHARE = 2.0, 2.5, 1.0, 0.02
# Long edges count up to this.
_MAX_SPAN_DEG = 15.0
# Sigma of an end, seen from the camera; and deviation of a wall's foot from a line, with skirting and frames.
_END_DEG, _FOOT_M = 0.2, 0.16
# Least cosine between a wall's normal and the line of sight.
_FACED = 0.35
_STEP_M = 0.05
# Least evidence for a wall: edges, edges a degree apart as seen from their camera, width of the wall, share of all
# edges that face it; largest sigma.
_MIN_EDGES, _MIN_APART, _MIN_WIDTH_M, _MIN_SHARE, _MAX_SIGMA_M = 5, 4, 0.6, 0.2, 0.3
# Furniture makes lines of feet too: of two lines about as strong, the further one is the wall.
_RIVAL = 0.8
# Lines nearer than this to the middle of the cameras' view are furniture, and so are lines so far in front of the
# outermost camera.
_BEYOND_MIDDLE_M, _BEFORE_CAMERAS_M = 2.5, 0.2
# Where so many walls are known, others are no further behind the cameras than these, or than the second distance. On a
# side without cameras, one is assumed as far from the middle as the others, with this much space.
_KNOWN_WALLS, _CLOSE_BY_M, _ROOM_FOR_ONE_M = 2, 2.0, 0.5
# Cupboards, desks and cameras are along a wall: it is so far behind their feet, and behind cameras.
_BEHIND_M, _BEHIND_CAMERAS_M = 0.5, 0.3


@dataclass(frozen=True)
class GroundContacts:
    """Lower ends of upright edges on the floor.

    Attributes:
        place_m: x and y.
        towards: unit, from the camera.
        sigma_m: along that.
        span_deg: length of the edge, seen from the camera.
        camera: index of that camera.
    """

    place_m: Float[np.ndarray, "N 2"]
    towards: Float[np.ndarray, "N 2"]
    sigma_m: Float[np.ndarray, " N"]
    span_deg: Float[np.ndarray, " N"]
    camera: Integer[np.ndarray, " N"]

    def of(self, chosen: Bool[np.ndarray, " N"]) -> GroundContacts:
        """The chosen contacts."""
        return GroundContacts(*(getattr(self, f.name)[chosen] for f in fields(self)))


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
    return GroundContacts(place_m, towards, sigma_m, span_deg[kept], np.full(len(towards), view))


def wall_line(
    seen: GroundContacts, normal: Float[np.ndarray, " 2"], nearest_m: float, furthest_m: float
) -> tuple[float, Bool[np.ndarray, " N"], float] | None:
    """Offset along ``normal`` of the line of feet in this range, which feet, and their degrees of edge; None if
    unclear.
    """
    offsets = seen.place_m @ normal
    sigma = np.hypot(seen.sigma_m * (seen.towards @ normal), _FOOT_M)
    faced = (seen.towards @ normal > _FACED) & (offsets > nearest_m - 2 * sigma)
    if faced.sum() < _MIN_EDGES:
        return None
    weight = np.minimum(seen.span_deg, _MAX_SPAN_DEG) * faced
    places = np.arange(nearest_m, furthest_m, _STEP_M)
    off = (places[:, None] - offsets) / sigma
    score = (np.exp(-0.5 * off**2) * weight).sum(1)
    # A score that is largest at the nearest position has its peak before that.
    peaks = 1 + np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] > score[2:]))
    beside = np.array([-normal[1], normal[0]])
    for k in peaks[::-1]:
        own = faced & (np.abs(off[k]) < 2)
        azimuth_deg = np.degrees(np.arctan2(*seen.towards[own].T))
        apart = {(int(c), round(a)) for c, a in zip(seen.camera[own], azimuth_deg)}
        if (
            score[k] >= max(_RIVAL * score.max(), _MIN_SHARE * weight.sum())
            and own.sum() >= _MIN_EDGES
            and len(apart) >= _MIN_APART
            and np.ptp(seen.place_m[own] @ beside) >= _MIN_WIDTH_M
            and np.median(sigma[own]) <= _MAX_SIGMA_M
        ):
            return float(places[k]), own, float(score[k])
    return None


def place_default_walls(
    box: RoomBox, seen: GroundContacts, cameras: Sequence[Camera]
) -> tuple[RoomBox, dict[int, int]]:
    """The box with default walls moved to upright edges, and face → number of edges.

    The number is 0 where a wall is put as far behind the cameras as the known walls. Moved walls stay defaults
    (``fitted``), because nothing was matched there. The wall with most edges comes first; edges along it do not count
    for others.
    """
    outwards = np.array([[-1.0], [1.0], [-1.0], [1.0]])
    normals, offsets_m = outwards * box.axes[[0, 0, 1, 1], :2], outwards[:, 0] * box.faces[:4, 3]
    centres, middle = np.stack([c.centre_m for c in cameras])[:, :2], scene_centre(cameras)[:2]
    outermost_m, middle_m = (centres @ normals.T).max(0), normals @ middle
    nearest_m = np.maximum(outermost_m - _BEFORE_CAMERAS_M, middle_m + _BEYOND_MIDDLE_M)
    votes, free = dict[int, int](), np.ones(len(seen.span_deg), bool)
    while True:
        left = [face for face in range(4) if not box.fitted[face] and face not in votes]
        lines = {
            face: line
            for face in left
            if (line := wall_line(seen.of(free), normals[face], nearest_m[face], offsets_m[face])) is not None
        }
        if not lines:
            break
        face = max(lines, key=lambda f: lines[f][2])
        foot_m, own, _ = lines[face]
        offsets_m[face] = max(foot_m + _BEHIND_M, outermost_m[face] + _BEHIND_CAMERAS_M)
        votes[face] = int(own.sum())
        free[np.flatnonzero(free)[own]] = False
    known = [face for face in range(4) if face not in left]
    if len(known) >= _KNOWN_WALLS:
        behind_m = max((offsets_m - outermost_m)[known].max(), _CLOSE_BY_M)
        around_m = np.linalg.norm(centres - middle, axis=1).max() + _ROOM_FOR_ONE_M
        close_m = np.maximum(outermost_m + behind_m, middle_m + around_m)
        votes |= {face: 0 for face in left if close_m[face] < offsets_m[face]}
        offsets_m[left] = np.minimum(offsets_m, close_m)[left]
    low_m, high_m = np.array([*-offsets_m[::2], box.low_m[2]]), np.array([*offsets_m[1::2], box.high_m[2]])
    return replace(box, low_m=low_m, high_m=high_m), votes
