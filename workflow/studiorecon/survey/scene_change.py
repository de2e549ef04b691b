# SPDX-License-Identifier: Apache-2.0
"""Motion in the room other than people: their shadows on the floor, and objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.floor import floor_points, is_near
from studiorecon.geometry.statistics import NOTHING, SIGMA_OF_MAD, Estimate, share_estimate
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# A shadow darkens by this share, changes no channel's share by more than the second, and lasts this many consecutive
# frames.
_DARKER, _SAME_COLOUR, _FRAMES = 0.05, 0.02, 5
_RING_M = 1.0
_SIGMAS = 5.0
# Regions below this share of the picture are not tracked.
_MIN_REGION = 0.00025
# Nor are those of fewer pixels: errors of codecs come in blocks of 4×4.
_MIN_REGION_PX = 16.0
# Morphological opening correlates the errors of neighbouring pixels: this many count as one.
_PATCH_PX = 9
_MIN_RING_PX, _MIN_FREE = 200, 0.3
# Below this level a ratio is noise; a change of fewer levels (of 255) is not visible.
_MIN_LEVEL, _VISIBLE_LEVELS = 4.0, 6.0


def log_ratio_to_plate(
    pictures: Integer[np.ndarray, "T H W 3"],
    plate: Float[np.ndarray, "H W 3"],
    light_log: Float[np.ndarray, " T"],
    free: Bool[np.ndarray, "T H W"],
) -> Float[np.ndarray, "T H W 3"]:
    """Float32 log ratio of ``pictures`` to the ``plate`` in [0, 1], without ``light_log``.

    Each pixel's median over the moments when it is ``free`` is subtracted: errors of the plate are constant over time.
    """
    require("pictures", pictures, ("T", "H", "W", 3))
    require("free", free, pictures.shape[:3])
    ratio = np.log(np.maximum(pictures.astype(np.float32), _MIN_LEVEL))
    ratio -= np.log(np.maximum(plate.astype(np.float32) * 255, _MIN_LEVEL))
    ratio -= np.nan_to_num(light_log).astype(np.float32)[:, None, None, None]
    level = np.where(free, ratio.mean(axis=-1), np.inf)
    order = np.argsort(level, axis=0, kind="stable")
    middle = np.maximum((free.sum(axis=0) - 1) // 2, 0)
    at = np.take_along_axis(order, middle[None], axis=0)
    usual = np.take_along_axis(ratio, at[..., None], axis=0)
    return ratio - np.where(np.any(free, axis=0)[None, ..., None], usual, np.float32(0))


def floor_near_feet(
    camera: Camera, depth_m: Float[np.ndarray, "H W"], floor_m: float, feet_m: Float[np.ndarray, "P T 3"]
) -> Bool[np.ndarray, "T H W"]:
    """Floor within 1 m of any foot; ``camera`` has the size of ``depth_m``, ``feet_m`` is NaN where unknown."""
    points, floor = floor_points(camera, depth_m, floor_m)
    ring = np.zeros((feet_m.shape[1], *camera.hw), bool)
    for feet in feet_m:
        for t in np.flatnonzero(np.isfinite(feet).all(-1)):
            ring[t] |= floor & is_near(points, feet[t : t + 1, :2], _RING_M)
    return ring


def shadow_share(
    ratio: Float[np.ndarray, "T H W 3"],
    free: Bool[np.ndarray, "T H W"],
    ring: Bool[np.ndarray, "T H W"],
    runs: Sequence[slice],
) -> Estimate:
    """Share of the floor around feet that darkens without changing its colour, for five consecutive frames.

    ``ratio``: log ratio to the empty room; ``free``: outside people; ``ring``: floor near feet. The test uses means
    over five frames of one run, so that one noisy frame does not break it.
    """
    require("ring", ring, free.shape)
    ever, dark = np.zeros(free.shape[1:], bool), np.zeros(free.shape[1:], bool)
    for run in runs:
        steady = _running_mean(ratio[run], free[run] & ring[run])
        level, colour = _level_and_colour(steady)
        known = np.isfinite(level)
        ever |= known.any(axis=0)
        shaded = known & (level < np.log(1 - _DARKER)) & (colour < _SAME_COLOUR)
        # A shadow is larger than a pixel, so noise in single pixels does not count.
        for picture in shaded:
            dark |= cv2.morphologyEx(picture.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    if ever.sum() < _MIN_RING_PX:
        return NOTHING
    return share_estimate(int((dark & ever).sum()), int(ever.sum()), int(ever.sum()) / _PATCH_PX)


@dataclass(frozen=True)
class MovingRegion:
    """A region that travels through one camera's pictures ``at`` to ``at`` + 4; area and its error as shares of one."""

    at: int
    area: float
    error: float


