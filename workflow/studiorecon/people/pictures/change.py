# SPDX-License-Identifier: Apache-2.0
"""Checks people's keypoints against the film: where a limb has left or arrived, the picture must have changed.

No plate is needed, and people who do not move are not judged. Only limbs that moved by decimetres in the world count,
at positions away from the bodies of all people in the other picture. A false skeleton (left over from another take)
moves over an unchanged picture; it can be consistent in all views to a pixel, so geometry alone cannot reject it.
Keypoints that wander over a still person are no evidence: their cameras do not agree on the motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.footage.video import read_frames
from studiorecon.images.channels import channel_max
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

_BLUR_PX = 1.5
# A change must be this many noise sigmas, within the faintest and a plain one: grey levels of 255.
_NOISES, _FAINTEST, _PLAIN = 6.0, 10.0, 28.0
# Radius of the search around a joint's position, m.
_PLACE_M = 0.03
# Factor on other people's radii: clothes, hair, shadows.
_CLOTHED = 2.0
# A joint has moved when it did by so many times its wandering, the 90 % quantile. It wanders where it leaves the cubic
# through its positions so far apart in time, seconds: landmarks drift for longer than a picture lasts, and within that
# time an arm that swings is a cubic.
_WANDERINGS, _WANDERING_S = 4.0, 0.1
# Pictures of every camera that are compared.
PICTURES = 8
# Least motion of a joint between two pictures, m.
_STEP_M = 0.06
_AT = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
LIMB_ENDS = [
    [_AT[f"{s}_{a}"], _AT[f"{s}_{b}"]] for s in ("left", "right") for a, b in (("elbow", "wrist"), ("knee", "ankle"))
]
"""Joints of both arms and both legs whose motion is judged together."""


def _body_points() -> tuple[np.ndarray, np.ndarray]:
    """(S, 12) shares of the joints that make the points inside of a body, and (S,) how far it reaches around each,
    m."""
    shares, reaches = [], []

    def add(reach_m: float, **joints: float) -> None:
        shares.append([joints.get(name, 0.0) for name in STABLE_KEYPOINTS])
        reaches.append(reach_m)

    for side in ("left", "right"):
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
            for along in np.linspace(0, 1, 7):
                add(0.05, **{f"{side}_{a}": 1 - along, f"{side}_{b}": along})
    # Down the trunk in three columns; the head is as far above the shoulders as 0.6 of the trunk.
    for across in (0.0, 0.5, 1.0):
        for down in (0.0, 0.25, 0.5, 0.75, 1.0, *([-0.3, -0.6] if across == 0.5 else [])):
            weights = {"shoulder": 1 - down, "hip": down}
            add(
                0.15,
                **{f"left_{j}": (1 - across) * w for j, w in weights.items()},
                **{f"right_{j}": across * w for j, w in weights.items()},
            )
    return np.array(shares), np.array(reaches)


_SHARES, _REACHES_M = _body_points()


def sample_frames(frames: Integer[np.ndarray, " N"], wanted: int) -> Integer[np.ndarray, " M"]:
    """At most ``wanted`` of the distinct ``frames``, evenly spread."""
    distinct = np.unique(frames)
    return distinct[spread_indices(len(distinct), wanted)] if len(distinct) else distinct


def pictures_at(video: Path, frames: Iterable[int]) -> dict[int, Integer[np.ndarray, "H W 3"]]:
    """The pictures of ``frames``, by frame."""
    wanted = {int(t) for t in frames}
    return {t: one for t, one in enumerate(read_frames(video, 0, max(wanted, default=-1) + 1)) if t in wanted}


def steps_m(points_m: Float[np.ndarray, "T K 3"], fps: float) -> Float[np.ndarray, " K"]:
    """Least motion for each of the points to count, metres: well beyond its wandering, at any frame rate.

    This covers noise and hasty motion: in both cases a smaller step is no evidence of a position.
    """
    weights = (1, -4, 6, -4, 1)
    apart = max(1, min(round(_WANDERING_S * fps), (len(points_m) - 1) // (len(weights) - 1)))
    count = max(len(points_m) - (len(weights) - 1) * apart, 0)
    left = sum(w * points_m[k * apart : k * apart + count] for k, w in enumerate(weights))
    size = np.linalg.norm(left, axis=-1) / np.linalg.norm(weights)
    known = [column[np.isfinite(column)] for column in size.T]
    wandering = np.array([np.quantile(k, 0.9) if len(k) else 0.0 for k in known])
    return np.maximum(_STEP_M, _WANDERINGS * wandering)


def motion_support(
    pictures: Sequence[Integer[np.ndarray, "H W 3"]],
    points_m: Float[np.ndarray, "G F 12 3"],
    who: int,
    step_m: Float[np.ndarray, " 12"],
    camera: Camera,
) -> Num[np.ndarray, "12 2"]:
    """How many positions that each joint of person ``who`` left or reached show a change, and how many there are.

    ``pictures`` are (H, W, 3) uint8 of ``camera``, ``points_m`` all people's stable keypoints in each of them, NaN
    where unknown; ``step_m`` is the least motion of each. Every two pictures are compared, after a little blur and
    without their median colour (exposure).
    """
    smooth = [normalise_picture(picture) for picture in pictures]
    pixels, depth = camera.project(points_m)
    pixels = np.where(depth[..., None] > 0, pixels, np.nan)
    metre_px = camera.intrinsics[0, 0] / np.maximum(
        np.nan_to_num(_middle(depth[..., None])[..., 0], nan=np.inf), 1e-6
    )  # (G, F)
    parts = _body(pixels)
    counts, own = np.zeros((len(STABLE_KEYPOINTS), 2), dtype=int), points_m[who]
    rest = np.arange(len(points_m)) != who
    for a, b in combinations(range(len(pictures)), 2):
        moved = np.linalg.norm(own[a] - own[b], axis=-1) > step_m
        if not moved.any():
            continue
        apart = channel_max(np.abs(smooth[a] - smooth[b]))
        threshold = change_threshold(apart)
        for here, other in ((a, b), (b, a)):
            places = pixels[who, here, moved]
            uncovered = _outside(places, parts[who, [other]], metre_px[who, [other]])
            for t in (a, b):
                uncovered &= _outside(places, parts[rest, t], _CLOTHED * metre_px[rest, t])
            radius = max(1, round(_PLACE_M * float(metre_px[who, here])))
            counts[np.flatnonzero(moved)[uncovered]] += changes_at(apart, places[uncovered], radius, threshold)
    return counts


def normalise_picture(picture: Integer[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Float32 of a picture (H, W, 3) uint8 after a little blur, without its median colour (exposure)."""
    blurred = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX).astype(np.float32)
    return blurred - np.median(blurred[::4, ::4], axis=(0, 1))


