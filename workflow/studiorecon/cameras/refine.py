# SPDX-License-Identifier: Apache-2.0
"""``cameras.refine``: checks the calibration on people, refines it if that clearly helps, writes camera models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.camera_files.colmap import write_model
from studiorecon.cameras.calibration_check import Check, Settings
from studiorecon.cameras.changes import estimate_report, log_changes
from studiorecon.errors import UserError
from studiorecon.estimate.factors.poses import ANKLE_HEIGHT_M
from studiorecon.footage.video import read_frame
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.images.encoded import write_png
from studiorecon.progress import say, warn
from studiorecon.rig.active_cameras import active_cameras, inactive_camera_notes
from studiorecon.rig.agreement import error_medians
from studiorecon.rig.contact_sheet import contact_sheet
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.gravity import check_tilt
from studiorecon.rig.human_size import check_human_size
from studiorecon.rig.outlier_camera import warn_of_outlier_cameras
from studiorecon.rig.room_picture import RoomPicture, make_room_picture
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, read_manifest
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Refinement:
    """The cameras to use, and the report about them.

    Attributes:
        training, held_out: cameras.
        points_m: (N, 3) triangulated keypoints.
        report: the content of ``refinement.json``.
    """

    training: list[Camera]
    held_out: list[Camera]
    points_m: Float[np.ndarray, "N 3"]
    report: dict[str, Any]


def pinhole_cameras(lenses: Sequence[Lens], footage: Sequence[Footage]) -> list[Camera]:
    """Undistorted working cameras at the given poses, in the order of ``footage``."""
    pose = {lens.name: lens.camera_from_world for lens in lenses}
    for entry in footage:
        if entry.camera not in pose:
            raise UserError(f"camera {entry.camera} has footage but no calibration (that has {', '.join(pose)})")
    return [Camera(f.camera, f.wh, np.array(f.intrinsics, dtype=np.float64), pose[f.camera]) for f in footage]


def decide(
    training: list[Camera],
    held_out: list[Camera],
    detections: Sequence[Detections],
    frames: int,
    fps: float,
    floor_known: bool,
    settings: Settings,
    rooms: Sequence[RoomPicture | None] = (),
) -> Refinement:
    """The cameras to use, with the reasons; raises UserError when people show that the calibration is of other cameras.
    ``rooms``: the room in each training camera, where there are pictures of it."""
    names = [c.name for c in training]
    report: dict[str, Any] = {"cameras": names, "held_out": [c.name for c in held_out], "refined": False}
    if not any(len(d.frame) for d in detections):
        warn("no keypoints: the calibration is used as it was given, unchecked")
        return Refinement(training, held_out, np.zeros((0, 3)), {**report, "reason": "no keypoints"})
    unwatched, watched = inactive_camera_notes(detections, fps), active_cameras(detections, fps)
    for sentence in unwatched.values():
        warn(sentence)
    if len(watched) < 2:
        return _given_cameras(training, held_out, report)
    chosen = spread_indices(frames, settings.frames)
    seen, graph = make_observations(detections, training, chosen, settings.gate_m)
    medians = error_medians(training, seen, settings.limits)
    check = Check(training, detections, chosen, seen, *medians, settings)
    found = check.refined(watched, rooms)
    compared = check.refuse_other_starts(found)
    report |= {"hypotheses": compared.rows(), "margin": compared.margin}
    if found is None and not len(seen.frame):
        own = np.isin(graph.view, watched)
        return _nothing_agrees(training, held_out, graph.distance_m[np.ix_(own, own)], report, settings)
    adjusted = training
    report["points"] = len(check.points_m)
    report["before_px"] = check.median_px if np.isfinite(check.median_px) else None
    report["before_px_per_camera"] = check.per_camera_px
    if found is not None:
        adjusted, (seen, _) = found.cameras, make_observations(found.detections, found.cameras, chosen, settings.gate_m)
        report |= estimate_report(
            found.estimate, [training[v] for v in watched], [rooms[v] for v in watched] if len(rooms) else ()
        )
        log_changes(report)
    after_px, per_camera_px, points = error_medians(adjusted, seen, settings.limits)
    report |= {"after_px": after_px, "after_px_per_camera": per_camera_px}
    if after_px > check.limit_px:
        worst_px, worst = max((e, name) for e, name in zip(per_camera_px, names) if e is not None)
        raise UserError(
            f"the calibration does not fit the footage: people's keypoints are {after_px:.0f} "
            f"px off where {check.limit_px:.0f} px are allowed, "
            f"worst in camera {worst} ({worst_px:.0f} px); check that it is for these "
            "cameras and this zoom, and that the videos "
            "are synchronised"
        )
    warned = [name in unwatched for name in names]
    warn_of_outlier_cameras(adjusted, seen, detections, per_camera_px, check.limit_px, settings.limits, warned)
    report["stature_m"] = check_human_size(adjusted, seen, settings.limits)
    report["tilt_deg"] = check_tilt(adjusted, seen, settings.limits)
    if not floor_known and len(points):
        adjusted, held_out, points = _move_to_floor(adjusted, held_out, seen, points, settings)
    return Refinement(adjusted, held_out, points, report)


def _given_cameras(training: list[Camera], held_out: list[Camera], report: dict[str, Any]) -> Refinement:
    warn("no person is visible in two cameras at once: the calibration is used as given, unchecked")
    return Refinement(training, held_out, np.zeros((0, 3)), {**report, "reason": "no person in two cameras"})


def _nothing_agrees(
    training: list[Camera], held_out: list[Camera], distance_m: np.ndarray, report: dict[str, Any], settings: Settings
) -> Refinement:
    measured = distance_m[~np.isnan(distance_m)]
    if not len(measured):
        return _given_cameras(training, held_out, report)
    raise UserError(
        f"no person of any two cameras fits the calibration: their rays pass {measured.min():.2f} m apart at best, "
        f"{settings.gate_m} m are allowed; check that the calibration is for these cameras, that its lengths are "
        "metres and that the videos are synchronised"
    )


def _move_to_floor(
    training: list[Camera], held_out: list[Camera], seen: Observations, points: np.ndarray, settings: Settings
) -> tuple[list[Camera], list[Camera], np.ndarray]:
    """Cameras and points moved along z so that people's ankles, at their lowest, are on the floor."""
    floor = float(np.quantile(points[:, 2], 0.02)) - ANKLE_HEIGHT_M
    say(f"the floor is at people's feet: the world moved by {-floor:.3f} m along z")
    shift = np.array([0.0, 0.0, floor])
    lowered = [
        [move_camera(c, c.camera_from_world[:3, :3], c.centre_m - shift) for c in group]
        for group in (training, held_out)
    ]
    return lowered[0], lowered[1], points - shift


