# SPDX-License-Identifier: Apache-2.0
"""The floor's height: at people's feet, or below a platform they stand on (a treadmill, a stage, a plate).

Every height is a floor that explains pixels, in nats. A pixel shows the floor, or pays for a surface above it; nothing
lies below. Feet stand on the floor, or on one rectangle at their own height around which a lower floor is seen. The
best rectangle of every height competes with the floor at the feet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.layout.box import place_plane
from studiorecon.depth.stereo.plates import Picture, nats_of_plane
from studiorecon.depth.sweep_settings import Matching
from studiorecon.scene.room import Platform

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Heights relative to people's feet; a floor less far down than the first is within the cameras' error.
_STEP_M, _LEAST_DOWN_M, _DEEPEST_M, _HIGHEST_M = 0.04, 0.14, 1.2, 1.0
# Surfaces are counted in cells of the floor, not in pixels, because near ones would outvote the rest.
_CELL_M = 0.1
# Price of a surface that is not the floor, nats a cell; and of a platform: 2.5 m² of floor seen around it. Cameras that
# are two thirds of a degree off make up 700 nats.
_ABOVE, _PLATFORM = 1.0, 1000.0


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

    Some 2 s for four pictures 240 pixels wide.
    """
    steps = np.arange(-round(_DEEPEST_M / _STEP_M), round(_HIGHEST_M / _STEP_M) + 1)
    wide = replace(how, window=how.window + 2, mean_weight=0.0)
    seen = [
        np.stack([nats_of_plane(pictures, i, np.array([0, 0, 1, standing_m + _STEP_M * k]), wide) for k in steps])
        for i in range(len(pictures))
    ]
    on_level = [_places_at_height(picture, axes, standing_m, how) for picture in pictures]
    judged = [(cost != 0).any(axis=0) & np.isfinite(place_m[..., 0]) for cost, place_m in zip(seen, on_level)]
    cost = np.concatenate([c[:, m] for c, m in zip(seen, judged)], axis=1)
    place_m = np.concatenate([p[m] for p, m in zip(on_level, judged)])
    if not len(place_m):
        return None
    above = np.minimum.accumulate(cost[::-1], axis=0)[::-1]
    explained = np.minimum(np.minimum(cost, above + _ABOVE), 0)
    feet = explained[steps == 0][0]
    best, found = _PLATFORM, None
    for k in np.flatnonzero(steps * _STEP_M <= -_LEAST_DOWN_M):
        gain, first = _mean_of_cells(place_m, feet - explained[k])
        (top, left, bottom, right), inside = _lowest_rectangle(gain)
        if gain.sum() - inside > best:
            best, found = gain.sum() - inside, (k, (first + np.array([[top, left], [bottom, right]])) * _CELL_M)
    if found is None:
        return None
    k, (low_m, high_m) = found
    around = [((p < low_m) | (p > high_m)).any(axis=-1) & (c[k] < 0) for p, c in zip(on_level, seen)]
    height_m = standing_m + _STEP_M * float(steps[k])
    floor_m, score = place_plane(pictures, around, axes[2], height_m, _STEP_M, _STEP_M / 4, how)
    return RaisedFloor(Platform(low_m, high_m, standing_m), floor_m, score)


def _places_at_height(
    picture: Picture, axes: Float[np.ndarray, "3 3"], height_m: float, how: Matching
) -> Float[np.ndarray, "H W 2"]:
    """Where each pixel's ray meets a height, along the room box's axes; NaN where it does not."""
    depth_m = picture.depth(np.array([0.0, 0.0, 1.0, height_m]), how)
    points_m = picture.camera.unproject(picture.camera.pixel_centres(), np.where(depth_m > 0, depth_m, np.nan))
    return (points_m @ axes.T)[..., :2]


def _mean_of_cells(
    place_m: Float[np.ndarray, "N 2"], value: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, "A B"], Integer[np.ndarray, " 2"]]:
    """The mean of the values in every cell, 0 in empty ones, and the first cell."""
    cell = np.floor(place_m / _CELL_M).astype(int)
    first = cell.min(axis=0)
    total, count = np.zeros((2, *(np.ptp(cell, axis=0) + 1)))
    np.add.at(total, tuple((cell - first).T), value)
    np.add.at(count, tuple((cell - first).T), 1.0)
    return total / np.maximum(count, 1), first


def _lowest_rectangle(value: Float[np.ndarray, "A B"]) -> tuple[tuple[int, int, int, int], float]:
    """The rectangle (first row and column, those after the last) with the least sum, and that sum."""
    total = np.pad(value.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    least, found = 0.0, (0, 0, 0, 0)
    for top in range(len(value)):
        # Sums of rows top..bottom up to every column; the best range of columns is the greatest fall.
        band = total[top + 1 :] - total[top]
        fall = band - np.maximum.accumulate(band, axis=1)
        bottom, right = np.unravel_index(fall.argmin(), fall.shape)
        if fall[bottom, right] < least:
            left = int(band[bottom, : right + 1].argmax())
            least, found = float(fall[bottom, right]), (top, left, top + int(bottom) + 1, int(right))
    return found, least
