# SPDX-License-Identifier: Apache-2.0
"""Detects objects that look like people from all sides: a picture on a wall, a screen, a mirror image, a duplicate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# Skeletons within this distance of each other in the median over joints and shared frames, metres, are duplicates.
_SAME_PLACE_M = 0.12
# A person's joints, nose, ears, heels and toes deviate from their common plane by more than this, metres (root mean
# square; the bundled body with its arms hanging by 69 mm, filmed people by 84 to 270 mm). A poster's and a screen's
# deviate by noise (filmed: 16 and 25 mm).
_FLAT_M = 0.045
_DEEP = ("nose", "left_ear", "right_ear", "left_heel", "right_heel", "left_big_toe", "right_big_toe")
# Joints are averaged over so long before that, seconds, so that noise does not count as depth.
_CALM_S = 0.25
_MIN_JOINTS = 8
# A mirror image follows a person within this, metres, who must have moved by so much across, and for so long, metres
# and seconds.
_MIRRORED_M, _MOVED_M, _LASTING_S = 0.1, 0.3, 1.0
FOUND_TWICE = "it is at the same place as another person: one person, detected twice"
"""Why somebody is nobody who is not left out either: he or she is there under another number."""
_OTHER_SIDE = [
    STABLE_KEYPOINTS.index(k.replace(*("left", "right") if k.startswith("left") else ("right", "left")))
    for k in STABLE_KEYPOINTS
]


def is_duplicate(points_m: Float[np.ndarray, "T 12 3"], other_m: Float[np.ndarray, "T 12 3"]) -> bool:
    """Whether two skeletons (T, 12, 3) are at the same position wherever both are known."""
    apart = np.linalg.norm(points_m - other_m, axis=-1)
    apart = apart[np.isfinite(apart)]
    return len(apart) >= _MIN_JOINTS and float(np.median(apart)) < _SAME_PLACE_M


def flatness_m(points_m: Float[np.ndarray, "T K 3"], fps: float) -> float:
    """RMS distance of joints (T, K, 3) of the whole clip from their best-fitting plane; NaN where too few are known."""
    length = max(1, round(_CALM_S * fps))
    moments = []
    for block in np.array_split(points_m, max(1, len(points_m) // length)):
        known = np.isfinite(block).all(-1)
        enough = known.sum(0) >= max(1, 0.5 * len(block))
        if enough.sum() >= _MIN_JOINTS:
            moments.append(np.array([np.median(block[known[:, k], k], axis=0) for k in np.flatnonzero(enough)]))
    if not moments:
        return float("nan")
    joints = np.concatenate(moments)
    return float(np.linalg.svd(joints - joints.mean(0), compute_uv=False)[2] / np.sqrt(len(joints)))


def is_flat(points_m: Float[np.ndarray, "T 12 3"], deep_m: Float[np.ndarray, "T D 3"], fps: float) -> bool:
    """Whether all joints (T, 12, 3) and extremities (T, D, 3) are in one plane in all frames: a picture, or a screen.

    Joints alone do not decide: a person with spread arms is flat to 8 mm.
    """
    described = np.isfinite(deep_m).all(-1).mean(0) >= 0.5
    return described.any() and flatness_m(np.concatenate([points_m, deep_m[:, described]], axis=1), fps) < _FLAT_M


def deep_points_m(
    members: Sequence[tuple[int, int]],
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    agree: Limits,
) -> Float[np.ndarray, "T 7 3"]:
    """(T, 7, 3) nose, ears, heels and toes of the tracks ``members`` (view, track), NaN unless two cameras determine
    them."""
    pixels = np.full((len(cameras), frames, len(_DEEP), 3), [np.nan, np.nan, 0.0])
    for view, track in members:
        found = detections[view]
        which = np.flatnonzero(found.track == track)
        for k, name in enumerate(_DEEP):
            if name in LAYOUTS[found.layout].keypoints:
                pixels[view, found.frame[which], k] = found.keypoints[
                    which, LAYOUTS[found.layout].keypoints.index(name)
                ]
    flat = pixels.reshape(len(cameras), -1, 3)
    return triangulate(flat[..., :2], flat[..., 2], cameras, agree).points_m.reshape(frames, len(_DEEP), 3)


def is_mirror_image(
    points_m: Float[np.ndarray, "T 12 3"],
    other_m: Float[np.ndarray, "T 12 3"],
    centres_m: Float[np.ndarray, "V 3"],
    fps: float,
) -> bool:
    """Whether ``points_m`` (T, 12, 3) are a plane mirror's image of ``other_m``, left for right, with all cameras on
    one side.

    ``centres_m`` (V, 3): the cameras, on the side of ``other_m``. Only a person who moved in front of the mirror can be
    distinguished from two people in symmetric positions.
    """
    true = other_m[:, _OTHER_SIDE]
    known = np.isfinite(points_m).all(-1) & np.isfinite(true).all(-1)
    if (known.sum(1) >= 3).sum() < _LASTING_S * fps:
        return False
    image, original = points_m[known], true[known]
    across, middle = image - original, (image + original) / 2
    normal = np.linalg.svd(across, full_matrices=False)[2][0]
    normal = normal * np.sign(np.median(across @ normal))
    offset = float(np.median(middle @ normal))
    expected = original - 2 * ((original @ normal) - offset)[:, None] * normal
    moved: Any = np.linalg.norm(np.ptp(np.quantile(original, [0.05, 0.95], axis=0), axis=0))
    height = float(np.ptp(np.quantile(original[:, 2], [0.05, 0.95])))
    beside = np.sqrt(max(moved**2 - height**2, 0.0))
    return bool(
        beside > _MOVED_M
        and np.median(np.linalg.norm(image - expected, axis=-1)) < _MIRRORED_M
        and (centres_m @ normal < offset).all()
    )


def rejection_reason(
    points_m: Float[np.ndarray, "T 12 3"],
    deep_m: Float[np.ndarray, "T D 3"],
    people_m: Sequence[Float[np.ndarray, "T 12 3"]],
    others_m: Sequence[Float[np.ndarray, "T 12 3"]],
    centres_m: Float[np.ndarray, "V 3"],
    fps: float,
) -> str:
    """Why a skeleton is not a person, as the end of a sentence; "" when it may be.

    ``people_m``: skeletons accepted before it; ``others_m``: all others that may be people.
    """
    if any(is_duplicate(points_m, other_m) for other_m in people_m):
        return FOUND_TWICE
    if any(is_mirror_image(points_m, other_m, centres_m, fps) for other_m in others_m):
        return "it is another person's mirror image: left and right exchanged, and behind the mirror for every camera"
    if is_flat(points_m, deep_m, fps):
        return "it is flat: all its points are in one plane, as on a poster or a screen"
    return ""
