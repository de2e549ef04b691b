# SPDX-License-Identifier: Apache-2.0
"""``cameras.held_out``: checks the poses of the held-out cameras, and corrects them on people where clearly needed.

Scores at a camera that was moved since it was calibrated measure nothing about the reconstruction. So the detector
searches a few of its pictures at the positions of people from the other cameras. Its detections move this camera alone:
none of its pictures affects the reconstruction. People's many joints determine six numbers, which improves people's
scores slightly where a camera is moved; the page names every moved one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.camera_files.colmap import read_model, write_model
from studiorecon.cameras import refine
from studiorecon.detector.blazepose import LAYOUT, BlazePose
from studiorecon.detector.crops import region_of_body
from studiorecon.detector.frame_detection import detect_in_region
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import keypoints_with_confidence
from studiorecon.footage.video import read_frame
from studiorecon.geometry.triangulation import triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.progress import progress, say, warn
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.held_out_pose import HeldOutPose, ObservedJoints, estimate_held_out_pose
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_STABLE = [LAYOUTS[LAYOUT].index(name) for name in STABLE_KEYPOINTS]


@dataclass(frozen=True)
class Settings(refine.Settings):
    """As for the training cameras; another pose must lower the error of validation halves by the share ``min_gain``."""

    min_gain: float = 0.1


@dataclass(frozen=True)
class Bodies:
    """Joints of all people that the training cameras place: (G, F, 12, 3) metres, NaN unknown, in the frames ``frame``
    (F,)."""

    frame: Integer[np.ndarray, " F"]
    points_m: Float[np.ndarray, "G F 12 3"]

    def at(self, frame: int, late_frames: float) -> Float[np.ndarray, "G 12 3"]:
        """Joints ``late_frames`` after a frame, interpolated to the next one."""
        here = int(np.searchsorted(self.frame, frame))
        beside = here + int(np.sign(late_frames))
        if not late_frames or not 0 <= beside < len(self.frame) or abs(self.frame[beside] - frame) != 1:
            return self.points_m[:, here]
        step = self.points_m[:, beside] - self.points_m[:, here]
        return np.where(np.isfinite(step), self.points_m[:, here] + abs(late_frames) * step, self.points_m[:, here])


def triangulate_bodies(
    frames: Integer[np.ndarray, " F"], training: Sequence[Camera], detections: Sequence[Detections], settings: Settings
) -> Bodies:
    """Joints on which the training cameras agree, in ``frames`` and their neighbours."""
    wanted = np.unique(np.concatenate([frames - 1, frames, frames + 1]))
    wanted = wanted[(wanted >= 0)]
    seen, _ = make_observations(detections, training, wanted, settings.gate_m)
    people = int(seen.group.max(initial=-1)) + 1
    points = np.full((people, len(wanted), len(STABLE_KEYPOINTS), 3), np.nan)
    if len(seen.frame):
        found = triangulate(seen.pixels, seen.confidence, training, settings.limits)
        sure = found.verified if len(training) > 2 else found.valid
        points[seen.group[sure], np.searchsorted(wanted, seen.frame[sure]), seen.keypoint[sure]] = found.points_m[sure]
    return Bodies(wanted, points)


def redetect(
    network: BlazePose,
    worth: dict[str, list[float]],
    camera: Camera,
    frames: Sequence[int],
    pictures: Sequence[Integer[np.ndarray, "H W 3"]],
    bodies: Bodies,
    late_frames: Float[np.ndarray, " F"],
) -> tuple[ObservedJoints, int]:
    """The network's detections in ``pictures`` of ``frames`` at the projected ``bodies``, and the number of places
    searched.

    The projection uses the camera as given.
    """
    rows, places = [], 0
    for frame, picture in zip(frames, pictures):
        everybody = bodies.at(frame, float(late_frames[frame]))
        for group, points in enumerate(everybody):
            pixels = camera.project(points)[0]
            region = region_of_body(dict(zip(STABLE_KEYPOINTS, pixels)), camera.wh)
            if region is None:
                continue
            places += 1
            first = detect_in_region(network, picture, region)
            # The network's own region is better, especially if the camera's pose is wrong.
            seen = (detect_in_region(network, picture, first.next_region) or first) if first is not None else None
            if seen is None:
                continue
            keypoints = keypoints_with_confidence(seen, camera.wh, worth)[_STABLE]
            for k in np.flatnonzero((keypoints[:, 2] > 0) & np.isfinite(points).all(-1)):
                rows.append((points[k], keypoints[k, :2], keypoints[k, 2], frame, group, k))
    columns = list(zip(*rows)) if rows else [()] * 6
    shapes = ((-1, 3), (-1, 2), (-1,), (-1,), (-1,), (-1,))
    kinds = (float, float, float, int, int, int)
    return ObservedJoints(
        *(np.array(c, dtype=kind).reshape(shape) for c, kind, shape in zip(columns, kinds, shapes))
    ), places


def pose_sentence(camera: str, found: HeldOutPose, places: int) -> str:
    """One sentence about a held-out camera."""
    if not found.is_verified:
        why = (
            "no person is expected in its pictures"
            if not places
            else f"too few people were detected at {places} places"
        )
        return (
            f"held-out camera {camera} is used as calibrated, unchecked: {why} where the other "
            "cameras see people; if it was moved, its scores are meaningless"
        )
    if not (found.turned_deg or found.moved_m):
        return f"held-out camera {camera} has not moved since calibration: joints {found.before_px:.1f} px off"
    return (
        f"held-out camera {camera} has moved since calibration, by {found.turned_deg:.2f}° and "
        f"{100 * found.moved_m:.0f} cm: joints {found.before_px:.1f} px off, {found.after_px:.1f} "
        "px at the pose used for scoring"
    )


def run(
    settings: Settings,
    manifest: Path,
    clocks: Path,
    model: Path,
    given_model: Path,
    detections: list[Path],
    videos: list[Path],
    detector: DetectorFiles,
    heldout_model: Written,
    poses: Written,
) -> None:
    """Write the COLMAP model ``heldout_model`` (its images.txt) and ``poses`` (JSON: the result for every camera).

    ``given_model``: images.txt of the held-out cameras as calibrated; ``videos``: theirs; ``detections``: those of the
    training cameras, ``model``.
    """
    cameras, training = read_model(given_model.parent), read_model(model.parent)
    common, frames = read_clocks(clocks), read_manifest(manifest).frames
    seen = [read_detections(path) for path in detections]
    found: list[dict[str, Any]] = []
    used: list[Camera] = []
    film = {path.stem: path for path in videos}
    look = settings.refine and bool(film) and any(len(d.frame) for d in seen)
    network = detector.placer() if look else None
    # Pictures that are searched in every held-out camera.
    chosen = spread_indices(frames, 12)
    bodies = triangulate_bodies(chosen, training, seen, settings) if look else None
    for camera in progress(cameras, "held-out cameras"):
        if network is None or bodies is None:
            used.append(camera)
            continue
        pictures = [read_frame(film[camera.name], int(frame)) for frame in chosen]
        late = common.late_frames(camera.name)
        sighted, places = redetect(network, detector.worth(), camera, chosen.tolist(), pictures, bodies, late)
        answer = estimate_held_out_pose(camera, sighted, settings.limits, settings.pose_error)
        sentence = pose_sentence(camera.name, answer, places)
        (warn if answer.turned_deg or not answer.is_verified else say)(sentence)
        about = {name: value for name, value in asdict(answer).items() if name != "camera"}
        found.append({"camera": camera.name, **about, "places": places, "sentence": sentence})
        used.append(answer.camera)
    write_model(heldout_model.parent, used)
    write_json(poses, {"cameras": found})
