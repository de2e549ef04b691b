# SPDX-License-Identifier: Apache-2.0
"""What people stand on where the room's floor lies lower: a treadmill, a stage, a plate on the floor.

The height z = 0 is where feet are. Where photos agree on that height only on one piece of it, and see surfaces below
it all around, that piece is a platform, and the floor of the room is down there: every wall that is placed by what ends
on the floor, and everything painted on the floor, would otherwise be too near.

A polished floor shows what stands on it mirrored, below itself, but the photos agree on it nearly everywhere: what lies
below counts outside the piece on which they agree, and must be much in comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.layout.box import Matching
from studiorecon.depth.stereo.plates import UNKNOWN, Picture
from studiorecon.scene.room import Platform

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Heights about where people stand that are compared: as deep as the floor may lie, and so far up that what is there is
# told from what is below.
_STEP_M, _DEEPEST_M, _HIGHEST_M = 0.04, 1.2, 1.0
# A floor on which no more than this share of textured pixels disagrees is the room's.
_AGREED, _DISAGREED, _MIN_DISAGREEING = 0.6, 0.3, 0.25
# A pixel's height counts where it matches so well, so much better than any that is further off than so many steps, and
# the pixel that it is found at in the other picture says the same to a step.
_MIN_SCORE, _MIN_LEAD, _APART = 0.7, 0.08, 3
# What people stand on is where their height matches nearly as well as any lower one, and the rest is where it matches
# clearly worse: stripes match at many heights.
_NEARLY, _WORSE = 0.15, 0.3
# Surfaces are counted in cells of the floor, not in pixels: near ones would outvote the rest.
_CELL_M = 0.1
# A cell belongs to what people stand on where this share of the pixels about it says so.
_CELL_AGREES = 0.4
# So many cells around the platform must lie lower, and this share of all that were told there, and of those on it.
# Nearer than this many steps is the platform's own height.
_MIN_CELLS, _MIN_SHARE, _MIN_AROUND, _OWN = 50, 0.6, 0.4, 1
# Mats and boxes lie on the floor: it is the lowest height that this share of the most frequent one's cells lie at. A
# floor that lies less than so far down is within what cameras may be off by.
_LOWEST_SHARE, _MIN_DOWN_M = 0.6, 0.14


@dataclass(frozen=True)
class _HeightVotes:
    """What pixels say of their height.

    Attributes:
        place_m: (N, 3) where those are whose height two cameras agree on.
        step: (N,) their height, in steps above where people stand.
        score: (N,) how well they match.
        at_feet_m: (M, 2) where all that can be compared see the height where people stand.
        stood_on: (M,) bool: what they see may lie there.
    """

    place_m: Float[np.ndarray, "N 3"]
    step: Integer[np.ndarray, " N"]
    score: Float[np.ndarray, " N"]
    at_feet_m: Float[np.ndarray, "M 2"]
    stood_on: Bool[np.ndarray, " M"]


@dataclass(frozen=True)
class Raised:
    """People stand on something.

    Attributes:
        platform: what they stand on.
        floor_m: height of the room's floor around it. score: how well that matches.
        levels_m: heights of other surfaces that lie lower than people stand.
    """

    platform: Platform
    floor_m: float
    score: float
    levels_m: list[float]


def fit_platform(
    pictures: Sequence[Picture], axes: Float[np.ndarray, "3 3"], standing_m: float, how: Matching
) -> Raised | None:
    """What people stand on at ``standing_m``, or None where that is the floor; ``axes`` (3, 3) are the room box's.

    A tenth of a second for four pictures 240 pixels wide where photos agree on the floor, 3 s where they do not.
    """
    if _disagreeing(pictures, standing_m, how) < _MIN_DISAGREEING:
        return None
    told = _height_votes(pictures, standing_m, how)
    if not told.stood_on.any():
        return None
    corner, upper = _densest(told.at_feet_m @ axes[:2, :2].T, told.stood_on)
    level, below = np.abs(told.step) <= _OWN, told.step < -_OWN
    local = told.place_m @ axes.T
    outside = ((local[:, :2] < corner) | (local[:, :2] > upper)).any(axis=1)
    lower, same = len(_cells(local[below & outside])), len(_cells(local[level & outside]))
    on_it = len(_cells(local[level & ~outside]))
    if lower < max(_MIN_CELLS, _MIN_SHARE * (lower + same), _MIN_AROUND * on_it):
        return None
    # Cells at every step below where people stand, and as far above it.
    count, above = np.zeros((2, round(_DEEPEST_M / _STEP_M) + 2))
    for step in range(_OWN + 1, len(count)):
        count[step], above[step] = (len(_cells(local[outside & (told.step == at)])) for at in (-step, step))
    around = np.convolve(count, np.ones(3), mode="same")
    lowest = int(np.flatnonzero(around >= _LOWEST_SHARE * around.max())[-1])
    # The peak beside it, and where in its step: cells of three steps, the middle one the fullest.
    peak = lowest - 1 + int(count[lowest - 1 : lowest + 2].argmax())
    span = np.arange(peak - 1, min(peak + 2, len(count)))
    floor_m = standing_m - _STEP_M * float((span * count[span]).sum() / count[span].sum())
    # The floor that people stand on lies apart as well where cameras are a degree off, but as much of it above as
    # below.
    if standing_m - floor_m < _MIN_DOWN_M or above[: peak + 2].sum() > count[: peak + 2].sum():
        return None
    mats = [
        standing_m - k * _STEP_M
        for k in range(2 * _OWN + 1, peak - 1)
        if around[k] >= _MIN_CELLS and count[k] == count[k - 1 : k + 2].max()
    ]
    score = float(told.score[outside & (np.abs(told.step + peak) <= 1)].mean())
    return Raised(Platform(corner, upper, standing_m), floor_m, score, mats)


def _disagreeing(pictures: Sequence[Picture], standing_m: float, how: Matching) -> float:
    """Which share of the textured pixels that look at the height where people stand, and are seen by others there, does
    not match."""
    agreed = disagreed = 0
    for i, picture in enumerate(pictures):
        best = np.full(picture.known.shape, UNKNOWN, np.float32)
        for step in range(-_OWN, _OWN + 1):
            for j, other in enumerate(pictures):
                if j != i:
                    best = np.maximum(best, _score(picture, other, standing_m + _STEP_M * step, how))
        seen = (best > UNKNOWN) & picture.known & picture.textured(how.window + 2)
        agreed += int((seen & (best > _AGREED)).sum())
        disagreed += int((seen & (best < _DISAGREED)).sum())
    return disagreed / max(agreed + disagreed, 1)


def _score(picture: Picture, other: Picture, height_m: float, how: Matching) -> Float[np.ndarray, "H W"]:
    plane = np.array([0.0, 0.0, 1.0, height_m])
    return picture.score(other, plane, how.window + 2, 0.0, how.near_m, how.far_m)


@dataclass(frozen=True)
class _Pair:
    """A picture compared with another, (H, W): which height matches best, how well, bool: clearly; and how well the
    best of where people stand, and the best of all up to there."""

    best: Integer[np.ndarray, "H W"]
    top: Float[np.ndarray, "H W"]
    sure: Bool[np.ndarray, "H W"]
    at_feet: Float[np.ndarray, "H W"]
    up_to_feet: Float[np.ndarray, "H W"]


def _pair(picture: Picture, other: Picture, standing_m: float, steps: np.ndarray, how: Matching) -> _Pair:
    scores = np.stack([_score(picture, other, standing_m + _STEP_M * step, how) for step in steps])
    best, top = scores.argmax(axis=0).astype(np.int16), scores.max(axis=0)
    beside = np.abs(np.arange(len(steps))[:, None, None] - best) <= _APART
    second = np.where(beside, -1.0, scores).max(axis=0)
    sure = (top > _MIN_SCORE) & (top - second > _MIN_LEAD) & (best > 1) & (best < len(steps) - 2)
    return _Pair(best, top, sure, scores[np.abs(steps) <= _OWN].max(axis=0), scores[steps <= _OWN].max(axis=0))


def _height_votes(pictures: Sequence[Picture], standing_m: float, how: Matching) -> _HeightVotes:
    """What the pixels of all pictures say of their height, each compared with every other picture."""
    steps = np.arange(-round(_DEEPEST_M / _STEP_M), round(_HIGHEST_M / _STEP_M) + 1)
    plane = np.array([0.0, 0.0, 1.0, standing_m])
    pairs = {
        (i, j): _pair(picture, other, standing_m, steps, how)
        for i, picture in enumerate(pictures)
        for j, other in enumerate(pictures)
        if i != j
    }
    places, chosen, scores = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.float32)]
    feet, stood_on = [np.zeros((0, 2))], [np.zeros(0, bool)]
    for i, picture in enumerate(pictures):
        centre, centres = picture.camera.centre_m, picture.camera.pixel_centres()
        # Only what looks down meets heights below the camera.
        usable = picture.known & picture.textured(how.window + 2) & (picture.depth(plane, how.near_m, how.far_m) > 0)
        rays = picture.camera.unproject(centres, np.ones(usable.shape)) - centre
        theirs = [pair for (first, _), pair in pairs.items() if first == i]
        if not theirs:
            continue
        level, up_to = (np.max([getattr(pair, name) for pair in theirs], axis=0) for name in ("at_feet", "up_to_feet"))
        on_it = (level > _AGREED) & (level > up_to - _NEARLY)
        clear = usable & (level > UNKNOWN) & (on_it | (level < _DISAGREED) | (level < up_to - _WORSE))
        feet.append((centre + ((standing_m - centre[2]) / rays[clear][:, 2])[:, None] * rays[clear])[:, :2])
        stood_on.append(on_it[clear])
        for j, other in enumerate(pictures):
            if j == i:
                continue
            pair = pairs[i, j]
            at = np.nonzero(pair.sure & usable)
            own, ray = pair.best[at], rays[at]
            place = centre + ((standing_m + _STEP_M * steps[own] - centre[2]) / ray[:, 2])[:, None] * ray
            pixels, z = other.camera.project(place)
            # A pixel's centre is at a half.
            inside = (z > 0) & (pixels >= 0).all(axis=1) & (pixels < np.array(other.camera.wh)).all(axis=1)
            column, row = np.where(inside[:, None], pixels, 0).astype(np.int64).T
            mutual = inside & (np.abs(pairs[j, i].best[row, column] - own) <= 1)
            places.append(place[mutual])
            chosen.append(steps[own[mutual]])
            scores.append(pair.top[at][mutual])
    return _HeightVotes(*(np.concatenate(parts) for parts in (places, chosen, scores, feet, stood_on)))


def _cells(local_m: Float[np.ndarray, "N 3"]) -> Integer[np.ndarray, "M 2"]:
    """(M, 2) the cells in plan that points are in."""
    return np.unique(np.floor(local_m[:, :2] / _CELL_M).astype(int), axis=0)


def _densest(
    places_m: Float[np.ndarray, "N 2"], agreed: Bool[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """(2,) least and (2,) greatest coordinates of the rectangle in which most cells agree and fewest do not: the
    greatest sum, over cells, of the share of pixels about them that agree, less what makes a cell one of it."""
    cell = np.floor(places_m / _CELL_M).astype(int)
    first = cell.min(axis=0)
    yes, every = np.zeros((2, *(np.ptp(cell, axis=0) + 1)))
    np.add.at(yes, tuple((cell - first).T), agreed)
    np.add.at(every, tuple((cell - first).T), 1.0)
    yes, every = (cv2.blur(n, (3, 3), borderType=cv2.BORDER_CONSTANT) for n in (yes, every))
    # Less than a pixel in nine cells is a rounded zero.
    value = np.where(every > 0.1, yes / np.maximum(every, 0.1) - _CELL_AGREES, 0.0)
    total = np.pad(value.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    best, found = -np.inf, (0, 0, 1, 1)
    for top in range(len(value)):
        # Sums of rows top..bottom up to every column; the best stretch of columns is the greatest rise.
        band = total[top + 1 :] - total[top]
        lowest = np.minimum.accumulate(band, axis=1)
        rise = band - lowest
        bottom, right = np.unravel_index(rise.argmax(), rise.shape)
        if rise[bottom, right] > best:
            left = int(band[bottom, : right + 1].argmin())
            best, found = float(rise[bottom, right]), (top, left, top + int(bottom) + 1, int(right))
    corners = (first + np.array(found).reshape(2, 2)) * _CELL_M
    return corners[0], corners[1]
