# SPDX-License-Identifier: Apache-2.0
"""What the doctor measures: lags between the cameras' clocks, what the cameras cover, and where nobody looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.geometry.correspondence import stable_detections, track_graph
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

_GRID = 24
_ROOM_HEIGHT_M = 2.2
_LEAST_TRACKS = 1


@dataclass(frozen=True)
class KeypointLag:
    """By how many frames a camera's keypoints come after the others' (positive: later), with the interval that fits as well.

    ``valid`` is False where the people moved too little to tell, or where the best lag lies at the end of the search.
    """

    camera: str
    frames: float
    low: float
    high: float
    valid: bool


def lags(detections: Sequence[Detections], cameras: Sequence[Camera], search: int, gate_m: float) -> list[KeypointLag]:
    """The lag of every camera at which its rays pass closest to the others' (people must move; even motion is fine).

    The interval holds all whole lags whose median ray distance is within 5 % (and 1 mm) of the best; the lag itself is the
    lowest point of the parabola through the best three.
    """
    stable = stable_detections(detections)
    found = []
    for v, d in enumerate(stable):
        shifts = np.arange(-search, search + 1)
        distance = np.array([_closest(stable, cameras, v, int(s), gate_m) for s in shifts])
        if not np.isfinite(distance).all():
            found.append(KeypointLag(d.camera, 0.0, -search, search, False))
            continue
        best = int(np.argmin(distance))
        near = shifts[distance <= distance[best] * 1.05 + 0.001]
        low, high = float(near.min()) - 0.5, float(near.max()) + 0.5
        if best in (0, len(shifts) - 1) or high - low > search:
            found.append(KeypointLag(d.camera, float(shifts[best]), low, high, False))
            continue
        before, at, after = distance[best - 1 : best + 2]
        bend = max(before - 2 * at + after, 1e-12)
        found.append(KeypointLag(d.camera, float(shifts[best] + 0.5 * (before - after) / bend), low, high, True))
    return found


def _closest(stable: Sequence[Detections], cameras: Sequence[Camera], view: int, shift: int, gate_m: float) -> float:
    """Median over the camera's tracks of the smallest distance to a track of any other camera, when it is ``shift`` frames early."""
    moved = [replace(d, frame=d.frame - shift) if v == view else d for v, d in enumerate(stable)]
    graph = track_graph(moved, cameras)
    own = np.flatnonzero(graph.view == view)
    rows = graph.distance_m[own][:, graph.view != view]
    rows = np.where(np.isfinite(rows), rows, np.inf)
    nearest = rows.min(1, initial=np.inf) if rows.size else np.zeros(0)
    nearest = nearest[nearest < 4 * gate_m]
    return float(np.median(nearest)) if len(nearest) >= _LEAST_TRACKS else np.inf


def coverage(cameras: Sequence[Camera], middle_m: np.ndarray, radius_m: float) -> list[float]:
    """Share of the upright cylinder around ``middle_m`` (2,), 2.2 m high, that at least 1, 2, 3, 4 cameras have in their picture."""
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, _GRID),) * 2, np.linspace(0.05, _ROOM_HEIGHT_M, _GRID // 2), indexing="ij")
    inside = x**2 + y**2 <= 1
    points = np.stack([middle_m[0] + radius_m * x[inside], middle_m[1] + radius_m * y[inside], z[inside]], axis=-1)
    seen = np.zeros(len(points), dtype=int)
    for camera in cameras:
        pixels, depth = camera.project(points)
        seen += (depth > 0.1) & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(-1) & (np.nan_to_num(pixels, nan=1e9) < camera.wh).all(-1)
    return [float((seen >= n).mean()) for n in (1, 2, 3, 4)]


def blind_sectors(cameras: Sequence[Camera], middle_m: np.ndarray, least_deg: float = 90.0) -> list[tuple[float, float]]:
    """(from, to) in degrees, counter-clockwise from x, of directions around ``middle_m`` with no camera within the sector, widest first."""
    offsets = np.array([c.centre_m[:2] - middle_m for c in cameras])
    angles = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360)
    gaps = [(float(a), float(b)) for a, b in zip(angles, np.append(angles[1:], angles[0] + 360)) if b - a > least_deg]
    return sorted(gaps, key=lambda g: g[0] - g[1])
