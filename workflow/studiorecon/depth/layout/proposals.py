# SPDX-License-Identifier: Apache-2.0
"""Furniture candidates: rectangles of tops in plan and fronts in elevation that match better than the background.

The photos are projected onto every horizontal and upright plane inside the room (orthographic, a few centimetres a
cell), each pair of cameras is correlated there, and the score of the same pixels' current explanation is subtracted.
Rectangles of the largest sum are the tops and fronts of boxes to try; floating boxes may have legs.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.stereo.kernels import UNSEEN
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.images.channels import channel_sum
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float, Num

_CELL_M = 0.06
_WINDOW = 5
_TOPS_M = np.arange(0.12, 1.35, 0.03)
_FRONT_STEP_M, _FRONT_HEIGHT_M = 0.06, 2.2
# Sides of the rectangles to try, metres; yaws of tops against the walls, radians.
_SIDES_M = (0.24, 0.36, 0.6, 0.9, 1.4, 2.1)
_YAWS_RAD = np.radians([0, 22.5, 45, 67.5])
_FLAT_VARIANCE = 4e-4
# Least sum of a rectangle's cells; overlap from which two are one; number of best ones of every plane.
_MIN_SUM, _OVERLAP, _PER_PLANE = 6.0, 0.5, 3
_DEPTHS_M = (0.25, 0.45, 0.8)
_TO_WALL_M = 1.0
# How far outside the cameras furniture is searched where there is no wall.
_REACH_M = 2.5
_SLAB_M = 0.06
# A slab this far above the floor needs support: widths of posts, and step at which they are tried under all of it.
_MIN_UNDER_M, _POSTS_M, _POST_STEP_M = 0.3, (0.06, 0.1), 0.04
# Least difference from the face behind, largest gaps up and aside between parts, least area, and least pixels on the
# floor.
_UNLIKE, _GAP_PX, _MIN_AREA, _MIN_ON_FLOOR = 0.2, (5, 3), 40, 3


def agreement_gain(
    room: PhotoCostVolume, points_m: Float[np.ndarray, "A B 3"], outward: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "A B"]:
    """Gain in agreement of the best pair of cameras on surface points over the current explanation, float32.

    Only cameras on the side that ``outward`` points to take part; 0 where no two see the point.
    """
    colours, agreed, inside = [], [], []
    cost = np.where(room.cost > 0, room.cost, np.where(room.known, room.cost, UNSEEN))
    for v in range(len(room.known)):
        if (room.centre[v] - points_m[0, 0]) @ outward < 0.05:
            continue
        local = points_m @ room.pose[v, :, :3].T + room.pose[v, :, 3]
        z = np.maximum(local[..., 2], 1e-6)
        columns, rows = (
            (local[..., k] / z * room.lens[v, k] + room.lens[v, 2 + k] - 0.5).astype(np.float32) for k in (0, 1)
        )
        seen = cv2.remap(room.known[v].astype(np.uint8), columns, rows, cv2.INTER_NEAREST, borderValue=0).astype(
            bool
        ) & (local[..., 2] > 0.1)
        inside.append(seen)
        colours.append(cv2.remap(room.rgb[v], columns, rows, cv2.INTER_LINEAR))
        agreed.append(1 - cv2.remap(cost[v], columns, rows, cv2.INTER_LINEAR))
    best = np.zeros(points_m.shape[:2], np.float32)
    mean = [cv2.blur(c, (_WINDOW, _WINDOW)) for c in colours]
    variance = [np.maximum(channel_sum(cv2.blur(c * c, (_WINDOW, _WINDOW)) - m * m), 0) for c, m in zip(colours, mean)]
    for i in range(len(colours)):
        for j in range(i):
            covariance = channel_sum(cv2.blur(colours[i] * colours[j], (_WINDOW, _WINDOW)) - mean[i] * mean[j])
            score = (covariance + _FLAT_VARIANCE) / np.sqrt(
                (variance[i] + _FLAT_VARIANCE) * (variance[j] + _FLAT_VARIANCE)
            )
            score -= room.mean_weight * np.minimum(channel_sum(np.abs(mean[i] - mean[j])), 0.6)
            more = np.maximum(score, -0.2) - (agreed[i] + agreed[j]) / 2
            best = np.where(inside[i] & inside[j], np.where(best == 0, more, np.maximum(best, more)), best)
    return best


def best_rectangles(
    value: Num[np.ndarray, "A B"], sides: tuple[int, ...], standing: bool
) -> list[tuple[float, int, int, int, int]]:
    """Best (sum, top, left, rows, columns) of a map, overlapping ones reduced to the best; ``standing``: from row 0."""
    total = np.pad(value.cumsum(axis=0, dtype=np.float64).cumsum(axis=1), ((1, 0), (1, 0)))
    found = []
    bands = {rows: total[rows:] - total[:-rows] for rows in sides if rows < value.shape[0]}
    for rows, columns in product(bands, sides):
        if columns >= value.shape[1]:
            continue
        band = bands[rows][:1] if standing else bands[rows]
        sums = band[:, columns:] - band[:, :-columns]
        if sums.max() < _MIN_SUM:
            continue
        sums = np.ascontiguousarray(sums, np.float32)
        peaks = (sums >= _MIN_SUM) & (sums >= cv2.dilate(sums, np.ones((7, 7), np.uint8)))
        found += [(float(sums[y, x]), int(y), int(x), rows, columns) for y, x in np.argwhere(peaks)]
    found.sort(reverse=True)
    kept: list[tuple[float, int, int, int, int]] = []
    for one in found:
        if len(kept) == _PER_PLANE:
            break
        if all(_overlap(one, other) < _OVERLAP for other in kept):
            kept.append(one)
    return kept


def _overlap(one: tuple[float, int, int, int, int], other: tuple[float, int, int, int, int]) -> float:
    """Intersection over union."""
    _, top, left, rows, columns = one
    _, y, x, height, width = other
    shared = max(min(top + rows, y + height) - max(top, y), 0) * max(min(left + columns, x + width) - max(left, x), 0)
    return shared / (rows * columns + height * width - shared)


def search_bounds(room: PhotoCostVolume, room_box: RoomBox) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Least and greatest coordinates, along the room box's axes, of the search for furniture.

    That is the room; towards a default wall, it ends where two cameras no longer resolve furniture.
    """
    centres = room.centre @ room_box.axes.T
    fitted = room_box.fitted.reshape(3, 2)
    low = np.where(fitted[:, 0], room_box.low_m, np.maximum(room_box.low_m, centres.min(axis=0) - _REACH_M))
    high = np.where(fitted[:, 1], room_box.high_m, np.minimum(room_box.high_m, centres.max(axis=0) + _REACH_M))
    return low, high


