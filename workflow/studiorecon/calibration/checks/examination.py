# SPDX-License-Identifier: Apache-2.0
"""Examines a calibration on cameras, people and pictures of the room; the result is the doctor's report as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.calibration.checks import coverage as health
from studiorecon.calibration.checks import sanity
from studiorecon.calibration.checks.advice import verdict
from studiorecon.calibration.checks.edges import compare_edges
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.active_cameras import active_cameras, inactive_camera_notes, shared_frames
from studiorecon.rig.agreement import RefinementLimits, error_medians, metres_per_px
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.human_size import check_human_size
from studiorecon.rig.outlier_camera import find_outlier_camera
from studiorecon.rig.refined_cameras import refine_cameras
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.starts import FRAMES, Start, calibration_starts, compare, lens_start
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

_NOBODY_REACH_M = 2.0
# The same number as in ``cameras.refine``.
_REFINED_FRAMES = 96
Readings = Mapping[str, tuple[Sequence[Camera], Sequence[Detections]]]


@dataclass(frozen=True)
class Settings(RefinementLimits):
    """Limits of agreement between cameras and people, and the trust in given cameras."""


def examine(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    about: Sequence[dict[str, Any]],
    settings: Settings,
    lens_readings: Readings | None = None,
    sync: Mapping[str, Any] | None = None,
    doubts: Sequence[str] = (),
    rooms: Sequence[RoomPicture | None] = (),
    keypoints: Mapping[str, Sequence[str]] | None = None,
) -> tuple[dict[str, Any], Float[np.ndarray, "N 3"]]:
    """The report (written to doctor.json) and the triangulated points (N, 3) of the frame with most of them.

    ``detections`` of cameras without keypoints are empty. ``lens_readings``: by the names of
    ``starts.LENS_READINGS``. ``sync``: ``sentences`` about clocks, the ``refusal`` that the footage will raise, or
    "", and ``lags_frames`` by which people lag in a camera. ``keypoints``: sentences from their comparison with the
    films, ``refused`` and ``notes``. ``rooms``: without people, None where it was not computed.
    """
    names = [c.name for c in cameras]
    chosen, people = shared_frames(detections, FRAMES), any(len(d.frame) for d in detections)
    fit = _fit_of_people(cameras, detections, chosen, settings)
    limit_px = settings.limit_px(cameras, fit.points_m)
    fps = max(float(a["fps"]) for a in about)
    refined, odd = None, None
    if people:
        errors = fit.median_px, fit.per_camera_px
        wanted = active_cameras(detections, fps), shared_frames(detections, _REFINED_FRAMES)
        refined = refine_cameras(cameras, detections, *wanted, errors, 0.5 * limit_px, settings, rooms)
    used = None if refined is None else Start("as used", "", refined.cameras, refined.detections)
    starts = [lens_start(name, *both) for name, both in (lens_readings or {}).items()]
    compared = compare([*calibration_starts(cameras, detections), *starts], chosen, settings.gate_m, used)
    if people and (fit.median_px is None or any(e is None or e > limit_px for e in fit.per_camera_px)):
        odd = find_outlier_camera(cameras, detections, chosen, settings.gate_m, settings.limits)
        if odd is not None and (not odd.cause or odd.turned) and refined is not None and refined.has_moved:
            odd = None  # moved cameras explain it
    shown, shown_points = _best_frame(cameras, fit.seen, settings.limits)
    middle, reach = _volume(cameras, fit.points_m)
    report: dict[str, Any] = {
        "cameras": names,
        "notes": [],
        "lengths": _wrong_lengths(cameras, fit.seen, settings.limits),
        "people": people,
        "without_keypoints": [a["camera"] for a in about if not a["keypoints"]],
        "inactive_cameras": inactive_camera_notes([d for d, a in zip(detections, about) if a["keypoints"]], fps),
        "hypotheses": compared.rows(),
        "required": [start.words for start in compared.chosen],
        "outlier_camera": None if odd is None else odd.sentence(),
        "median_px": fit.median_px,
        "median_mm": fit.median_mm(cameras),
        "refined": None if refined is None else refined.as_json(cameras),
        "edges": compare_edges(cameras, refined, rooms),
        "px_per_camera": dict(zip(names, fit.per_camera_px)),
        "shown_frame": shown,
        "sync": dict(sync or {"sentences": [], "refusal": "", "lags_frames": {}}),
        "keypoints": {key: list((keypoints or {}).get(key, [])) for key in ("refused", "notes")},
        "footage": {a["camera"]: dict(a) for a in about},
        "facts": sanity.camera_facts(cameras),
        "oddities": [*doubts, *sanity.calibration_notes(cameras)],
        "coverage": dict(zip(("1", "2", "3", "4"), health.coverage(cameras, middle, reach))),
        "reach_m": reach,
        "blind_sectors_deg": health.blind_sectors(cameras, middle),
    }
    report["verdict"], report["advice"] = verdict(report, limit_px)
    return report, shown_points


@dataclass(frozen=True)
class _Fit:
    """How well people fit the cameras: the median error, of each camera too, and the points (N, 3) that it is of."""

    seen: Observations
    median_px: float | None
    per_camera_px: Sequence[float | None]
    points_m: np.ndarray

    def median_mm(self, cameras: Sequence[Camera]) -> float | None:
        if self.median_px is None:
            return None
        return 1000 * self.median_px * metres_per_px(cameras, self.points_m)


def _fit_of_people(
    cameras: Sequence[Camera], detections: Sequence[Detections], chosen: np.ndarray, settings: Settings
) -> _Fit:
    seen, _ = make_observations(detections, cameras, chosen, settings.gate_m)
    if not len(seen.frame):
        return _Fit(seen, None, [None] * len(cameras), np.zeros((0, 3)))
    median, each, points = error_medians(cameras, seen, settings.limits)
    return _Fit(seen, median if len(points) else None, each, points)


def _wrong_lengths(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> str | None:
    """The refusal of ``cameras.refine`` about people's size, or None."""
    try:
        check_human_size(cameras, seen, limits)
    except UserError as refusal:
        return str(refusal)
    return None


def _best_frame(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> tuple[int | None, np.ndarray]:
    """The frame with most triangulated joints, and those joints (N, 3)."""
    best: tuple[int | None, np.ndarray] = (None, np.zeros((0, 3)))
    for frame in np.unique(seen.frame):
        of_frame = seen.of(seen.frame == frame)
        _, _, points = error_medians(cameras, of_frame, limits)
        if len(points) > len(best[1]):
            best = int(frame), points
    return best


def _volume(cameras: Sequence[Camera], points: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle (2,) and radius in metres of the people's volume, or of the cameras' common view."""
    if len(points):
        middle = np.median(points[:, :2], axis=0)
        return middle, float(np.quantile(np.linalg.norm(points[:, :2] - middle, axis=-1), 0.95)) + 0.5
    return scene_centre(cameras)[:2], _NOBODY_REACH_M