def run(
    settings: Settings,
    calibration: Path,
    manifest: Path,
    detections: list[Path],
    videos: list[Path],
    plates: list[Path],
    model: Written,
    heldout_model: Written,
    refinement: Written,
    sheet: Written,
) -> None:
    """Write ``model`` and ``heldout_model`` (COLMAP's images.txt), ``refinement`` (JSON) and ``sheet`` (PNG);
    ``plates`` are the training cameras'."""

    found = read_manifest(manifest)
    given = read_calibration(calibration)
    lenses = list(given.lenses.values())
    training, held_out = pinhole_cameras(lenses, found.training), pinhole_cameras(lenses, found.held_out)
    looks = {path.stem: make_room_picture(path) for path in plates}
    kept, rooms = [read_detections(path) for path in detections], [looks.get(c.name) for c in training]
    outcome = decide(training, held_out, kept, found.frames, found.fps, given.floor_known, settings, rooms)
    by_name = {p.stem: p for p in videos}
    pictures = [read_frame(by_name[c.name], found.frames // 2) if c.name in by_name else None for c in outcome.training]
    picture = contact_sheet(outcome.training, outcome.held_out, pictures, outcome.points_m, outcome.report)
    write_model(model.parent, outcome.training, outcome.points_m)
    write_model(heldout_model.parent, outcome.held_out)
    write_json(refinement, {**outcome.report, "calibration": given.about})
    write_png(sheet, picture)