def change_threshold(apart: Float[np.ndarray, "H W"]) -> float:
    """Grey levels from which a difference of two pictures, NaN where unknown, is a change."""
    usual = float(np.nanmedian(apart[::4, ::4])) if np.isfinite(apart[::4, ::4]).any() else 0.0
    return float(np.clip(_NOISES * 1.4826 * usual, _FAINTEST, _PLAIN))


def count_changed_places(
    apart: Float[np.ndarray, "H W"], points_m: Float[np.ndarray, "N 3"], camera: Camera
) -> Num[np.ndarray, "N 2"]:
    """(N, 2) per point: whether the difference of two pictures shows a change there, and whether it is known, as 0 and
    1.

    ``apart`` (H, W; NaN unknown) is the difference in ``camera``; unknown points are NaN.
    """
    pixels, depth = camera.project(points_m)
    there = np.isfinite(pixels).all(-1) & (depth > 0)
    counts = np.zeros((len(points_m), 2), dtype=int)
    if there.any():
        radius = max(1, round(_PLACE_M * float(camera.intrinsics[0, 0] / np.median(depth[there]))))
        counts[there] = changes_at(apart, pixels[there], radius, change_threshold(apart))
    return counts


def _middle(values: np.ndarray) -> np.ndarray:
    """Mean of the known entries of the last axis but one, NaN where there is none."""
    known = np.isfinite(values).all(-1, keepdims=True)
    return np.where(known.any(-2), np.where(known, values, 0.0).sum(-2) / np.maximum(known.sum(-2), 1), np.nan)


def _body(skeletons: np.ndarray) -> np.ndarray:
    """(..., S, 2) pixels inside of skeletons (..., 12, 2), NaN where a joint that makes them is unknown."""
    known = np.isfinite(skeletons).all(-1)
    whole = (~known @ (_SHARES != 0).T.astype(int)) == 0
    return np.where(whole[..., None], _SHARES @ np.where(known[..., None], skeletons, 0.0), np.nan)


def _outside(places: np.ndarray, bodies: np.ndarray, metre_px: np.ndarray) -> np.ndarray:
    """(N,) which positions (N, 2) are known and outside of all ``bodies`` (B, S, 2); ``metre_px`` (B,) pixels."""
    apart = np.linalg.norm(places[:, None, None] - bodies, axis=-1)  # (N, B, S), NaN is not inside
    return np.isfinite(places).all(-1) & ~(apart <= _REACHES_M * metre_px[:, None]).any((1, 2))


def changes_at(
    apart: Float[np.ndarray, "H W"], places: Num[np.ndarray, "N 2"], radius: int, threshold: float
) -> Num[np.ndarray, "N 2"]:
    """Whether ``apart`` exceeds ``threshold`` within ``radius`` pixels of each position, and whether it is known there.

    Values are 0 and 1; ``apart`` is a difference with NaN for unknown, positions are.
    """
    counts = np.zeros((len(places), 2), dtype=int)
    for k, (column, row) in enumerate(np.floor(places).astype(int)):
        if 0 <= column < apart.shape[1] and 0 <= row < apart.shape[0]:
            part = apart[max(row - radius, 0) : row + radius + 1, max(column - radius, 0) : column + radius + 1]
            known = part[np.isfinite(part)]
            if len(known):
                counts[k] = float(known.max()) > threshold, 1
    return counts
