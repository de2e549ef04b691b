# SPDX-License-Identifier: Apache-2.0
"""A platform: a raised surface under people, such as a treadmill, a stage, or a plate on a lower floor.

The height z = 0 is that of feet. If photos agree on that height only in one area, and see surfaces below it all around,
that area is a platform, and the room's floor is lower. Every wall located by the floor, and everything painted on the
floor, would otherwise be too near.

A polished floor mirrors objects below itself, but the photos agree on it nearly everywhere. So lower surfaces count
outside the area of agreement, and must be large in comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.stereo.plates import UNKNOWN, Picture
from studiorecon.depth.sweep_settings import Matching
from studiorecon.scene.room import Platform

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Heights relative to people's feet that are compared: down to the deepest floor, and up far enough to separate surfaces
# above from those below.
_STEP_M, _DEEPEST_M, _HIGHEST_M = 0.04, 1.2, 1.0
# A floor on which no more than this share of textured pixels disagrees is the room's.
_AGREED, _DISAGREED, _MIN_DISAGREEING = 0.6, 0.3, 0.25
# A pixel's height counts if it matches so well, so much better than any height further off than so many steps, and if
# its pixel in the other picture has the same height to a step.
_MIN_SCORE, _MIN_LEAD, _APART = 0.7, 0.08, 3
# The platform is where the feet's height matches nearly as well as any lower one, the rest is where it matches clearly
# worse: stripes match at many heights.
_NEARLY, _WORSE = 0.15, 0.3
# Surfaces are counted in cells of the floor, not in pixels, because near ones would outvote the rest.
_CELL_M = 0.1
# A cell belongs to the platform where this share of its pixels agrees.
_CELL_AGREES = 0.4
# So many cells around the platform must be lower, at least this share of all known ones there, and of those on it.
# Within this many steps a cell is at the platform's own height.
_MIN_CELLS, _MIN_SHARE, _MIN_AROUND, _OWN = 50, 0.6, 0.4, 1
# Mats and boxes are on the floor, which is the lowest height with this share of the most frequent one's cells. A floor
# less than so far down is within the cameras' error.
_LOWEST_SHARE, _MIN_DOWN_M = 0.6, 0.14


@dataclass(frozen=True)
class _HeightVotes:
    """The heights that pixels vote for.

    Attributes:
        place_m: points on whose height two cameras agree.
        step: their height, in steps above people's feet.
        score: how well they match.
        at_feet_m: positions of all comparable pixels at the height of people's feet.
        can_be_floor: (M,) bool: their surface may be at that height.
    """

    place_m: Float[np.ndarray, "N 3"]
    step: Integer[np.ndarray, " N"]
    score: Float[np.ndarray, " N"]
    at_feet_m: Float[np.ndarray, "M 2"]
    can_be_floor: Bool[np.ndarray, " M"]


@dataclass(frozen=True)
class RaisedFloor:
    """People are on a ``platform``; the room's floor around it is at ``floor_m`` and matches with ``score``."""

    platform: Platform
    floor_m: float
    score: float


def fit_platform(
    pictures: Sequence[Picture], axes: Float[np.ndarray, "3 3"], standing_m: float, how: Matching
) -> RaisedFloor | None:
    """The platform under people at ``standing_m``, or None where that is the floor; ``axes`` are the room box's.

    A tenth of a second for four pictures 240 pixels wide where photos agree on the floor, 3 s where they do not.
    """
    if _mismatch_share(pictures, standing_m, how) < _MIN_DISAGREEING:
        return None
    votes = _height_votes(pictures, standing_m, how)
    if not votes.can_be_floor.any():
        return None
    corner, upper = _densest(votes.at_feet_m @ axes[:2, :2].T, votes.can_be_floor)
    level, below = np.abs(votes.step) <= _OWN, votes.step < -_OWN
    local = votes.place_m @ axes.T
    outside = ((local[:, :2] < corner) | (local[:, :2] > upper)).any(axis=1)
    lower, same = len(_cells(local[below & outside])), len(_cells(local[level & outside]))
    on_it = len(_cells(local[level & ~outside]))
    if lower < max(_MIN_CELLS, _MIN_SHARE * (lower + same), _MIN_AROUND * on_it):
        return None
    # Cells at every step below people's feet, and as far above them.
    count, above = np.zeros((2, round(_DEEPEST_M / _STEP_M) + 2))
    for step in range(_OWN + 1, len(count)):
        count[step], above[step] = (len(_cells(local[outside & (votes.step == at)])) for at in (-step, step))
    around = np.convolve(count, np.ones(3), mode="same")
    lowest = int(np.flatnonzero(around >= _LOWEST_SHARE * around.max())[-1])
    # The neighbouring peak, and its fraction of a step: cells of three steps, the middle one the fullest.
    peak = lowest - 1 + int(count[lowest - 1 : lowest + 2].argmax())
    span = np.arange(peak - 1, min(peak + 2, len(count)))
    floor_m = standing_m - _STEP_M * float((span * count[span]).sum() / count[span].sum())
    # If cameras are a degree off, the floor under people separates too, but as much of it above as below.
    if standing_m - floor_m < _MIN_DOWN_M or above[: peak + 2].sum() > count[: peak + 2].sum():
        return None
    score = float(votes.score[outside & (np.abs(votes.step + peak) <= 1)].mean())
    return RaisedFloor(Platform(corner, upper, standing_m), floor_m, score)


