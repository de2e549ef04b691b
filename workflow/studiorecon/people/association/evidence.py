# SPDX-License-Identifier: Apache-2.0
"""Is somebody in the picture where the keypoints say so? Where a limb has left, or arrived, the picture must have
changed.

No plate is needed, and who stands still is not judged: only limbs that moved by decimetres in the world count, where
the person's own body, and everybody else's, is away from the place in the other picture. A skeleton of nobody (left
over from another take) moves over a picture that stays the same; it can be consistent in all views to a pixel, so
geometry alone cannot tell. Keypoints that wander over somebody who stands say nothing: their cameras do not agree on
where they went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera

_BLUR_PX = 1.5
# Between noise, of which a change must be this many deviations, and what anybody would see: grey levels of 255.
_NOISES, _FAINTEST = 6.0, 10.0
# A joint's place is looked at within this of it, metres; limbs, and trunk and head, reach this far from their bones.
_PLACE_M, _LIMB_M, _TRUNK_M = 0.03, 0.05, 0.15
# Other people count as so much wider: clothes, hair, shadows.
_CLOTHED = 2.0
# A joint has moved when it did by so many deviations of its wandering from picture to picture, taken where nine tenths
# are below.
_WANDERINGS = 4.0
_LEAST_PLACES = 20
_LEAST_VIEWS = 2
_AT = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
_LIMBS = [
    (_AT[f"{s}_{a}"], _AT[f"{s}_{b}"])
    for s in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
]
_TRUNK = [
    (_AT[f"{a}_{i}"], _AT[f"{b}_{j}"])
    for a, i, b, j in (
        ("left", "shoulder", "left", "hip"),
        ("right", "shoulder", "right", "hip"),
        ("left", "shoulder", "right", "shoulder"),
        ("left", "hip", "right", "hip"),
    )
]
# The head is as far beyond the middle of the shoulders as this share of the trunk.
_HEAD_SHARE = 0.6


@dataclass(frozen=True)
class EvidenceLimits:
    """When pictures contradict keypoints.

    Attributes:
        frames: pictures of every camera that are compared: where a joint has moved, the picture must have changed; 0 =
            no test.
        step_m: how far a joint must have moved between two pictures, metres.
        difference: grey levels (of 255) by which the picture must have changed there; less in cameras with little
            noise.
        absent_share, present_share: below the first on average nobody is there, unless one camera is above the second:
            there somebody is.
    """

    frames: int = 8
    step_m: float = 0.06
    difference: float = 28
    absent_share: float = 0.5
    present_share: float = 0.75


def sampled_frames(frames: np.ndarray, wanted: int) -> np.ndarray:
    """At most ``wanted`` of the distinct ``frames``, evenly spread."""
    distinct = np.unique(frames)
    if not len(distinct) or not wanted:
        return distinct[:0]
    return distinct[evenly_spread(len(distinct), wanted)]


def steps_m(points_m: np.ndarray, limits: EvidenceLimits) -> np.ndarray:
    """(K,) how far each of the points (T, K, 3) must have moved to count, metres: well beyond how it wanders from frame
    to frame.

    Noise and hasty motion alike: either way a smaller step says nothing about where somebody is.
    """
    bent = points_m[:-2] - 2 * points_m[1:-1] + points_m[2:]
    size = np.linalg.norm(bent, axis=-1)
    known = [column[np.isfinite(column)] for column in size.T]
    wandering = np.array([np.quantile(k, 0.9) / np.sqrt(6) if len(k) else 0.0 for k in known])
    return np.maximum(limits.step_m, _WANDERINGS * wandering)


def motion_support(
    pictures: Sequence[np.ndarray],
    points_m: np.ndarray,
    who: int,
    step_m: np.ndarray,
    camera: Camera,
    limits: EvidenceLimits,
) -> np.ndarray:
    """(2,) how many places that a joint of person ``who`` left or reached show a change, and how many places there are.

    ``pictures`` are (H, W, 3) uint8 of ``camera``, ``points_m`` (G, F, 12, 3) everybody's stable keypoints in each of
    them, NaN where unknown; ``step_m`` (12,) is how far each must have moved. Every two pictures are compared, after a
    little blur and without their median colour (exposure).
    """
    blurred = [cv2.GaussianBlur(p, (0, 0), _BLUR_PX).astype(np.float32) for p in pictures]
    smooth = [b - np.median(b[::4, ::4], axis=(0, 1)) for b in blurred]
    pixels, depth = camera.project(points_m)
    pixels = np.where(depth[..., None] > 0, pixels, np.nan)
    metre_px = camera.intrinsics[0, 0] / np.maximum(
        np.nan_to_num(_middle(depth[..., None])[..., 0], nan=np.inf), 1e-6
    )  # (G, F)
    counts, own = np.zeros(2, dtype=int), points_m[who]
    rest = np.arange(len(points_m)) != who
    for a, b in combinations(range(len(pictures)), 2):
        moved = np.linalg.norm(own[a] - own[b], axis=-1) > step_m
        if not moved.any():
            continue
        apart = np.abs(smooth[a] - smooth[b]).max(-1)
        threshold = float(np.clip(_NOISES * 1.4826 * np.median(apart[::4, ::4]), _FAINTEST, limits.difference))
        for here, other in ((a, b), (b, a)):
            places = pixels[who, here, moved]
            uncovered = _outside(places, pixels[who, [other]], metre_px[who, [other]])
            for t in (a, b):
                uncovered &= _outside(places, pixels[rest, t], _CLOTHED * metre_px[rest, t])
            radius = max(1, round(_PLACE_M * float(metre_px[who, here])))
            counts += _changed(apart, places[uncovered], radius, threshold)
    return counts


def _middle(values: np.ndarray) -> np.ndarray:
    """Mean of the known entries of the last axis but one, NaN where there is none."""
    known = np.isfinite(values).all(-1, keepdims=True)
    return np.where(known.any(-2), np.where(known, values, 0.0).sum(-2) / np.maximum(known.sum(-2), 1), np.nan)


def _outside(places: np.ndarray, skeletons: np.ndarray, metre_px: np.ndarray) -> np.ndarray:
    """(N,) which places (N, 2) are outside of all known limbs, trunks and heads of ``skeletons`` (S, 12, 2);
    ``metre_px`` (S,) pixels."""
    free = np.isfinite(places).all(-1)
    for joints, scale in zip(skeletons, metre_px):
        shoulders, hips = (_middle(joints[[_AT[f"left_{j}"], _AT[f"right_{j}"]]]) for j in ("shoulder", "hip"))
        parts = [(joints[i], joints[j], _LIMB_M) for i, j in _LIMBS] + [(j, j, _LIMB_M) for j in joints]
        parts += [(joints[i], joints[j], _TRUNK_M) for i, j in _TRUNK]
        parts += [(shoulders, hips, _TRUNK_M), (shoulders, shoulders + _HEAD_SHARE * (shoulders - hips), _TRUNK_M)]
        for first, second, reach_m in parts:
            if np.isfinite(first).all() and np.isfinite(second).all():
                along = second - first
                share = np.clip(((places - first) @ along) / max(float(along @ along), 1e-9), 0, 1)
                free &= ~(np.linalg.norm(places - first - share[:, None] * along, axis=-1) <= reach_m * scale)
    return free


def _changed(apart: np.ndarray, places: np.ndarray, radius: int, threshold: float) -> np.ndarray:
    """(2,) how many of the places (N, 2) inside the picture show a change within ``radius`` pixels, and how many are
    inside."""
    columns, rows = np.floor(places).astype(int).reshape(-1, 2).T
    inside = (columns >= 0) & (columns < apart.shape[1]) & (rows >= 0) & (rows < apart.shape[0])
    around = [
        apart[max(r - radius, 0) : r + radius + 1, max(c - radius, 0) : c + radius + 1]
        for r, c in zip(rows[inside], columns[inside])
    ]
    return np.array([sum(float(part.max()) > threshold for part in around), int(inside.sum())])


def view_shares(counts: np.ndarray) -> np.ndarray:
    """(V,) supported share of every view from (V, 2) counts; NaN with fewer than twenty places to judge."""
    judged = counts[:, 1] >= _LEAST_PLACES
    return np.where(judged, counts[:, 0] / np.maximum(counts[:, 1], 1), np.nan)


def absent(shares: np.ndarray, limits: EvidenceLimits) -> list[bool]:
    """For every person, from the shares (G, V) of every view, whether the pictures say that nobody is there.

    Only where two views can judge, none of them confirms, and the same views confirm somebody else: videos that are
    badly lit, or out of step with the keypoints, contradict everybody, and then contradict nobody.
    """
    out = []
    for g, own in enumerate(shares):
        others = np.delete(shares, g, axis=0)
        trusted = (np.nan_to_num(others, nan=0.0) >= limits.present_share).any(0)
        judged = np.isfinite(own) & trusted
        seen = own[np.isfinite(own)]
        doubted = judged.sum() >= _LEAST_VIEWS and not (seen >= limits.present_share).any()
        out.append(bool(doubted and seen.mean() < limits.absent_share))
    return out
