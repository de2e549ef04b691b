# SPDX-License-Identifier: Apache-2.0
"""The position of a round object that only one camera sees, from its outline in the picture at full size.

Nothing matches there, so its distance is that of its foot on the floor. A row of a picture 160 pixels wide is 0.3 m of
floor at seven metres, and pillars and lamps are wider at their foot than above it: both make it too near.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.stereo.plates import Picture
from studiorecon.images.regions import dilate
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Step of the search for edges, pixels, and distance to either side at which colours are compared.
_STEP_PX, _BESIDE_PX = 0.25, 0.5
# An edge differs by this much in colour (sum over channels), where this share of its points and so many of them are
# known. Its middle is the mean of the positions with nearly the largest difference.
_MIN_CONTRAST, _MIN_SHARE, _MIN_POINTS, _NEARLY = 0.06, 0.35, 6, 0.9
# Sides are measured above the lower quarter, because a base may be below. Points of a side, of a foot.
_ABOVE_BASE, _SIDE_POINTS, _FOOT_POINTS = 0.25, 60, 41
# The part of a foot's front that is used, to either side of its middle.
_FRONT_RAD = 0.6
# A base is at most so much wider, and is searched between these heights above the contact.
_WIDEST, _BASE_STEP, _BASE_PX = 1.6, 0.02, (1.0, 4.0)


def localise_by_contact(
    cylinder: Float[np.ndarray, " 8"], picture: Picture, reach_px: float
) -> Float[np.ndarray, " 8"]:
    """A cylinder on the floor, with its sides and its foot moved onto the edges of its picture, by at most
    ``reach_px``.

    Unchanged where its foot has no edge. Its front is where the picture changes most along the front of its foot; its
    axis is behind that by half its width at the foot.
    """
    camera, (x, y), low_m, high_m = picture.camera, cylinder[1:3], cylinder[6], cylinder[7]
    # Between pixels a colour is known where all neighbours are.
    known = ~dilate(~picture.known, 3)
    centre_m, pixel_rad = camera.centre_m, 1 / camera.focal_px[0]
    apart_m, azimuth = float(np.hypot(x - centre_m[0], y - centre_m[1])), np.arctan2(y - centre_m[1], x - centre_m[0])
    above_m = centre_m[2] - low_m
    if apart_m <= cylinder[4] / 2 or above_m <= 0:
        return cylinder
    half = np.arcsin(cylinder[4] / 2 / apart_m)
    around = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX) * pixel_rad
    aside = _BESIDE_PX * pixel_rad

    def side(at: float, from_m: float, to_m: float, distance_m: float) -> float:
        ends = (_upright(camera, at + s * aside, distance_m, from_m, to_m) for s in (-1, 1))
        return _change(picture.rgb, known, *(camera.project(points)[0] for points in ends))

    shaft_m = low_m + _ABOVE_BASE * (high_m - low_m)
    left, right = (
        _peak(lambda at: side(at, shaft_m, high_m, apart_m), azimuth + sign * half + around) for sign in (-1, 1)
    )
    left, right = (azimuth - half if left is None else left), (azimuth + half if right is None else right)
    if right <= left:
        return cylinder
    azimuth, half = (left + right) / 2, (right - left) / 2
    down_px = np.array([0.0, _BESIDE_PX])
    down = np.arctan(above_m / (apart_m - cylinder[4] / 2)) - around
    down = down[down > pixel_rad]

    def foot(below: float) -> float:
        front_m = above_m / np.tan(below)
        points = _front(camera, azimuth, front_m, front_m * np.sin(half) / (1 - np.sin(half)), low_m)
        pixels = camera.project(points)[0]
        return _change(picture.rgb, known, pixels - down_px, pixels + down_px)

    below = _peak(foot, down)
    if below is None:
        return cylinder
    front_m = above_m / np.tan(below)
    apart_m = front_m / (1 - np.sin(half))
    base_m = [low_m + height * pixel_rad * np.hypot(apart_m, above_m) for height in _BASE_PX]

    def base_side(sign: int, wide: float) -> float:
        return side(azimuth + sign * wide, base_m[0], base_m[1], apart_m)

    widths = half * np.arange(1 - _BASE_STEP, _WIDEST, _BASE_STEP)
    bases = [_peak(partial(base_side, sign), widths) for sign in (-1, 1)]
    seen = [wide for wide in bases if wide is not None]
    base = max(float(np.mean(seen)) if seen else half, half)
    axis_m = front_m / (1 - np.sin(base))
    moved = cylinder.copy()
    moved[1:3] = centre_m[:2] + axis_m * np.array([np.cos(azimuth), np.sin(azimuth)])
    moved[4:6] = 2 * axis_m * np.sin(half)
    return moved


def _upright(camera: Camera, azimuth: float, distance_m: float, low_m: float, high_m: float) -> np.ndarray:
    """(N, 3) points of an upright line, so far from a camera."""
    place = camera.centre_m[:2] + distance_m * np.array([np.cos(azimuth), np.sin(azimuth)])
    heights_m = np.linspace(low_m, high_m, _SIDE_POINTS)
    return np.column_stack([np.tile(place, (_SIDE_POINTS, 1)), heights_m])


def _front(camera: Camera, azimuth: float, front_m: float, radius_m: float, low_m: float) -> np.ndarray:
    """(N, 3) points of the arc of a foot that faces a camera."""
    middle = camera.centre_m[:2] + (front_m + radius_m) * np.array([np.cos(azimuth), np.sin(azimuth)])
    turns = azimuth + np.pi + np.linspace(-_FRONT_RAD, _FRONT_RAD, _FOOT_POINTS)
    arc = middle + radius_m * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    return np.column_stack([arc, np.full(_FOOT_POINTS, low_m)])


def _change(rgb: np.ndarray, known: np.ndarray, before_px: np.ndarray, after_px: np.ndarray) -> float:
    """Mean difference of colours (sum over channels) between two rows of pixels (N, 2); NaN where too few are known."""
    pixels = np.stack([before_px, after_px])
    colours, inside = sample(rgb, pixels)
    usable = (inside & sample(known, pixels, "nearest")[0]).all(axis=0)
    if usable.sum() < max(_MIN_POINTS, _MIN_SHARE * len(usable)):
        return np.nan
    return float(np.abs(colours[0] - colours[1])[usable].sum(axis=1).mean())


def _peak(change: Callable[[float], float], places: Float[np.ndarray, " N"]) -> float | None:
    """The middle of the largest ``change``, if it is an edge: larger than its surroundings, and known there."""
    found = np.array([change(place) for place in places])
    if not np.nanmax(found, initial=0.0) >= _MIN_CONTRAST:
        return None
    top = np.flatnonzero(~(found < _NEARLY * np.nanmax(found)))
    first = last = int(np.nanargmax(found))
    while first - 1 in top:
        first -= 1
    while last + 1 in top:
        last += 1
    edge = first > 0 and last < len(found) - 1 and np.isfinite(found[first : last + 1]).all()
    return float(places[first : last + 1].mean()) if edge else None