def top_proposals(room: PhotoCostVolume, room_box: RoomBox) -> Iterator[Float[np.ndarray, " 7"]]:
    """Primitives (7,): boxes and slabs under every rectangle in plan that matches."""
    low_m, high_m = search_bounds(room, room_box)
    middle, size = (low_m + high_m)[:2] / 2, (high_m - low_m)[:2]
    sides = tuple(round(s / _CELL_M) for s in _SIDES_M)
    # One square map, so that it can be turned about its middle.
    half = int(np.hypot(*size) / 2 / _CELL_M) + 1
    along = np.arange(-half, half + 1) * _CELL_M
    u, v = np.meshgrid(along, along, indexing="ij")
    within = (np.abs(u) < size[0] / 2) & (np.abs(v) < size[1] / 2)
    for height in _TOPS_M:
        points = (
            np.stack([middle[0] + u, middle[1] + v, np.full(u.shape, room_box.low_m[2] + height)], axis=-1)
            @ room_box.axes
        )
        value = np.where(within, agreement_gain(room, points, np.array([0.0, 0.0, 1.0])), np.float32(-0.5))
        for yaw in _YAWS_RAD:
            turned = cv2.warpAffine(
                value, cv2.getRotationMatrix2D((half, half), -np.degrees(yaw), 1.0), value.shape, borderValue=-0.5
            )
            c, s = np.cos(yaw), np.sin(yaw)
            for _, top, left, rows, columns in best_rectangles(turned, sides, standing=False):
                a, b = (top + (rows - 1) / 2 - half) * _CELL_M, (left + (columns - 1) / 2 - half) * _CELL_M
                at = np.array([middle[0] + c * a - s * b, middle[1] + s * a + c * b, 0]) @ room_box.axes
                for low in (0.0, height - _SLAB_M):
                    size_m, z_m = (rows * _CELL_M, columns * _CELL_M), room_box.low_m[2] + np.array([low, height])
                    yield np.array([at[0], at[1], room_box.yaw_rad + yaw, *size_m, *z_m])


