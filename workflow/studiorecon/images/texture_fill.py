# SPDX-License-Identifier: Apache-2.0
"""Fills holes in a picture of a surface with the surface's own repeats: wallpaper continues as wallpaper.

Surfaces of rooms repeat themselves. The shifts at which they do are counted over all small patches, as in He and Sun,
"Statistics of Patch Offsets for Image Completion" (2012). Then a hole is filled from its rim, patch by patch, each from
the shift that best continues its surroundings, as in Criminisi, Pérez and Toyama, "Region Filling and Object Removal by
Exemplar-Based Image Inpainting" (2004). Only detail is copied: light varies slowly over a wall, so it is interpolated.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy
from numba import njit

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Number of principal components that describe a patch in comparisons.
_COMPONENTS = 8
# Patches that search for a similar one, and how many of the nearest may be too close to count.
_ASKING, _NEIGHBOURS = 4000, 16
# Fewer whole patches determine no shift.
_MIN_PATCHES = 100
# Largest cost of one pixel against a shift, so that posters and furniture near a hole do not decide everything.
_MAX_SQUARED = 0.05
# Cost of a pixel that a shift cannot fill.
_MISSING = 0.002
# Copied pixels are trusted less, by this factor per patch.
_TRUST = 0.97
# Rounds, and robust deviations at which a pixel's weight for the light is a quarter, because objects on a wall do not
# light it.
_LIGHT_ROUNDS, _LIGHT_DEVIATIONS = 5, 1.5
# Below this share of known pixels around it, a pixel's light is taken from further away.
_THIN = 0.05


@dataclass(frozen=True)
class Scale:
    """Sizes of light and detail, in pixels.

    Attributes:
        light: sigma of the window over which light is even.
        patch: side of the square that is compared and copied, odd.
        shift: patches nearer than this show the same detail, not a repeat.
        shifts: number of shifts to try.
    """

    light: float
    patch: int
    shift: int
    shifts: int = 80


def fill_by_texture(
    rgb: Float[np.ndarray, "H W 3"], known: Bool[np.ndarray, "H W"], scale: Scale, rng: np.random.Generator
) -> Float[np.ndarray, "H W 3"]:
    """Picture in [0, 1] with pixels that are not ``known`` continued like the others, or with the light only.

    Raises ValueError for other shapes, and where no pixel is known.
    """
    hw = require("known", known, ("H", "W"))
    require("rgb", rgb, ("H", "W", 3), hw)
    if not known.any():
        raise ValueError("no pixel is known: there is nothing to go on from")
    light = low_frequency_light(rgb, known, scale.light)
    detail = np.where(known[..., None], rgb - light, 0.0)
    shifts = texture_periods(detail, known, scale, rng)
    copied, reached = _copy_patches(detail, known, shifts, scale.patch // 2)
    painted = np.where(reached[..., None], light + copied, light)
    return np.where(known[..., None], rgb, np.clip(painted, 0, 1))


def low_frequency_light(
    rgb: Float[np.ndarray, "H W 3"], known: Bool[np.ndarray, "H W"], sigma: float
) -> Float[np.ndarray, "H W 3"]:
    """A surface's light without its detail, at all pixels; outliers have almost no weight."""
    weight = known.astype(np.float64)
    for _ in range(_LIGHT_ROUNDS):
        light = _smooth(rgb, weight, sigma)
        off = np.linalg.norm(rgb - light, axis=-1)
        usual = _LIGHT_DEVIATIONS * 1.4826 * np.median(off[known]) + 1e-6
        weight = np.where(known, 1 / (1 + (off / usual) ** 2) ** 2, 0.0)
    return _smooth(rgb, weight, sigma)


