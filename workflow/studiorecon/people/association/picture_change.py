# SPDX-License-Identifier: Apache-2.0
"""Checks people's keypoints against the film: where a limb has left or arrived, the picture must have changed.

No plate is needed, and people who do not move are not judged. Only limbs that moved by decimetres in the world count,
at positions away from the bodies of all people in the other picture. A false skeleton (left over from another take)
moves over an unchanged picture; it can be consistent in all views to a pixel, so geometry alone cannot reject it.
Keypoints that wander over a still person are no evidence: their cameras do not agree on the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.images.channels import channel_max
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

_BLUR_PX = 1.5
# A change must be this many noise sigmas, but never more than visible ones: grey levels of 255.
_NOISES, _FAINTEST = 6.0, 10.0
# Radius of the search around a joint's position, metres; radii of limbs, and of trunk and head, around their bones.
_PLACE_M, _LIMB_M, _TRUNK_M = 0.03, 0.05, 0.15
# Factor on other people's radii: clothes, hair, shadows.
_CLOTHED = 2.0
# A joint has moved when it did by so many times its wandering, the 90 % quantile. It wanders where it leaves the cubic
# through its positions so far apart in time, seconds: landmarks drift for longer than a picture lasts, and within that
# time an arm that swings is a cubic.
_WANDERINGS, _WANDERING_S = 4.0, 0.1
_MIN_PLACES = 20
_MIN_VIEWS = 2
_AT = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
_LIMBS = [
    (_AT[f"{s}_{a}"], _AT[f"{s}_{b}"])
    for s in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
]
_LIMB_ENDS = [
    (_AT[f"{s}_{a}"], _AT[f"{s}_{b}"]) for s in ("left", "right") for a, b in (("elbow", "wrist"), ("knee", "ankle"))
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
# Both ends of each part of a skeleton, and its radius; after the joints come the middles of shoulders and hips, and the
# head.
_SHOULDERS, _HIPS, _HEAD = len(STABLE_KEYPOINTS) + np.arange(3)
_THIN = [*_LIMBS, *((k, k) for k in range(len(STABLE_KEYPOINTS)))]
_WIDE = [*_TRUNK, (_SHOULDERS, _HIPS), (_SHOULDERS, _HEAD)]
_PARTS = np.array([*_THIN, *_WIDE])
_REACHES_M = np.repeat([_LIMB_M, _TRUNK_M], [len(_THIN), len(_WIDE)])


@dataclass(frozen=True)
class EvidenceLimits:
    """When pictures contradict keypoints.

    Attributes:
        frames: pictures of every camera that are compared: where a joint has moved, the picture must have changed; 0 =
            no test.
        step_m: least motion of a joint between two pictures, metres.
        difference: grey levels (of 255) by which the picture must have changed there; less in cameras with little
            noise.
        absent_share, present_share: a mean below the first rejects a person, unless one camera, or a single limb, is
            above the second.
        covered_share, presence: a person is also accepted where one camera's network has a mask over at least this
            share, with at least this confidence.
    """

    frames: int = 8
    step_m: float = 0.06
    difference: float = 28
    absent_share: float = 0.5
    present_share: float = 0.75
    covered_share: float = 0.75
    presence: float = 0.9


def sampled_frames(frames: Integer[np.ndarray, " N"], wanted: int) -> Integer[np.ndarray, " M"]:
    """At most ``wanted`` of the distinct ``frames``, evenly spread."""
    distinct = np.unique(frames)
    if not len(distinct) or not wanted:
        return distinct[:0]
    return distinct[evenly_spread(len(distinct), wanted)]


def steps_m(points_m: Float[np.ndarray, "T K 3"], fps: float, limits: EvidenceLimits) -> Float[np.ndarray, " K"]:
    """(K,) least motion for each of the points (T, K, 3) to count, metres: well beyond its wandering, at any frame
    rate.

    This covers noise and hasty motion: in both cases a smaller step is no evidence of a position.
    """
    weights = (1, -4, 6, -4, 1)
    apart = max(1, min(round(_WANDERING_S * fps), (len(points_m) - 1) // (len(weights) - 1)))
    count = max(len(points_m) - (len(weights) - 1) * apart, 0)
    left = sum(w * points_m[k * apart : k * apart + count] for k, w in enumerate(weights))
    size = np.linalg.norm(left, axis=-1) / np.linalg.norm(weights)
    known = [column[np.isfinite(column)] for column in size.T]
    wandering = np.array([np.quantile(k, 0.9) if len(k) else 0.0 for k in known])
    return np.maximum(limits.step_m, _WANDERINGS * wandering)


def motion_support(
    pictures: Sequence[Integer[np.ndarray, "H W 3"]],
    points_m: Float[np.ndarray, "G F 12 3"],
    who: int,
    step_m: Float[np.ndarray, " 12"],
    camera: Camera,
    limits: EvidenceLimits,
) -> Num[np.ndarray, "12 2"]:
    """(12, 2) how many positions that each joint of person ``who`` left or reached show a change, and how many there
    are.

    ``pictures`` are (H, W, 3) uint8 of ``camera``, ``points_m`` (G, F, 12, 3) all people's stable keypoints in each of
    them, NaN where unknown; ``step_m`` (12,) is the least motion of each. Every two pictures are compared, after a
    little blur and without their median colour (exposure).
    """
    smooth = [normalise_picture(picture) for picture in pictures]
    pixels, depth = camera.project(points_m)
    pixels = np.where(depth[..., None] > 0, pixels, np.nan)
    metre_px = camera.intrinsics[0, 0] / np.maximum(
        np.nan_to_num(_middle(depth[..., None])[..., 0], nan=np.inf), 1e-6
    )  # (G, F)
    parts = _body_segments(pixels)
    counts, own = np.zeros((len(STABLE_KEYPOINTS), 2), dtype=int), points_m[who]
    rest = np.arange(len(points_m)) != who
    for a, b in combinations(range(len(pictures)), 2):
        moved = np.linalg.norm(own[a] - own[b], axis=-1) > step_m
        if not moved.any():
            continue
        apart = channel_max(np.abs(smooth[a] - smooth[b]))
        threshold = change_threshold(apart, limits)
        for here, other in ((a, b), (b, a)):
            places = pixels[who, here, moved]
            uncovered = _outside(places, parts[who, [other]], metre_px[who, [other]])
            for t in (a, b):
                uncovered &= _outside(places, parts[rest, t], _CLOTHED * metre_px[rest, t])
            radius = max(1, round(_PLACE_M * float(metre_px[who, here])))
            counts[np.flatnonzero(moved)[uncovered]] += changed(apart, places[uncovered], radius, threshold)
    return counts


def normalise_picture(picture: Integer[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """(H, W, 3) float32 of a picture (H, W, 3) uint8 after a little blur, without its median colour (exposure)."""
    blurred = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX).astype(np.float32)
    return blurred - np.median(blurred[::4, ::4], axis=(0, 1))


def change_threshold(apart: Float[np.ndarray, "H W"], limits: EvidenceLimits) -> float:
    """Grey levels from which a difference (H, W) of two pictures, NaN where unknown, is a change."""
    usual = float(np.nanmedian(apart[::4, ::4])) if np.isfinite(apart[::4, ::4]).any() else 0.0
    return float(np.clip(_NOISES * 1.4826 * usual, _FAINTEST, limits.difference))


def count_changed_places(
    apart: Float[np.ndarray, "H W"], points_m: Float[np.ndarray, "N 3"], camera: Camera, limits: EvidenceLimits
) -> Num[np.ndarray, "N 2"]:
    """(N, 2) per point (N, 3): whether the difference of two pictures shows a change there, and whether it is known, as
    0 and 1.

    ``apart`` (H, W; NaN unknown) is the difference in ``camera``; unknown points are NaN.
    """
    pixels, depth = camera.project(points_m)
    there = np.isfinite(pixels).all(-1) & (depth > 0)
    counts = np.zeros((len(points_m), 2), dtype=int)
    if there.any():
        radius = max(1, round(_PLACE_M * float(camera.intrinsics[0, 0] / np.median(depth[there]))))
        counts[there] = changed(apart, pixels[there], radius, change_threshold(apart, limits))
    return counts


def _middle(values: np.ndarray) -> np.ndarray:
    """Mean of the known entries of the last axis but one, NaN where there is none."""
    known = np.isfinite(values).all(-1, keepdims=True)
    return np.where(known.any(-2), np.where(known, values, 0.0).sum(-2) / np.maximum(known.sum(-2), 1), np.nan)


def _body_segments(skeletons: np.ndarray) -> np.ndarray:
    """(..., P, 2, 2) both ends of the limbs, joints, trunk and head of skeletons (..., 12, 2), NaN where unknown."""
    shoulders, hips = (_middle(skeletons[..., [_AT[f"left_{j}"], _AT[f"right_{j}"]], :]) for j in ("shoulder", "hip"))
    head = shoulders + _HEAD_SHARE * (shoulders - hips)
    points = np.concatenate([skeletons, shoulders[..., None, :], hips[..., None, :], head[..., None, :]], axis=-2)
    return points[..., _PARTS, :]


def _outside(places: np.ndarray, parts: np.ndarray, metre_px: np.ndarray) -> np.ndarray:
    """(N,) which positions (N, 2) are outside of all known ``parts`` (S, P, 2, 2) of some skeletons; ``metre_px`` (S,)
    pixels."""
    first, along = parts[..., 0, :], parts[..., 1, :] - parts[..., 0, :]
    from_first = places[:, None, None] - first  # (N, S, P, 2)
    share = ((from_first * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-9)).clip(0, 1)
    apart = np.linalg.norm(from_first - share[..., None] * along, axis=-1)
    # An unknown part has no distance, and nothing is inside of it.
    inside = (apart <= _REACHES_M * metre_px[:, None]).any((1, 2))
    return np.isfinite(places).all(-1) & ~inside


def changed(
    apart: Float[np.ndarray, "H W"], places: Num[np.ndarray, "N 2"], radius: int, threshold: float
) -> Num[np.ndarray, "N 2"]:
    """(N, 2) whether ``apart`` exceeds ``threshold`` within ``radius`` pixels of each position, and whether it is known
    there.

    Values are 0 and 1; ``apart`` (H, W) is a difference with NaN for unknown, positions are (N, 2).
    """
    counts = np.zeros((len(places), 2), dtype=int)
    for k, (column, row) in enumerate(np.floor(places).astype(int)):
        if 0 <= column < apart.shape[1] and 0 <= row < apart.shape[0]:
            part = apart[max(row - radius, 0) : row + radius + 1, max(column - radius, 0) : column + radius + 1]
            known = part[np.isfinite(part)]
            if len(known):
                counts[k] = float(known.max()) > threshold, 1
    return counts


def view_shares(counts: Num[np.ndarray, "... 2"]) -> Float[np.ndarray, " ..."]:
    """(...,) supported share from (..., 2) counts; NaN with fewer than twenty positions."""
    judged = counts[..., 1] >= _MIN_PLACES
    return np.where(judged, counts[..., 0] / np.maximum(counts[..., 1], 1), np.nan)


def limb_counts(counts: Num[np.ndarray, "... 12 2"]) -> Num[np.ndarray, "... 4 2"]:
    """(..., 4, 2) counts of arms and legs, from those of the joints (..., 12, 2): elbow and wrist, knee and ankle."""
    return np.stack([counts[..., list(ends), :].sum(-2) for ends in _LIMB_ENDS], axis=-2)


def absent_people(
    shares: Float[np.ndarray, "G V"], limbs: Float[np.ndarray, "G V 4"], limits: EvidenceLimits
) -> list[bool]:
    """For every group, whether the pictures show that no person is there, from all joints' (G, V) and limbs' (G, V, 4)
    shares.

    Only where two views can judge, none of them confirms, not even one limb, and the same views confirm another person.
    Videos that are badly lit, or out of step with the keypoints, contradict all people, and so reject none.
    """
    out = []
    for g, own in enumerate(shares):
        others = np.delete(shares, g, axis=0)
        trusted = (np.nan_to_num(others, nan=0.0) >= limits.present_share).any(0)
        judged = np.isfinite(own) & trusted
        seen = own[np.isfinite(own)]
        confirmed = (seen >= limits.present_share).any() or (np.nan_to_num(limbs[g]) >= limits.present_share).any()
        doubted = judged.sum() >= _MIN_VIEWS and not confirmed
        out.append(bool(doubted and seen.mean() < limits.absent_share))
    return out
