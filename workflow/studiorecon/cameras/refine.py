# SPDX-License-Identifier: Apache-2.0
"""``cameras.refine``: check the calibration on the people in it, improve it where that clearly helps, write the camera models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.cameras.correspondences import Observations, observe, spread_frames
from studiorecon.cameras.hypotheses import check_conventions
from studiorecon.cameras.sheet import contact_sheet
from studiorecon.errors import Refusal
from studiorecon.geometry.bundle import BundleSettings, adjust, moved, without_drift
from studiorecon.geometry.correspondence import STABLE_KEYPOINTS
from studiorecon.geometry.triangulation import Limits, triangulate, unit_px
from studiorecon.images.video import read_frame
from studiorecon.progress import say
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, read_manifest
from studiorecon.scene.colmap import write_model
from studiorecon.scene.files import complete, read_json, write_json
from studiorecon.scene.people import Detections, read_detections

_LOOSE = 3.0
_ROUNDS = 2
_FOOT_HEIGHT_M = 0.08


@dataclass(frozen=True)
class Settings:
    """How the calibration is checked and refined.

    Attributes:
        refine: False keeps the given poses whatever the people say.
        refine_frames: frames that are looked at, spread over the clip.
        refine_gate_m: ray distance below which tracks of two cameras may be one person, generous because poses may be off.
        refine_gain: share by which the median reprojection error on frames the fit has not seen must fall for it to be kept.
        max_error_share: median reprojection error, as a share of the longer image side, past which the calibration is refused.
        bundle: iterations and priors.
        limits: what counts as agreement of views.
    """

    refine: bool
    refine_frames: int
    refine_gate_m: float
    refine_gain: float
    max_error_share: float
    bundle: BundleSettings
    limits: Limits


@dataclass(frozen=True)
class Outcome:
    """The cameras to use and everything that is told about it.

    Attributes:
        training, held_out: cameras.
        points_m: (N, 3) triangulated keypoints.
        report: what goes into ``refinement.json``.
    """

    training: list[Camera]
    held_out: list[Camera]
    points_m: np.ndarray
    report: dict[str, Any]


def cameras_of(lenses: Sequence[Lens], footage: Sequence[Footage]) -> list[Camera]:
    """Undistorted working cameras at the given poses, in the order of ``footage``."""
    pose = {lens.name: lens.camera_from_world for lens in lenses}
    for entry in footage:
        if entry.camera not in pose:
            raise Refusal(f"camera {entry.camera} has footage but no calibration (that has {', '.join(pose)})")
    return [Camera(f.camera, f.wh, np.array(f.intrinsics, dtype=np.float64), pose[f.camera]) for f in footage]


def error_medians(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> tuple[float, list[float | None], np.ndarray]:
    """Median reprojection error in pixels over all views and per camera (None: nothing seen), and the points (N, 3) valid there.

    Points need three views where there are three cameras: the residual of a pair says nothing (T13).
    """
    loose = Limits(limits.min_confidence, limits.huber_share, limits.outlier_units * _LOOSE, limits.min_angle_deg, limits.near_m)
    found = triangulate(seen.pixels, seen.confidence, cameras, loose)
    counted = found.verified if len(cameras) > 2 else found.valid
    error = np.where(counted, found.error_px, np.nan)
    per_camera = [float(np.median(row[np.isfinite(row)])) if np.isfinite(row).any() else None for row in error]
    pooled = error[np.isfinite(error)]
    return (float(np.median(pooled)) if len(pooled) else float("nan")), per_camera, found.points_m[counted]


def refine_poses(cameras: Sequence[Camera], seen: Observations, settings: Settings) -> list[Camera]:
    """Cameras bundle-adjusted on ``seen``: loose agreement first, so that a camera that is off can come in, then the usual one.

    A detector misplaces the same joint in the same way in every frame, so all frames of a joint count as one observation. If
    they counted fully, that bias would outvote the calibration in the directions that people hardly determine, such as all
    cameras pitching together: seen as 10 px on marks of a real floor, for no gain on the keypoints.
    """
    current = list(cameras)
    for round_number in range(_ROUNDS):
        loose = _LOOSE if round_number == 0 else 1.0
        limits = settings.limits
        wide = Limits(limits.min_confidence, limits.huber_share, limits.outlier_units * loose, limits.min_angle_deg, limits.near_m)
        found = triangulate(seen.pixels, seen.confidence, current, wide)
        used = found.verified
        if used.sum() < 10 * len(cameras):
            return list(cameras)
        joints = len(np.unique(seen.group[used] * len(STABLE_KEYPOINTS) + seen.keypoint[used]))
        weights = np.where(found.inliers, seen.confidence, 0.0)[:, used] * (joints / used.sum())
        current, _ = adjust(current, seen.pixels[:, used], weights, found.points_m[used], unit_px(current, limits), settings.bundle)
    return without_drift(current, cameras)[0]


def decide(
    training: list[Camera], held_out: list[Camera], detections: Sequence[Detections], frames: int, floor_known: bool, settings: Settings
) -> Outcome:
    """The cameras to use, with the reasons; raises Refusal when the people say that the calibration is not of these cameras."""
    report: dict[str, Any] = {"cameras": [c.name for c in training], "held_out": [c.name for c in held_out], "refined": False}
    if not any(len(d.frame) for d in detections):
        say("no keypoints: the calibration is used as it was given, unchecked")
        return Outcome(training, held_out, np.zeros((0, 3)), {**report, "reason": "no keypoints"})
    chosen = spread_frames(frames, settings.refine_frames)
    report["hypotheses"] = check_conventions(training, detections, chosen[:: max(1, len(chosen) // 6)], settings.refine_gate_m)
    seen, graph = observe(detections, training, chosen, settings.refine_gate_m)
    if not len(seen.frame):
        return _nothing_agrees(training, held_out, graph.distance_m, report, settings)
    before, before_each, points = error_medians(training, seen, settings.limits)
    report |= {"points": len(points), "before_px": before, "before_px_per_camera": before_each}
    adjusted, after = training, before
    if settings.refine and len(training) > 2 and len(points):
        adjusted, report = _try_refinement(training, seen, before, report, settings)
    after, after_each, points = error_medians(adjusted, seen, settings.limits)
    report |= {"after_px": after, "after_px_per_camera": after_each}
    limit = settings.max_error_share * max(max(c.wh) for c in training)
    if after > limit:
        worst = max((e, c.name) for e, c in zip(after_each, training) if e is not None)
        raise Refusal(
            f"the calibration does not fit the footage: people's keypoints are {after:.0f} px off where {limit:.0f} px are allowed, "
            f"worst in camera {worst[1]} ({worst[0]:.0f} px); check that it is for these cameras and this zoom, and that the videos "
            "are synchronised"
        )
    if not floor_known and len(points):
        adjusted, held_out, points = _on_floor(adjusted, held_out, seen, points, settings)
    return Outcome(adjusted, held_out, points, report)


def _nothing_agrees(
    training: list[Camera], held_out: list[Camera], distance_m: np.ndarray, report: dict[str, Any], settings: Settings
) -> Outcome:
    measured = distance_m[~np.isnan(distance_m)]
    if not len(measured):
        say("no person is seen by two cameras at once: the calibration is used as it was given, unchecked")
        return Outcome(training, held_out, np.zeros((0, 3)), {**report, "reason": "no person in two cameras"})
    raise Refusal(
        f"no person of any two cameras fits the calibration: their rays pass {measured.min():.2f} m apart at best, "
        f"{settings.refine_gate_m} m are allowed; check that the calibration is for these cameras, that its lengths are metres and "
        "that the videos are synchronised"
    )


def _try_refinement(
    training: list[Camera], seen: Observations, before: float, report: dict[str, Any], settings: Settings
) -> tuple[list[Camera], dict[str, Any]]:
    """Fit on every other frame, judge on the rest; refit on all frames when it clearly helps."""
    order = np.unique(seen.frame, return_inverse=True)[1]
    fitted, judged = seen.of(order % 2 == 0), seen.of(order % 2 == 1)
    trial = refine_poses(training, fitted, settings)
    judged_before, _, _ = error_medians(training, judged, settings.limits)
    judged_after, _, _ = error_medians(trial, judged, settings.limits)
    report = {**report, "unseen_before_px": judged_before, "unseen_after_px": judged_after}
    if not judged_after < judged_before * (1 - settings.refine_gain):
        say(
            f"the given camera poses are kept: on frames it had not seen, refinement changed the median reprojection error from "
            f"{judged_before:.2f} to {judged_after:.2f} px, less than the {settings.refine_gain:.0%} that would count"
        )
        return training, {**report, "reason": "refinement did not clearly help"}
    refined = refine_poses(training, seen, settings)
    changes = []
    for old, new in zip(training, refined):
        turned = new.camera_from_world[:3, :3] @ old.camera_from_world[:3, :3].T
        degrees = float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(turned - np.eye(3)) / np.sqrt(8)))))
        changes.append({"camera": old.name, "turned_deg": degrees, "moved_m": float(np.linalg.norm(new.centre_m - old.centre_m))})
    say(
        f"the camera poses were refined on people's keypoints: on frames it had not seen the median reprojection error fell from "
        f"{judged_before:.2f} to {judged_after:.2f} px; "
        + ", ".join(f"{c['camera']} by {c['turned_deg']:.2f}° and {1000 * c['moved_m']:.0f} mm" for c in changes)
    )
    return refined, {**report, "refined": True, "reason": "refinement clearly helped", "changes": changes}


def _on_floor(
    training: list[Camera], held_out: list[Camera], seen: Observations, points: np.ndarray, settings: Settings
) -> tuple[list[Camera], list[Camera], np.ndarray]:
    """Everything moved along z so that people's ankles, at their lowest, stand on the floor."""
    floor = float(np.quantile(points[:, 2], 0.02)) - _FOOT_HEIGHT_M
    say(f"the floor was put under people's feet: the world moved by {-floor:.3f} m along z")
    shift = np.array([0.0, 0.0, floor])
    lowered = [[moved(c, c.camera_from_world[:3, :3], c.centre_m - shift) for c in group] for group in (training, held_out)]
    return lowered[0], lowered[1], points - shift


