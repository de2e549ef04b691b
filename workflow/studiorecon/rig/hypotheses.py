# SPDX-License-Identifier: Apache-2.0
"""Tests other conventions of the poses: under the right one people's rays meet, in front of the cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.agreement import error_medians
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.human_size import ADULTS_M, statures_m
from studiorecon.rig.lens_model import LensReading
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

_CLEARLY = 1.5
# How many times better people must fit exchanged cameras: than the cameras as read, and than moved cameras, which have
# more freedom to fit.
_MUCH_BETTER, _BETTER = 3.0, 1.5
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
POSE_READINGS: dict[str, Callable[[Num[np.ndarray, "4 4"]], Num[np.ndarray, "4 4"]]] = {
    "as read": lambda pose: pose,
    "poses are world-from-camera": np.linalg.inv,
    "axes are OpenGL's": lambda pose: _FLIP @ pose,
    "world-from-camera with OpenGL axes": lambda pose: _FLIP @ np.linalg.inv(pose),
}


# The user's remedy for a reading that fits better.
REMEDIES = {
    "as read": "",
    "poses are world-from-camera": "set calibration.poses: world_from_camera",
    "axes are OpenGL's": "set calibration.poses: opengl",
    "world-from-camera with OpenGL axes": "set calibration.poses: world_from_camera_opengl",
    "lengths are millimetres": "set calibration.unit: mm",
    "lengths were divided by 1000": "set calibration.unit: m",
    "the lenses are fisheyes": "set calibration.lens: fisheye",
    "the lenses are not fisheyes": "set calibration.lens: opencv",
}
# The lens model of each reading.
LENS_READINGS: dict[str, LensReading] = {"the lenses are fisheyes": "fisheye", "the lenses are not fisheyes": "opencv"}


def score_conventions(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    limits: Limits,
) -> list[dict[str, Any]]:
    """Every reading of the poses with its score, its remedy and ``met``.

    ``met``: share of people's joints at which the rays of three cameras (of two cameras: both) meet. On a ring of
    cameras, rays of a wrong reading may pass close to each other as often as those of the right one, but they do not
    meet. (The demo: scores 0.65 and 0.57, joints on which three cameras agree 82 % and none.)
    """
    changes: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        **POSE_READINGS,
        "lengths are millimetres": lambda pose: scaled_pose(pose, 0.001),
        "lengths were divided by 1000": lambda pose: scaled_pose(pose, 1000.0),
    }
    table: list[dict[str, Any]] = []
    for name, change in changes.items():
        read = [_read(c, change) for c in cameras]
        score, met = _score_and_met(read, detections, frames, gate_m, limits)
        if name.startswith("lengths") and not (score > 0 and _human_size(read, detections, frames, gate_m)):
            score = 0.0
        table.append({"hypothesis": name, "score": score, "met": met, "remedy": REMEDIES[name]})
    return table


def score_lens_model(
    name: str,
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
) -> dict[str, Any]:
    """The row of ``score_conventions`` for cameras and detections under another lens model."""
    return {"hypothesis": name, "score": _score(cameras, detections, frames, gate_m), "remedy": REMEDIES[name]}


def best_swap(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: Integer[np.ndarray, " F"], gate_m: float
) -> tuple[dict[str, Any], list[Camera]] | None:
    """The row of ``score_conventions`` for the exchange of two cameras that people fit best, and all cameras then.

    None with fewer than three.
    """
    rows: list[tuple[dict[str, Any], list[Camera]]] = []
    for i, j in combinations(range(len(cameras)), 2) if len(cameras) > 2 else ():
        poses = [c.camera_from_world for c in cameras]
        poses[i], poses[j] = poses[j], poses[i]
        swapped = [replace(c, camera_from_world=p) for c, p in zip(cameras, poses)]
        name = f"cameras {cameras[i].name} and {cameras[j].name} are swapped"
        remedy = "exchange their names in the calibration, or their videos and keypoints"
        rows.append(
            ({"hypothesis": name, "score": _score(swapped, detections, frames, gate_m), "remedy": remedy}, swapped)
        )
    return max(rows, key=lambda row: row[0]["score"], default=None)


def refuse_swapped(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    limits: Limits,
    before_px: float,
    moved_px: float,
) -> None:
    """Raise UserError when people fit several times better with two cameras exchanged than as read, and than with
    cameras moved.

    The errors are ``before_px`` (NaN where no three cameras agree) and ``moved_px``. On a regular ring a swap is nearly
    a mirror image: it passes every limit, and all bodies are wrong.
    """
    found = best_swap(cameras, detections, frames[:: max(1, len(frames) // 6)], gate_m)
    if found is None:
        return
    row, swapped = found
    seen, _ = make_observations(detections, swapped, frames, gate_m)
    after = error_medians(swapped, seen, limits)[0] if len(seen.frame) else float("nan")
    if after * _MUCH_BETTER < (before_px if np.isfinite(before_px) else np.inf) and after * _BETTER < moved_px:
        known = f"{before_px:.0f} px as read" if np.isfinite(before_px) else "no three cameras agree as read"
        raise UserError(
            f"the calibration fits the people only if {row['hypothesis']} "
            f"({after:.1f} px off, {known}): {row['remedy']}"
        )


def _score(cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float) -> float:
    seen, graph = make_observations(detections, cameras, frames, gate_m)
    return seen.affinity / max(len(graph.view), 1)


def _score_and_met(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float, limits: Limits
) -> tuple[float, float]:
    seen, graph = make_observations(detections, cameras, frames, gate_m)
    score = seen.affinity / max(len(graph.view), 1)
    if not len(seen.frame):
        return score, 0.0
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    return score, float((found.verified if len(cameras) > 2 else found.valid).mean())


def _human_size(cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float) -> bool:
    """Whether people are about as tall as adults: in a world a thousand times too small all rays pass close to each
    other."""
    seen, _ = make_observations(detections, cameras, frames, gate_m)
    close = Limits(min_confidence=0.1, huber_share=0.005, outlier_units=9.0, min_angle_deg=2.0, near_m=1e-4)
    found_m = statures_m(cameras, seen, close)
    return bool(len(found_m)) and bool(ADULTS_M[0] < np.median(found_m) < ADULTS_M[1])


def _read(camera: Camera, change: Callable[[np.ndarray], np.ndarray]) -> Camera:
    return replace(camera, camera_from_world=change(camera.camera_from_world))


def scaled_pose(pose: Num[np.ndarray, "4 4"], factor: float) -> Num[np.ndarray, "4 4"]:
    """The pose in a world whose lengths are multiplied by ``factor``."""
    changed = pose.copy()
    changed[:3, 3] *= factor
    return changed


def check_conventions(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: Integer[np.ndarray, " F"], gate_m: float
) -> list[dict[str, Any]]:
    """Every reading of the poses with its score: agreement of people's rays, per detection that could agree.

    Raises UserError when another reading clearly beats the one in use.
    """
    table: list[dict[str, Any]] = [
        {"hypothesis": name, "score": _score([_read(c, change) for c in cameras], detections, frames, gate_m)}
        for name, change in POSE_READINGS.items()
    ]
    best = max(table, key=lambda row: row["score"])
    if best["hypothesis"] != "as read" and best["score"] > 0.3 and best["score"] > _CLEARLY * table[0]["score"]:
        raise UserError(
            f"the calibration fits the people only if its {best['hypothesis']} (agreement {best['score']:.2f}, against "
            f"{table[0]['score']:.2f} as its format defines it): {REMEDIES[best['hypothesis']]}, or export it again"
        )
    return table