def moving_regions(
    ratio: Float[np.ndarray, "T H W 3"],
    free: Bool[np.ndarray, "T H W"],
    usual: Float[np.ndarray, "H W"],
    noise: float,
    runs: Sequence[slice],
) -> list[MovingRegion] | None:
    """Regions that move through one camera's pictures other than people; None when people hide most of the room.

    A region is connected and differs visibly, by more than five standard deviations: of ``noise`` (levels of 255) from
    the ``usual`` level, and of the pixel's own changes, because codecs and swaying shadows change a pixel often and a
    passing object seldom. It is no shadow and does not touch a person's outline, beyond which legs and hands reach when
    keypoints are missing. It travels by more than its own radius in five consecutive frames; things that flicker in
    place do not count.
    """
    height, width = free.shape[1:]
    runs = [run for run in runs if run.stop - run.start >= _FRAMES]
    if not runs or free.mean() < _MIN_FREE:
        return None
    noise_log = noise / np.maximum(usual, _MIN_LEVEL)
    level, colour = _level_and_colour(ratio)
    # Lamps of several colours tint a shadow: what one of them lights has half of its change at most.
    shadow = (level < 0) & (colour < np.maximum(np.maximum(_SAME_COLOUR, 3 * noise_log), -level / 2))
    change, ever, own_log = np.abs(level) + colour, np.any(free, axis=0), np.zeros((height, width))
    own_log[ever] = SIGMA_OF_MAD * np.nanmedian(np.where(free, change, np.float32(np.nan))[:, ever], axis=0)
    visible_log = np.maximum(_SIGMAS * np.maximum(noise_log, own_log), _VISIBLE_LEVELS / noise * noise_log)
    changed = free & (change > visible_log) & ~shadow
    found = []
    for run in runs:
        seen = [
            _regions(c, f, max(_MIN_REGION * height * width, _MIN_REGION_PX)) for c, f in zip(changed[run], free[run])
        ]
        for t in range(len(seen) - _FRAMES + 1):
            for first in seen[t]:
                areas = np.array(_follow_region(first, seen[t + 1 : t + _FRAMES], 0.15 * width)) / (height * width)
                if len(areas) == _FRAMES:
                    found.append(
                        MovingRegion(run.start + t, float(np.median(areas)), float(areas.std() / _FRAMES**0.5))
                    )
    return found


def largest_moving(found: Sequence[Sequence[MovingRegion] | None]) -> Estimate:
    """Area of the largest region that moves while another camera sees one move too, and which camera shows it.

    An object in the room is seen from several sides; reflections and the codec's errors are one camera's own. There is
    no estimate when fewer than two cameras see the room.
    """
    known = [(camera, region) for camera, own in enumerate(found) for region in own or ()]
    if sum(own is not None for own in found) < 2:
        return NOTHING
    shared = [
        (region.area, region.error, camera)
        for camera, region in known
        if any(camera != other and abs(region.at - one.at) < _FRAMES for other, one in known)
    ]
    if not shared:
        return Estimate(0.0, (0.0, _MIN_REGION))
    area, error, camera = max(shared)
    return Estimate(area, (max(area - 2 * error, 0.0), area + 2 * error), camera)


def _level_and_colour(ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the channels (T, H, W), and the largest difference of a channel from it."""
    # Channel by channel: numpy is several times slower along a last axis of 3.
    red, green, blue = (ratio[..., k] for k in range(3))
    level = (red + green + blue) / np.float32(3)
    return level, np.maximum(np.maximum(np.abs(red - level), np.abs(green - level)), np.abs(blue - level))


def _follow_region(
    first: tuple[float, np.ndarray], later: Sequence[list[tuple[float, np.ndarray]]], reach_px: float
) -> list[float]:
    """Areas of a region in successive pictures; none when it is lost, changes its size fourfold or stays in place."""
    areas, places = [first[0]], [first[1]]
    for regions in later:
        near = min(regions, key=lambda r: np.linalg.norm(r[1] - places[-1]), default=None)
        if near is None or np.linalg.norm(near[1] - places[-1]) > reach_px or not 0.25 < near[0] / areas[-1] < 4:
            return []
        areas.append(near[0])
        places.append(near[1])
    return areas if np.linalg.norm(places[-1] - places[0]) > np.sqrt(np.median(areas) / np.pi) else []


def _regions(changed: np.ndarray, free: np.ndarray, least_px: float) -> list[tuple[float, np.ndarray]]:
    """(area, centre) of regions of at least ``least_px`` after an opening that do not touch pixels outside ``free``."""
    solid = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    count, labels, statistics, centres = cv2.connectedComponentsWithStats(solid, connectivity=8)
    beside = cv2.dilate((~free).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    touching = set(np.unique(labels[beside]).tolist())
    areas = statistics[:, cv2.CC_STAT_AREA]
    return [(float(areas[i]), centres[i]) for i in range(1, count) if areas[i] >= least_px and i not in touching]


def _running_mean(ratio: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(T - 4, H, W, 3) mean over five consecutive frames where all are known, else NaN."""
    if len(ratio) < _FRAMES:
        return np.full((0, *ratio.shape[1:]), np.nan, np.float32)
    filled = np.where(known[..., None], ratio, 0).astype(np.float32)
    windows = range(len(ratio) - _FRAMES + 1)
    mean = np.stack([filled[t : t + _FRAMES].mean(axis=0) for t in windows])
    whole = np.stack([known[t : t + _FRAMES].all(axis=0) for t in windows])
    return np.where(whole[..., None], mean, np.float32(np.nan))


def largest_estimate(
    names: Sequence[str], found: Sequence[Estimate]
) -> tuple[float | None, tuple[float, float] | None, str]:
    """Value, interval and name of the camera whose estimate is certainly the largest; None when none was measured."""
    known = [
        (e.interval[0], e.value, e.interval, name)
        for name, e in zip(names, found)
        if e.value is not None and e.interval is not None
    ]
    if not known:
        return None, None, ""
    _, value, interval, name = max(known)
    return value, interval, name