def _smooth(rgb: np.ndarray, weight: np.ndarray, sigma: float) -> np.ndarray:
    """Weighted mean over a Gaussian window, over wider ones where the narrow one has little weight.

    Computed on fewer pixels, a quarter of the window each.
    """
    height, width = weight.shape
    step = max(1, int(sigma / 4))
    small = (max(1, width // step), max(1, height // step))
    total = cv2.resize(rgb * weight[..., None], small, interpolation=cv2.INTER_AREA)
    share = cv2.resize(weight, small, interpolation=cv2.INTER_AREA)
    mean = np.broadcast_to(np.average(rgb[weight > 0], axis=0, weights=weight[weight > 0]), total.shape)
    for wider in (8, 4, 2, 1):
        near, held = (
            cv2.GaussianBlur(values, (0, 0), wider * sigma / step, borderType=cv2.BORDER_REFLECT)
            for values in (total, share)
        )
        trust = np.clip(held / _THIN, 0, 1)[..., None]
        mean = trust * near / np.maximum(held, 1e-12)[..., None] + (1 - trust) * mean
    return cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR)


def texture_periods(
    detail: Float[np.ndarray, "H W 3"], known: Bool[np.ndarray, "H W"], scale: Scale, rng: np.random.Generator
) -> Integer[np.ndarray, "K 2"]:
    """Rows and columns by which the surface repeats, the commonest first; none where too little of it is known."""
    half = scale.patch // 2
    rows, columns = np.nonzero(scipy.ndimage.minimum_filter(known, scale.patch, mode="constant", cval=False))
    if len(rows) < _MIN_PATCHES:
        return np.zeros((0, 2), np.int64)
    reach = range(-half, half + 1)
    patches = np.stack([detail[rows + a, columns + b] for a in reach for b in reach], axis=1).reshape(len(rows), -1)
    patches -= patches.mean(axis=0)
    _, directions = np.linalg.eigh(patches.T @ patches)
    described = patches @ directions[:, -_COMPONENTS:]
    asking = rng.permutation(len(rows))[:_ASKING]
    _, neighbours = scipy.spatial.cKDTree(described).query(described[asking], k=min(_NEIGHBOURS, len(rows)))
    apart = np.stack([at[neighbours] - at[asking][:, None] for at in (rows, columns)], axis=-1)
    far = np.abs(apart).max(axis=-1) >= scale.shift
    first = apart[np.arange(len(asking)), far.argmax(axis=1)][far.any(axis=1)]
    height, width = known.shape
    votes = np.zeros((2 * height + 1, 2 * width + 1))
    for shift in (first, -first):
        np.add.at(votes, (height + shift[:, 0], width + shift[:, 1]), 1.0)
    votes = cv2.GaussianBlur(votes, (0, 0), 1.0)
    peaks = np.argwhere((votes > 0) & (votes == cv2.dilate(votes, np.ones((5, 5)))))
    commonest = np.argsort(-votes[tuple(peaks.T)], kind="stable")[: scale.shifts]
    return peaks[commonest] - [height, width]


@njit(cache=True)
def _copy_patches(detail, known, shifts, half):
    """(H, W, 3) detail with its holes filled, and (H, W) bool where it is known or was filled."""
    height, width = known.shape
    out, done, trust = detail.copy(), known.copy(), known.astype(np.float64)
    rank = np.zeros((height, width))
    rim = [(0.0, 0, 0)]
    rim.pop()
    for r in range(height):
        for c in range(width):
            _rank(done, trust, half, r, c, rank, rim)
    while len(rim) > 0:
        priority, r0, c0 = heapq.heappop(rim)
        if done[r0, c0] or -priority != rank[r0, c0]:
            continue
        best = _best(detail, known, out, done, trust, shifts, half, r0, c0)
        if best < 0:
            continue  # comes again if a neighbour is filled
        for r in range(max(r0 - half, 0), min(r0 + half + 1, height)):
            for c in range(max(c0 - half, 0), min(c0 + half + 1, width)):
                there = r + shifts[best, 0], c + shifts[best, 1]
                if done[r, c] or not (0 <= there[0] < height and 0 <= there[1] < width) or not known[there]:
                    continue
                out[r, c] = detail[there]
                done[r, c] = True
                trust[r, c] = _TRUST * -priority
        for r in range(max(r0 - 2 * half - 1, 0), min(r0 + 2 * half + 2, height)):
            for c in range(max(c0 - 2 * half - 1, 0), min(c0 + 2 * half + 2, width)):
                _rank(done, trust, half, r, c, rank, rim)
    return out, done


@njit(cache=True)
def _rank(done, trust, half, r, c, rank, rim):
    """Put a pixel at the rim of a hole into the queue ``rim``: those with the most trusted surroundings come first."""
    height, width = done.shape
    if done[r, c]:
        return
    beside = (
        (r > 0 and done[r - 1, c])
        or (r + 1 < height and done[r + 1, c])
        or (c > 0 and done[r, c - 1])
        or (c + 1 < width and done[r, c + 1])
    )
    if not beside:
        return
    total = 0.0
    count = 0
    for a in range(max(r - half, 0), min(r + half + 1, height)):
        for b in range(max(c - half, 0), min(c + half + 1, width)):
            total += trust[a, b]
            count += 1
    mean = total / count
    if mean != rank[r, c]:
        rank[r, c] = mean
        heapq.heappush(rim, (-mean, r, c))


@njit(cache=True)
def _best(detail, known, out, done, trust, shifts, half, r0, c0):
    """Index of the shift that best continues the surroundings of (r0, c0); -1 when none leads to a known pixel."""
    height, width = known.shape
    least, best = np.inf, -1
    for k in range(len(shifts)):
        down, right = shifts[k, 0], shifts[k, 1]
        if not (0 <= r0 + down < height and 0 <= c0 + right < width) or not known[r0 + down, c0 + right]:
            continue
        against, counted, missing = 0.0, 0, 0
        for r in range(max(r0 - half, 0), min(r0 + half + 1, height)):
            for c in range(max(c0 - half, 0), min(c0 + half + 1, width)):
                a, b = r + down, c + right
                if not (0 <= a < height and 0 <= b < width) or not known[a, b]:
                    missing += 1
                elif done[r, c]:
                    counted += 1
                    for q in range(3):
                        off = out[r, c, q] - detail[a, b, q]
                        against += min(off * off, _MAX_SQUARED) * trust[r, c]
        if counted > 0:
            cost = against / counted + _MISSING * missing
            if cost < least:
                least, best = cost, k
    return best