def front_proposals(room: PhotoCostVolume, room_box: RoomBox) -> Iterator[Float[np.ndarray, " 7"]]:
    """Primitives (7,): boxes behind every rectangle in elevation that matches."""
    low_m, high_m = search_bounds(room, room_box)
    sides = tuple(round(s / _CELL_M) for s in _SIDES_M)
    heights = room_box.low_m[2] + np.arange(
        _CELL_M / 2, min(_FRONT_HEIGHT_M, room_box.high_m[2] - room_box.low_m[2]), _CELL_M
    )
    for axis, side in product((0, 1), (-1, 1)):
        other = 1 - axis
        along = np.arange(low_m[other] + _CELL_M / 2, high_m[other], _CELL_M)
        outward = side * room_box.axes[axis]
        wall = room_box.low_m[axis] if side > 0 else room_box.high_m[axis]
        for offset in np.arange(low_m[axis] + _FRONT_STEP_M, high_m[axis], _FRONT_STEP_M):
            local = np.zeros((len(heights), len(along), 3))
            local[..., axis], local[..., other], local[..., 2] = offset, along, heights[:, None]
            value = agreement_gain(room, local @ room_box.axes, outward)
            back = abs(offset - wall)
            for _, _, left, rows, columns in best_rectangles(value, sides, standing=True):
                for depth in (
                    (back,) if back <= _DEPTHS_M[0] else ((back, *_DEPTHS_M) if back <= _TO_WALL_M else _DEPTHS_M)
                ):
                    at, size = np.zeros(3), np.zeros(2)
                    at[axis], at[other] = offset - side * depth / 2, along[left] + (columns - 1) / 2 * _CELL_M
                    size[axis], size[other] = depth, columns * _CELL_M
                    at = at @ room_box.axes
                    low = room_box.low_m[2]
                    yield np.array([at[0], at[1], room_box.yaw_rad, *size, low, low + rows * _CELL_M])


def single_view_proposals(room: PhotoCostVolume, room_box: RoomBox) -> Iterator[Float[np.ndarray, " 7"]]:
    """Primitives (7,): regions seen by one camera that differ from wall and floor behind, on their lowest point."""
    for v in range(len(room.known)):
        alone = room.known[v] & (room.cost[v] >= UNSEEN) & (room.surface[v] < 6)
        unlike = (alone & (room.foreground_log_odds[v] > _UNLIKE)).astype(np.uint8)
        for how, gap in ((cv2.MORPH_OPEN, (2, 2)), (cv2.MORPH_CLOSE, _GAP_PX)):
            unlike = cv2.morphologyEx(unlike, how, np.ones(gap, np.uint8))
        count, labels, stats, _ = cv2.connectedComponentsWithStats(unlike, connectivity=4)
        for k in range(1, count):
            left, top, columns, rows, area = stats[k]
            if area < _MIN_AREA or (room.surface[v][labels == k] == 4).sum() < _MIN_ON_FLOOR:
                continue
            bottom = top + rows - 1
            feet = np.flatnonzero((labels[bottom - max(rows // 12, 1) : bottom + 1] == k).any(axis=0))
            widths = (labels == k).sum(axis=1)[top : bottom + 1]
            for column, width in product((feet.mean(), left + columns / 2), (np.median(widths), widths.max())):
                fx, fy, cx, cy = room.lens[v]
                ray = room.pose[v, :, :3].T @ np.array([(column + 0.5 - cx) / fx, (bottom + 1 - cy) / fy, 1.0])
                if ray[2] >= 0:
                    continue
                z = (room_box.low_m[2] - room.centre[v, 2]) / ray[2]
                side = width * z / fx
                ahead = ray[:2] / np.linalg.norm(ray[:2])
                at = room.centre[v, :2] + z * ray[:2] + ahead * side / 2
                over = room.pose[v, :, :3].T @ np.array([(column + 0.5 - cx) / fx, (top - cy) / fy, 1.0])
                high = room_box.high_m[2] if top <= 1 else min(room.centre[v, 2] + z * over[2], room_box.high_m[2])
                yield np.array([*at, room_box.yaw_rad, side, side, room_box.low_m[2], high])


def leg_candidates(slab: Float[np.ndarray, " 7"], floor_m: float) -> Float[np.ndarray, "N 7"]:
    """Upright bars between the floor and a floating box, at all positions under it: legs.

    They are too thin to be detected as furniture and explain little each. None under other primitives, or under boxes
    nearly on the floor.
    """
    if slab[5] - floor_m < _MIN_UNDER_M:
        return np.zeros((0, 7))
    c, s = np.cos(slab[2]), np.sin(slab[2])
    found = []
    for width_m in _POSTS_M:
        along, across = (
            np.linspace(-reach, reach, int(2 * reach / _POST_STEP_M) + 1)
            for reach in np.maximum(slab[3:5] - width_m, 0) / 2
        )
        u, v = (grid.ravel() for grid in np.meshgrid(along, across))
        bars = np.tile([0, 0, slab[2], width_m, width_m, floor_m, slab[5]], (len(u), 1))
        bars[:, 0], bars[:, 1] = slab[0] + c * u - s * v, slab[1] + s * u + c * v
        found.append(bars)
    return np.concatenate(found)