def _mismatch_share(pictures: Sequence[Picture], standing_m: float, how: Matching) -> float:
    """Share of the textured pixels at the height of people's feet, seen by other cameras there, that do not match."""
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
    return picture.score(other, plane, replace(how, window=how.window + 2, mean_weight=0.0))


@dataclass(frozen=True)
class _Pair:
    """A picture compared with another: best height, its score, whether it is clear, and two more scores.

    These are the best score at people's feet, and the best of all heights up to there.
    """

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
    """The height votes of all pictures' pixels, each picture compared with every other."""
    steps = np.arange(-round(_DEEPEST_M / _STEP_M), round(_HIGHEST_M / _STEP_M) + 1)
    plane = np.array([0.0, 0.0, 1.0, standing_m])
    pairs = {
        (i, j): _pair(picture, other, standing_m, steps, how)
        for i, picture in enumerate(pictures)
        for j, other in enumerate(pictures)
        if i != j
    }
    places, chosen, scores = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.float32)]
    feet, can_be_floor = [np.zeros((0, 2))], [np.zeros(0, bool)]
    for i, picture in enumerate(pictures):
        centre, centres = picture.camera.centre_m, picture.camera.pixel_centres()
        # Only rays that point down meet heights below the camera.
        usable = picture.known & picture.textured(how.window + 2) & (picture.depth(plane, how) > 0)
        rays = picture.camera.unproject(centres, np.ones(usable.shape)) - centre
        theirs = [pair for (first, _), pair in pairs.items() if first == i]
        if not theirs:
            continue
        level, up_to = (np.max([getattr(pair, name) for pair in theirs], axis=0) for name in ("at_feet", "up_to_feet"))
        on_it = (level > _AGREED) & (level > up_to - _NEARLY)
        clear = usable & (level > UNKNOWN) & (on_it | (level < _DISAGREED) | (level < up_to - _WORSE))
        feet.append((centre + ((standing_m - centre[2]) / rays[clear][:, 2])[:, None] * rays[clear])[:, :2])
        can_be_floor.append(on_it[clear])
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
    return _HeightVotes(*(np.concatenate(parts) for parts in (places, chosen, scores, feet, can_be_floor)))


def _cells(local_m: Float[np.ndarray, "N 3"]) -> Integer[np.ndarray, "M 2"]:
    """The cells in plan that points are in."""
    return np.unique(np.floor(local_m[:, :2] / _CELL_M).astype(int), axis=0)


def _densest(
    places_m: Float[np.ndarray, "N 2"], agreed: Bool[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Least and greatest coordinates of the rectangle in which most cells agree and fewest do not.

    It maximises the sum over cells of the share of pixels that agree, less the least share of a platform's cell.
    """
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
        # Sums of rows top..bottom up to every column; the best range of columns is the greatest rise.
        band = total[top + 1 :] - total[top]
        lowest = np.minimum.accumulate(band, axis=1)
        rise = band - lowest
        bottom, right = np.unravel_index(rise.argmax(), rise.shape)
        if rise[bottom, right] > best:
            left = int(band[bottom, : right + 1].argmin())
            best, found = float(rise[bottom, right]), (top, left, top + int(bottom) + 1, int(right))
    corners = (first + np.array(found).reshape(2, 2)) * _CELL_M
    return corners[0], corners[1]
