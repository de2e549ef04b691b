# SPDX-License-Identifier: Apache-2.0
"""Space that people show to be free: positions of their joints, and lines of sight from a camera to them.

A photo of a person proves that nothing is in between, whatever the agreement of colours: where cameras share little, a
large box around everything agrees with more pixels than an empty room does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, Person

if TYPE_CHECKING:
    from jaxtyping import Float

_CELL_M, _CLEARANCE_M = 0.2, 0.05
# Lines of sight are sampled at this step; one point per cell is kept, at its exact position: rounded, lines would cut
# corners of tables.
_LINE_CELL_M, _LINE_STEP_M = 0.1, 0.05
# Least confidence of a keypoint; a line ends this far before its joint, which may be on a seat or behind a sleeve.
_CONFIDENCE, _BEFORE_M = 0.5, 0.3
# A keypoint belongs to the nearest projected joint, within this share of the picture's longer side.
_NEAR_SHARE = 0.03
# Detectors guess a hidden joint for some frames on end, so lines to this many joints must cross a position.
_MIN_JOINTS = 3
# Lines are counted in blocks of this size: a long film has millions of them, but a room has few cells.
_LINES_AT_ONCE = 20_000


def joint_places(people: Sequence[Person]) -> Float[np.ndarray, "M 4"]:
    """Positions, 20 cm apart along an axis, of measured joints at any time, with a least distance of 5 cm."""
    places = np.concatenate([np.zeros((0, 3)), *(person.joints[person.valid].reshape(-1, 3) for person in people)])
    return append_distance(
        np.unique(np.round(places[np.isfinite(places).all(axis=1)] / _CELL_M), axis=0) * _CELL_M, _CLEARANCE_M
    )


def append_distance(places_m: Float[np.ndarray, "M 3"], distance_m: float) -> Float[np.ndarray, "M 4"]:
    """Positions and the least distance of primitives from each."""
    return np.column_stack([places_m, np.full(len(places_m), distance_m)])


def free_ray_points(
    cameras: Sequence[Camera],
    people: Sequence[Person],
    found: Sequence[Detections],
    whose: Mapping[tuple[str, int], str],
) -> Float[np.ndarray, "M 4"]:
    """Positions, one in ten centimetres, on lines of sight to at least three joints with confident keypoints.

    Their distance is 0: a line may graze a primitive. ``found`` are detections of any of the cameras in their working
    pixels, ``whose`` names the person of (camera, track).
    """
    bodies = {person.name: (number, person) for number, person in enumerate(people)}
    views = {camera.name: camera for camera in cameras}
    lines: list[np.ndarray] = []
    crossed = np.zeros((0, 4))
    for view, detections in enumerate(found):
        camera = views.get(detections.camera)
        if camera is None:
            continue
        for frame, track, keypoints in zip(detections.frame, detections.track, detections.keypoints):
            number, body = bodies.get(whose.get((detections.camera, int(track)), ""), (0, None))
            if body is None or not body.valid[int(frame)]:
                continue
            joints_m = body.joints[int(frame)]
            for joint in _sighted(camera, keypoints, joints_m):
                points = _along(camera.centre_m, joints_m[joint])
                of = (view * len(people) + number) * len(joints_m) + joint
                lines.append(np.column_stack([points, np.full(len(points), float(of))]))
            if len(lines) >= _LINES_AT_ONCE:
                crossed, lines = _once([crossed, *lines]), []
    crossed = _once([crossed, *lines])
    _, first, joints = np.unique(np.round(crossed[:, :3] / _LINE_CELL_M), axis=0, return_index=True, return_counts=True)
    return append_distance(crossed[first[joints >= _MIN_JOINTS], :3], 0.0)


def _once(lines: Sequence[np.ndarray]) -> np.ndarray:
    """(M, 4) points of lines (L, 4: position, number of the joint), the first one per cell and joint."""
    points = np.concatenate(lines)
    cells = np.column_stack([np.round(points[:, :3] / _LINE_CELL_M), points[:, 3]])
    return points[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


def _sighted(camera: Camera, keypoints: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(S,) numbers of the joints (24, 3) at which one of the confident keypoints (K, 3: x, y, confidence) is."""
    sure = keypoints[(keypoints[:, 2] >= _CONFIDENCE) & np.isfinite(keypoints).all(axis=1), :2]
    pixels, z = camera.project(joints_m)
    usable = np.isfinite(pixels).all(axis=1) & (z > 0)
    if not len(sure) or not usable.any():
        return np.zeros(0, np.int64)
    apart = np.linalg.norm(np.where(usable[:, None], pixels, np.inf)[None] - sure[:, None], axis=-1)
    nearest = apart.argmin(axis=1)
    return np.unique(nearest[apart.min(axis=1) <= _NEAR_SHARE * max(camera.wh)])


def _along(centre_m: np.ndarray, target_m: np.ndarray) -> np.ndarray:
    """(L, 3) points from a camera to a little before a joint, one per cell of the line."""
    length = float(np.linalg.norm(target_m - centre_m)) - _BEFORE_M
    if length <= 0:
        return np.zeros((0, 3))
    points = centre_m + np.arange(0.0, length, _LINE_STEP_M)[:, None] / (length + _BEFORE_M) * (target_m - centre_m)
    _, first = np.unique(np.round(points / _LINE_CELL_M), axis=0, return_index=True)
    return points[np.sort(first)]
