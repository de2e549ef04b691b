# SPDX-License-Identifier: Apache-2.0
"""Who stands where: the space that no camera sees through (the visual hull), its parts of human size, and how they move.

A point is inside the hull when at least two cameras show somebody there and no camera that sees it shows the room, or one does
against three: clothes of the wall's colour leave holes in a silhouette. Parts are told apart on the ground plan, since people stand
beside each other, not on each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numba
import numpy as np
import scipy

from studiorecon.people.foreground import BACKGROUND, FOREGROUND
from studiorecon.scene.camera import Camera

# How far around the middle of the cameras' views people are looked for, how high, and how deep the floor may lie; metres.
_REACH_M, _TOP_M, _BELOW_M = 6.0, 2.4, 0.3
# A column of less than this is no part of a person's ground plan: shadows, cables, the edge of a mat.
_COLUMN_M = 0.4


@dataclass(frozen=True)
class HullLimits:
    """What counts as a person.

    Attributes:
        voxel_m: edge of the space's cells when somebody is looked for; half of it is used where somebody is.
        step_s: time between the pictures in which somebody is looked for.
        height_m, volume_l: least and most height and volume of a person's hull, metres and litres.
        footprint_m2: most area on the ground plan.
        cameras: at least so many must show the person.
        share: of the pictures that were looked at, at least this share must show the person.
        speed_m_s: how fast a person moves at most.
        apart_m: hulls nearer than this to a person with keypoints are that person's.
    """

    voxel_m: float
    step_s: float
    height_m: tuple[float, float]
    volume_l: tuple[float, float]
    footprint_m2: float
    cameras: int
    share: float
    speed_m_s: float
    apart_m: float


@dataclass(frozen=True)
class Part:
    """One part of the hull at one frame: where it stands (2,), cells (N, 3), cameras (V,) that show it or deny a cell (N, V)."""

    place_m: np.ndarray
    cells_m: np.ndarray
    seen_by: np.ndarray
    denied: np.ndarray


@dataclass(frozen=True)
class Track:
    """One part of the hull over time: ``frames`` (F,), ``places_m`` (F, 2), cameras ``seen_by`` (V,) in most of them."""

    frames: np.ndarray
    places_m: np.ndarray
    seen_by: np.ndarray


def watched_cells(cameras: Sequence[Camera], voxel_m: float, least: int) -> tuple[np.ndarray, tuple[int, int, int]]:
    """(N, 3) centres of the cells of a box around all that ``least`` cameras see, and the box's cells along x, y, z."""
    centre = _middle(cameras)
    coarse = _box(np.append(centre - _REACH_M, -_BELOW_M), np.append(centre + _REACH_M, _TOP_M), 0.2)[0]
    inside = sum(_in_view(c, coarse) for c in cameras) >= least
    if not inside.any():
        return np.zeros((0, 3)), (0, 0, 0)
    low, high = coarse[inside].min(0), coarse[inside].max(0)
    return _box(low, high, voxel_m)


def cells_around(place_m: np.ndarray, voxel_m: float, radius_m: float = 1.1) -> tuple[np.ndarray, tuple[int, int, int]]:
    """(N, 3) centres of the cells of a box around a person who stands at ``place_m`` (2,)."""
    return _box(np.append(place_m - radius_m, -_BELOW_M), np.append(place_m + radius_m, _TOP_M), voxel_m)


def parts(
    cells_m: np.ndarray, shape: tuple[int, int, int], cameras: Sequence[Camera], labels: Sequence[np.ndarray], voxel_m: float
) -> list[Part]:
    """Parts of the hull of one frame, largest first; ``labels`` are the cameras' pictures (H, W) of ``foreground.labels``."""
    if not len(cells_m):
        return []
    shown, denied, occupied = _carved(cells_m, cameras, labels)
    regions, count = _ground_plan(occupied, shape, voxel_m)
    found = []
    for k in range(1, count):
        chosen = occupied & (regions == k)
        found.append(_part(cells_m, shown, denied, chosen))
    return sorted(found, key=lambda p: -len(p.cells_m))


def whole_person(
    cells_m: np.ndarray,
    shape: tuple[int, int, int],
    cameras: Sequence[Camera],
    labels: Sequence[np.ndarray],
    voxel_m: float,
    place_m: np.ndarray,
    radius_m: float,
) -> Part | None:
    """Everything connected to the parts within ``radius_m`` of ``place_m`` (2,), arms included; None when nothing stands there."""
    shown, denied, occupied = _carved(cells_m, cameras, labels)
    regions, count = _ground_plan(occupied, shape, voxel_m)
    core = np.zeros(len(cells_m), bool)
    for k in range(1, count):
        chosen = occupied & (regions == k)
        if np.linalg.norm(np.median(cells_m[chosen, :2], axis=0) - place_m) <= radius_m:
            core |= chosen
    if not core.any():
        return None
    bodies = scipy.ndimage.label(occupied.reshape(shape), np.ones((3, 3, 3)))[0].reshape(-1)
    return _part(cells_m, shown, denied, occupied & np.isin(bodies, np.unique(bodies[core])))


def _part(cells_m: np.ndarray, shown: np.ndarray, denied: np.ndarray, chosen: np.ndarray) -> Part:
    return Part(np.median(cells_m[chosen, :2], axis=0), cells_m[chosen], shown[chosen].mean(0) > 0.3, denied[chosen])