def run(
    settings: Settings,
    calibration: Path,
    manifest: Path,
    detections: list[Path],
    videos: list[Path],
    model: Path,
    heldout_model: Path,
    refinement: Path,
    sheet: Path,
) -> None:
    """Write the COLMAP models ``model`` and ``heldout_model`` (their images.txt), ``refinement`` (JSON) and ``sheet`` (PNG)."""
    import cv2

    found = read_manifest(manifest)
    given = read_json(calibration)
    lenses = [Lens.from_json(v) for v in given["lenses"]]
    training, held_out = cameras_of(lenses, found.training), cameras_of(lenses, found.held_out)
    outcome = decide(
        training, held_out, [read_detections(p) for p in detections], found.frames, bool(given.get("floor_known", True)), settings
    )
    by_name = {p.stem: p for p in videos}
    pictures = [read_frame(by_name[c.name], found.frames // 2) if c.name in by_name else None for c in outcome.training]
    picture = contact_sheet(outcome.training, outcome.held_out, pictures, outcome.points_m, outcome.report)
    write_model(model.parent, outcome.training, outcome.points_m)
    write_model(heldout_model.parent, outcome.held_out)
    write_json(refinement, {**outcome.report, "calibration": {k: given.get(k) for k in ("source", "format", "notes")}})
    with complete(sheet) as partial:
        cv2.imwrite(str(partial), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
