# SPDX-License-Identifier: Apache-2.0
"""Camera paths between the cameras of a rig: order around the scene, rotation by slerp, motion along line or arc."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.rotations import half_turn, slerp
from studiorecon.progress import say
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

LARGEST_GAP_RAD = np.radians(150)
"""A gap between neighbouring cameras beyond this leaves their ring open: nobody filmed what lies there (U18)."""
# Assumed distance of the scene in front of the rig when the optical axes do not determine it (parallel axes, one
# camera).
_ASSUMED_DISTANCE_M = 3.0
# Weight of that assumption against one optical axis: it decides only where the axes do not.
_ASSUMPTION_WEIGHT = 1e-3


def scene_centre(cameras: Sequence[Camera]) -> Num[np.ndarray, " 3"]:
    """The point nearest to all optical axes in least squares, three metres ahead where those leave it undetermined.

    Raises ValueError without a camera.
    """
    if not cameras:
        raise ValueError("cameras is empty: there is no scene to find the centre of")
    ahead = np.mean([c.centre_m + _ASSUMED_DISTANCE_M * c.forward for c in cameras], axis=0)
    normal, right = _ASSUMPTION_WEIGHT * np.eye(3), _ASSUMPTION_WEIGHT * ahead
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        normal, right = normal + across, right + across @ camera.centre_m
    return np.linalg.solve(normal, right)


def azimuths_rad(cameras: Sequence[Camera], centre_m: Num[np.ndarray, " 3"]) -> Num[np.ndarray, " V"]:
    """Direction of each camera from the centre, counter-clockwise from x, in [0, 2 pi). Raises ValueError for no
    point."""
    require("centre_m", centre_m, (3,), finite=True)
    offsets = np.stack([camera.centre_m - centre_m for camera in cameras])
    return np.arctan2(offsets[:, 1], offsets[:, 0]) % (2 * np.pi)


def order_around(cameras: Sequence[Camera], centre_m: Num[np.ndarray, " 3"], closed: bool) -> tuple[list[int], float]:
    """Camera indices counter-clockwise around the centre (U18), and the largest gap between neighbours in radians.

    A closed ring starts at the first camera; an open arc starts behind the largest gap. Raises ValueError for a
    ``centre_m`` that is no point.
    """
    azimuth = azimuths_rad(cameras, centre_m)
    order = np.argsort(azimuth, kind="stable")
    gaps = np.diff(np.concatenate([azimuth[order], azimuth[order[:1]] + 2 * np.pi]))
    start = int(np.flatnonzero(order == 0)[0]) if closed else (int(gaps.argmax()) + 1) % len(order)
    return [int(i) for i in np.roll(order, -start)], float(gaps.max())


@dataclass(frozen=True)
class Gap:
    """One camera and its neighbour around the scene: indices, and the angle between them about the centre."""

    first: int
    second: int
    rad: float


def gaps_around(cameras: Sequence[Camera]) -> list[Gap]:
    """The gaps between neighbours once around the scene, counter-clockwise from the first camera on (U18).

    A single camera is its own neighbour. Raises ValueError without a camera.
    """
    centre_m = scene_centre(cameras)
    order, _ = order_around(cameras, centre_m, closed=True)
    azimuth = azimuths_rad(cameras, centre_m)
    pairs = zip(order, [*order[1:], order[0]])
    return [Gap(a, b, float((azimuth[b] - azimuth[a]) % (2 * np.pi)) if a != b else 2 * np.pi) for a, b in pairs]


def look_at(eye_m: Num[np.ndarray, " 3"], target_m: Num[np.ndarray, " 3"]) -> Num[np.ndarray, "3 3"]:
    """World_from_camera of a level camera at ``eye_m`` whose optical axis meets ``target_m``; y is up if that is below.

    Raises ValueError for arguments that are not finite numbers.
    """
    require("eye_m", eye_m, (3,), finite=True)
    require("target_m", target_m, (3,), finite=True)
    forward = np.asarray(target_m, np.float64) - eye_m
    length = np.linalg.norm(forward)
    forward = forward / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def with_pose(camera: Camera, world_from_camera: Num[np.ndarray, "3 3"], centre_m: Num[np.ndarray, " 3"]) -> Camera:
    """The camera turned to ``world_from_camera`` and moved to ``centre_m``. Raises ValueError unless both are
    finite."""
    require("world_from_camera", world_from_camera, (3, 3), finite=True)
    require("centre_m", centre_m, (3,), finite=True)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = world_from_camera.T
    camera_from_world[:3, 3] = -world_from_camera.T @ centre_m
    return replace(camera, camera_from_world=camera_from_world)


def straight_path(
    start_m: Num[np.ndarray, " 3"], end_m: Num[np.ndarray, " 3"], shares: Num[np.ndarray, " N"]
) -> Num[np.ndarray, "N 3"]:
    """Points on the chord at ``shares`` of the way. Raises ValueError for other shapes."""
    require("start_m", start_m, (3,))
    require("end_m", end_m, (3,))
    require("shares", shares, ("N",))
    return start_m + shares[:, None] * (end_m - start_m)


def arc_path(
    start_m: Num[np.ndarray, " 3"],
    end_m: Num[np.ndarray, " 3"],
    shares: Num[np.ndarray, " N"],
    centre_m: Num[np.ndarray, " 3"],
) -> Num[np.ndarray, "N 3"]:
    """Points around the vertical through the centre, the short way: angle, radius and height change evenly.

    Exactly opposite ends go counter-clockwise. Raises ValueError for other shapes.
    """
    for name, place in (("start_m", start_m), ("end_m", end_m), ("centre_m", centre_m)):
        require(name, place, (3,))
    require("shares", shares, ("N",))
    a, b = start_m - centre_m, end_m - centre_m
    turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    # Rounding must not decide which side of the scene is flown along (R05).
    turn = np.pi if np.pi - abs(turn) < 1e-6 else turn
    angle = np.arctan2(a[1], a[0]) + shares * turn
    radius = np.hypot(a[0], a[1]) + shares * (np.hypot(b[0], b[1]) - np.hypot(a[0], a[1]))
    height = start_m[2] + shares * (end_m[2] - start_m[2])
    return np.stack([centre_m[0] + radius * np.cos(angle), centre_m[1] + radius * np.sin(angle), height], axis=1)


def clearance_share(points_m: Num[np.ndarray, "N 3"], centre_m: Num[np.ndarray, " 3"]) -> float:
    """Least horizontal distance of a path to the centre, over the smaller of its two ends' distances.

    Raises ValueError for other shapes or points that are not finite.
    """
    require("points_m", points_m, ("N", 3), finite=True)
    distance = np.hypot(*(points_m - centre_m)[:, :2].T)
    ends = min(distance[0], distance[-1])
    return float(distance.min() / ends) if ends > 0 else 1.0


def axis_miss_rad(camera: Camera, target_m: Num[np.ndarray, " 3"]) -> float:
    """Angle between the optical axis and the direction to ``target_m``. Raises ValueError for another shape."""
    require("target_m", target_m, (3,))
    direction = target_m - camera.centre_m
    return float(np.arctan2(np.linalg.norm(np.cross(camera.forward, direction)), camera.forward @ direction))


def interpolate_cameras(
    start: Camera,
    end: Camera,
    count: int,
    centre_m: Num[np.ndarray, " 3"],
    *,
    rotations: Literal["slerp", "look_at"],
    clearance: float,
) -> tuple[list[Camera], bool]:
    """``count`` cameras from ``start`` to ``end``, both included, and whether the chord was bent to an arc.

    Rotations by slerp (half turns about the world's up), centres along the chord, as in the paper. A chord that passes
    the centre nearer than ``clearance`` times its nearer end is replaced by the arc (R07: opposite cameras would fly
    through the people). ``look_at`` keeps the centre at its place in the two cameras' pictures, which slerp does not
    for unlike cameras (R08). Half a turn is logged, because its direction was a choice (R05). Raises ValueError for a
    ``centre_m`` that is no point or fewer than one camera.
    """
    require("centre_m", centre_m, (3,), finite=True)
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    shares = np.arange(count) / max(count - 1, 1)
    points = straight_path(start.centre_m, end.centre_m, shares)
    bent = clearance_share(points, centre_m) < clearance
    if bent:
        points = arc_path(start.centre_m, end.centre_m, shares, centre_m)
    turned_a, turned_b = start.world_from_camera[:3, :3], end.world_from_camera[:3, :3]
    if rotations == "slerp":
        if half_turn(turned_a, turned_b):
            say(
                f"cameras {start.name} and {end.name} face exactly opposite directions; the path turns "
                "counter-clockwise about the vertical"
            )
        turned = slerp(turned_a, turned_b, shares)
    else:
        frames = np.stack([look_at(point, centre_m) for point in points])
        turned = frames @ slerp(frames[0].T @ turned_a, frames[-1].T @ turned_b, shares)
    turned = np.asarray(turned).reshape(count, 3, 3)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.swapaxes(turned, -1, -2)
    poses[:, :3, 3] = -np.einsum("nji,nj->ni", turned, points)
    share = shares[:, None, None]
    lenses = (1 - share) * start.intrinsics + share * end.resized(start.wh).intrinsics
    return [Camera(start.name, start.wh, lens, pose) for lens, pose in zip(lenses, poses)], bent