def _carved(cells_m: np.ndarray, cameras: Sequence[Camera], labels: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, V) which cameras show somebody at a cell and which deny it, (N,) which cells are inside the hull."""
    matrices = np.stack([c.intrinsics @ c.camera_from_world[:3] for c in cameras])
    sizes = np.array([c.hw for c in cameras])
    stacked = np.full((len(cameras), *sizes.max(0)), 255, np.uint8)
    for v, picture in enumerate(labels):
        stacked[v, : picture.shape[0], : picture.shape[1]] = picture
    shown, denied = np.zeros((2, len(cells_m), len(cameras)), np.bool_)
    occupied = np.zeros(len(cells_m), np.bool_)
    _carve(cells_m, matrices, sizes, stacked, shown, denied, occupied)
    return shown, denied, occupied


def _ground_plan(occupied: np.ndarray, shape: tuple[int, int, int], voxel_m: float) -> tuple[np.ndarray, int]:
    """(N,) the number of the region of the ground plan that a cell stands in, 0 for none, and how many numbers there are."""
    plan = (occupied.reshape(shape).sum(2) * voxel_m >= _COLUMN_M).astype(np.uint8)
    count, regions = cv2.connectedComponents(plan, connectivity=8)
    return np.repeat(regions.reshape(-1), shape[2]), count


def is_person(part: Part, voxel_m: float, limits: HullLimits) -> bool:
    """Whether a part has the size of somebody who stands or sits on the floor, seen by enough cameras."""
    low, high = np.percentile(part.cells_m[:, 2], (1, 99))
    litres = 1000 * len(part.cells_m) * voxel_m**3
    area = len(np.unique(np.round(part.cells_m[:, :2] / voxel_m).astype(int), axis=0)) * voxel_m**2
    return bool(
        limits.height_m[0] <= high - low <= limits.height_m[1]
        and limits.volume_l[0] <= litres <= limits.volume_l[1]
        and area <= limits.footprint_m2
        and part.seen_by.sum() >= limits.cameras
    )


def tracks(found: Sequence[tuple[int, list[Part]]], fps: float, limits: HullLimits) -> list[Track]:
    """Parts of human size, followed through the frames; only those that last, in order of appearance."""
    open_tracks: list[list[tuple[int, Part]]] = []
    for frame, people in found:
        pairs = sorted(
            (float(np.linalg.norm(part.place_m - track[-1][1].place_m)), k, i)
            for k, track in enumerate(open_tracks)
            for i, part in enumerate(people)
        )
        used: set[int] = set()
        grown: set[int] = set()
        for distance_m, k, i in pairs:
            elapsed_s = (frame - open_tracks[k][-1][0]) / fps
            if k not in grown and i not in used and distance_m <= 0.2 + limits.speed_m_s * elapsed_s:
                open_tracks[k].append((frame, people[i]))
                grown.add(k)
                used.add(i)
        open_tracks += [[(frame, part)] for i, part in enumerate(people) if i not in used]
    lasting = [t for t in open_tracks if len(t) >= max(2, limits.share * len(found))]
    return [
        Track(
            np.array([frame for frame, _ in t]),
            np.array([part.place_m for _, part in t]),
            np.mean([part.seen_by for _, part in t], axis=0) > 0.5,
        )
        for t in lasting
    ]


def _middle(cameras: Sequence[Camera]) -> np.ndarray:
    """(2,) where the cameras' optical axes pass closest to each other; the cameras' own middle when they are parallel."""
    normal, side = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        normal += across
        side += across @ camera.centre_m
    if np.linalg.cond(normal) > 1e4:
        return np.mean([c.centre_m[:2] for c in cameras], axis=0)
    return np.linalg.solve(normal, side)[:2]


def _box(low: np.ndarray, high: np.ndarray, voxel_m: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    axes = [np.arange(a, b + 1e-9, voxel_m) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), tuple(len(a) for a in axes)


def _in_view(camera: Camera, points_m: np.ndarray) -> np.ndarray:
    pixels, depth_m = camera.project(points_m)
    with np.errstate(invalid="ignore"):
        return (depth_m > 0.1) & (pixels >= 0).all(-1) & (pixels < np.array(camera.wh)).all(-1)


@numba.njit(cache=True, nogil=True)
def _carve(cells, matrices, sizes, labels, shown, denied, occupied):
    """Fill ``shown``, ``denied`` (N, V): the camera shows somebody, or the room, at the cell, and ``occupied`` (N,)."""
    for n in range(cells.shape[0]):
        x, y, z = cells[n, 0], cells[n, 1], cells[n, 2]
        yes, no = 0, 0
        for v in range(matrices.shape[0]):
            m = matrices[v]
            depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            if depth <= 0.1:
                continue
            column = int(np.floor((m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth))
            row = int(np.floor((m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth))
            if column < 0 or row < 0 or column >= sizes[v, 1] or row >= sizes[v, 0]:
                continue
            label = labels[v, row, column]
            if label == BACKGROUND:
                denied[n, v] = True
                no += 1
                if no > 1:
                    break
            elif label == FOREGROUND:
                shown[n, v] = True
                yes += 1
        occupied[n] = (no == 0 and yes >= 2) or (no == 1 and yes >= 3)
