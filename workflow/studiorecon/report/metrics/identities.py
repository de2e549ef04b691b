# SPDX-License-Identifier: Apache-2.0
"""Scores identities against a synthetic studio's truth or the user's table, in training and held-out cameras.

In the training cameras it scores the association of detections, in held-out ones the bodies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.footage.video import read_frames
from studiorecon.images.warp import sample
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.report.metrics.identity_scores import identity_scores
from studiorecon.report.metrics.pck import TruePerson, score_keypoints
from studiorecon.report.metrics.truth import TrueView, true_pixels
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, whole_track

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# A detection further than this share of a person's height from every true person's limbs is a false one.
_SAME = 0.25
_LIMBS = [
    f"{side}_{limb}" for side in ("left", "right") for limb in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
]
NOBODY = -1


def match_true_person(points: Float[np.ndarray, "K 2"], people: Float[np.ndarray, "P K 2"]) -> int:
    """Index of the true person whose points are closest in the median; -1 when all are far or unknown.

    Far means beyond a quarter of the person's height in the picture. Points that are NaN on either side are left out.
    """
    best, nearest = NOBODY, math.inf
    for index, person in enumerate(people):
        both = np.isfinite(points).all(axis=-1) & np.isfinite(person).all(axis=-1)
        if both.sum() < 3:
            continue
        gap = float(np.median(np.linalg.norm(points[both] - person[both], axis=-1)))
        height = float(np.ptp(person[np.isfinite(person).all(axis=-1)], axis=0).max())
        if gap <= _SAME * height and gap < nearest:
            best, nearest = index, gap
    return best


def score_identities(
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    cameras: Mapping[str, Camera],
    joints_m: Mapping[str, Float[np.ndarray, "T 24 3"]],
) -> dict[str, Any]:
    """Accuracy, precision, IDF1 and switches of the detections' identities; None where they cannot be computed.

    A detection belongs to the true person whose projected limbs it overlaps.
    """
    # Rejected tracks have no name, and do not form an identity together.
    names = sorted(set(identities.values()) - {""})
    people = [joints_m[name] for name in sorted(joints_m)]
    rows: list[tuple[int, int, int, int]] = []
    for view, found in enumerate(detections):
        keypoints = LAYOUTS[found.layout].keypoints
        limbs = [name for name in _LIMBS if name in keypoints or f"{name}_joint" in keypoints]
        columns = [keypoints.index(name if name in keypoints else f"{name}_joint") for name in limbs]
        joints = [JOINT_NAMES.index(name) for name in limbs]
        projected = [cameras[found.camera].project(person[:, joints])[0] for person in people]
        for frame, track, points in zip(found.frame, found.track, found.keypoints):
            here = np.array([p[frame] for p in projected if frame < len(p)])
            given = identities.get((found.camera, int(track)), "")
            rows.append(
                (
                    frame,
                    view,
                    match_true_person(points[columns, :2], here),
                    names.index(given) if given else NOBODY,
                )
            )
    return _scores(rows, detections)


def score_against(
    detections: Sequence[Detections],
    annotated: Mapping[tuple[str, int], str],
    identities: Mapping[tuple[str, int], str],
) -> dict[str, Any]:
    """The same scores of association's own ``identities`` against the user's table, ``annotated``.

    Tracks that the table marks as no person are false detections; those it does not list are left out (paper's table).
    """
    names, found = sorted({*annotated.values()} - {""}), sorted({*identities.values()} - {""})
    rows: list[tuple[int, int, int, int]] = []
    for view, seen in enumerate(detections):
        for frame, track in zip(seen.frame.tolist(), seen.track.tolist()):
            if (who := annotated.get((seen.camera, track))) is not None:
                given = identities.get((seen.camera, whole_track(track)), "")
                true = names.index(who) if who else NOBODY
                rows.append((frame, view, true, found.index(given) if given else NOBODY))
    return _scores(rows, detections)


def _scores(rows: Sequence[tuple[int, int, int, int]], detections: Sequence[Detections]) -> dict[str, Any]:
    """All scores of rows of frame, view, true and given person, in the form of the JSON."""
    if not rows:
        return {"accuracy": None, "precision": None, "idf1": None, "reason": "there are no detections"}
    values = asdict(identity_scores(*np.array(rows).T))
    values["idf1_per_view"] = {detections[view].camera: value for view, value in values["idf1_per_view"].items()}
    plain = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
    return plain | {"reason": None if plain["accuracy"] is not None else "no person was seen by two cameras at once"}


def true_people(
    view: TrueView, camera: Camera, joints_m: Mapping[str, Float[np.ndarray, "T 24 3"]], first_frame: int, frames: int
) -> list[list[TruePerson]]:
    """The true people in one picture per working frame, with visible joints and the box of their mask.

    A joint counts when the pixel it projects to shows that person. Person k of the truth (in order of name) has mask
    value k + 1.
    """
    pixels = true_pixels(camera, view.camera)
    projected = [camera.project(joints_m[name])[0] for name in sorted(joints_m)]
    found = []
    for frame, mask in enumerate(read_frames(view.masks, first_frame, first_frame + frames)):
        labels, inside = sample(mask, pixels, "nearest")
        here = []
        for index, points in enumerate(projected):
            mine = inside & (labels == index + 1)
            if frame >= len(points) or not mine.any():
                continue
            rows, columns = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
            box_wh = (float(columns[-1] - columns[0] + 1), float(rows[-1] - rows[0] + 1))
            hit, on_picture = sample(mine, points[None, frame], "nearest")
            here.append(TruePerson(points[frame], (hit & on_picture)[0], box_wh))
        found.append(here)
    return found


def score_bodies_in_pictures(
    views: Mapping[str, TrueView],
    cameras: Sequence[Camera],
    fitted: Mapping[str, tuple[Float[np.ndarray, "T 24 3"], Bool[np.ndarray, " T"]]],
    joints_m: Mapping[str, Float[np.ndarray, "T 24 3"]],
    first_frame: int,
    frames: int,
) -> dict[str, Any]:
    """PCK and detection rate of the fitted joints, projected into the held-out cameras, against the true ones.

    Unlike the paper's PCK, which runs a detector on the rendered pictures, it scores positions and not appearance.
    """
    pictures = []
    for camera in cameras:
        projected = [(camera.project(joints)[0], valid) for joints, valid in fitted.values()]
        for frame, people in enumerate(true_people(views[camera.name], camera, joints_m, first_frame, frames)):
            pictures.append(([p[frame] for p, valid in projected if frame < len(valid) and valid[frame]], people))
    return score_keypoints(pictures)
