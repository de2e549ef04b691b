# SPDX-License-Identifier: Apache-2.0
"""Who stands where: the space that no camera sees through (the visual hull), its parts of human size, and how they
move.

A point is inside the hull when at least two cameras show somebody there and no camera that sees it shows the room, or
one does against three: clothes of the wall's colour leave holes in a silhouette. Parts are told apart on the ground
plan, since people stand beside each other, not on each other: around its tops, because hulls of people near each other
touch, and lines of sight that cross leave arms of nobody between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np
import scipy

from studiorecon.people.silhouettes import MIN_CAMERAS
from studiorecon.people.silhouettes.foreground import BACKGROUND, FOREGROUND
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# How far around the middle of the cameras' views people are looked for, how high, and how deep the floor may lie;
# metres.
_REACH_M, _TOP_M, _BELOW_M = 6.0, 2.4, 0.3
# A column of less than this is no part of a person's ground plan: shadows, cables, the edge of a mat.
_COLUMN_M = 0.4
# Two people's tops on the ground plan lie this far apart at least; a top is this share of the plan's highest near it,
# over a plan blurred by so much; metres. Between two tops the plan falls to less than this share of the lower one.
_TOPS_APART_M, _TOP_SHARE, _TOP_BLUR_M, _SADDLE_SHARE = 0.45, 0.5, 0.1, 0.85
# What stands within this of where most stands above each other says where a person is; metres.
_TRUNK_M = 0.3

# A part's middle jumps by this without anybody moving; a way is told from the last so many seconds; metres that a
# second unseen counts, and that having been seen only once does.
_JITTER_M, _HEADING_S, _UNSEEN_M_S, _ONCE_M, _NEVER_M = 0.2, 0.5, 0.5, 0.3, 1e3


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

    voxel_m: float = 0.05
    step_s: float = 0.1
    height_m: tuple[float, float] = (1.0, 2.3)
    volume_l: tuple[float, float] = (25.0, 700.0)
    footprint_m2: float = 1.5
    cameras: int = MIN_CAMERAS
    share: float = 0.6
    speed_m_s: float = 3.0
    apart_m: float = 0.35


@dataclass(frozen=True)
class HullPart:
    """One part of the hull at one frame: where it stands (2,), cells (N, 3), cameras (V,) that show it or deny a cell
    (N, V)."""

    place_m: Float[np.ndarray, " 2"]
    cells_m: Float[np.ndarray, "N 3"]
    seen_by: Bool[np.ndarray, " V"]
    denied: Bool[np.ndarray, "N V"]


@dataclass(frozen=True)
class HullTrack:
    """One part of the hull over time: ``frames`` (F,), ``places_m`` (F, 2), cameras ``seen_by`` (V,) in most of
    them."""

    frames: Integer[np.ndarray, " F"]
    places_m: Float[np.ndarray, "F 2"]
    seen_by: Bool[np.ndarray, " V"]


def watched_cells(
    cameras: Sequence[Camera], voxel_m: float, least: int
) -> tuple[Float[np.ndarray, "N 3"], tuple[int, int, int]]:
    """(N, 3) centres of the cells of a box around all that ``least`` cameras see, and the box's cells along x, y, z."""
    centre = _middle(cameras)
    coarse = _box(np.append(centre - _REACH_M, -_BELOW_M), np.append(centre + _REACH_M, _TOP_M), 0.2)[0]
    inside = np.asarray(sum(_in_view(c, coarse) for c in cameras) >= least)
    if not inside.any():
        return np.zeros((0, 3)), (0, 0, 0)
    low, high = coarse[inside].min(0), coarse[inside].max(0)
    return _box(low, high, voxel_m)


def cells_around(
    place_m: Float[np.ndarray, " 2"], voxel_m: float, radius_m: float = 1.1
) -> tuple[Float[np.ndarray, "N 3"], tuple[int, int, int]]:
    """(N, 3) centres of the cells of a box around a person who stands at ``place_m`` (2,)."""
    return _box(np.append(place_m - radius_m, -_BELOW_M), np.append(place_m + radius_m, _TOP_M), voxel_m)


def parts(
    cells_m: Float[np.ndarray, "N 3"],
    shape: tuple[int, int, int],
    cameras: Sequence[Camera],
    labels: Sequence[Integer[np.ndarray, "H W"]],
    voxel_m: float,
) -> list[HullPart]:
    """Parts of the hull of one frame, largest first; ``labels`` are the cameras' pictures (H, W) of
    ``foreground.labels``."""
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
    cells_m: Float[np.ndarray, "N 3"],
    shape: tuple[int, int, int],
    cameras: Sequence[Camera],
    labels: Sequence[Integer[np.ndarray, "H W"]],
    voxel_m: float,
    place_m: Float[np.ndarray, " 2"],
    radius_m: float,
) -> HullPart | None:
    """Everything connected to the parts within ``radius_m`` of ``place_m`` (2,), arms included; None when nothing
    stands there."""
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


def _part(cells_m: np.ndarray, shown: np.ndarray, denied: np.ndarray, chosen: np.ndarray) -> HullPart:
    own_m = cells_m[chosen]
    # Where most stands above each other, not in the middle: lines of sight that cross leave long arms.
    columns, count = np.unique(own_m[:, :2], axis=0, return_counts=True)
    crowd = np.array([count[np.linalg.norm(columns - c, axis=1) < 2 * _TOP_BLUR_M].sum() for c in columns])
    near = np.linalg.norm(own_m[:, :2] - columns[crowd.argmax()], axis=1) < _TRUNK_M
    return HullPart(np.median(own_m[near, :2], axis=0), own_m, shown[chosen].mean(0) > 0.3, denied[chosen])


def _carved(
    cells_m: np.ndarray, cameras: Sequence[Camera], labels: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    """(N,) the number of the region of the ground plan that a cell stands in, 0 for none, and how many numbers there
    are."""
    height_m = occupied.reshape(shape).sum(2) * voxel_m
    regions = _around_tops(height_m, voxel_m)
    return np.repeat(regions.reshape(-1), shape[2]), int(regions.max(initial=0)) + 1


def _around_tops(height_m: np.ndarray, voxel_m: float) -> np.ndarray:
    """(X, Y) regions from 1 on of the columns of ``height_m`` (X, Y): connected ones, and of those each around its own
    top."""
    plan = (height_m >= _COLUMN_M).astype(np.uint8)
    connected = cv2.connectedComponents(plan, connectivity=8)[1]
    smooth = scipy.ndimage.gaussian_filter(height_m * plan, _TOP_BLUR_M / voxel_m)
    reach = round(_TOPS_APART_M / voxel_m)
    highest = scipy.ndimage.maximum_filter(
        smooth, footprint=cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    )
    regions, count = np.zeros(plan.shape, np.int64), 0
    for k in range(1, connected.max(initial=0) + 1):
        here = connected == k
        tops = np.argwhere(here & (smooth == highest) & (smooth >= _TOP_SHARE * smooth[here].max()))
        tops = _with_saddles(tops, smooth)
        apart = (
            np.linalg.norm(np.argwhere(here)[:, None] - tops[None], axis=-1)
            if len(tops) > 1
            else np.zeros((int(here.sum()), 1))
        )
        regions[here] = count + 1 + apart.argmin(axis=1)
        count += max(1, len(tops))
    return regions


def _with_saddles(tops: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Those of ``tops`` (N, 2), highest first, between which and every higher one the plan falls: a ridge has one
    top."""
    kept: list[np.ndarray] = []
    for top in sorted(tops, key=lambda p: -smooth[tuple(p)]):
        between = [np.linspace(top, other, 20).round().astype(int) for other in kept]
        if all(smooth[tuple(line.T)].min() < _SADDLE_SHARE * smooth[tuple(top)] for line in between):
            kept.append(top)
    return np.array(kept)


def is_person(part: HullPart, voxel_m: float, limits: HullLimits) -> bool:
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


def tracks(found: Sequence[tuple[int, list[HullPart]]], fps: float, limits: HullLimits) -> list[HullTrack]:
    """Parts of human size, followed through the frames; only those that last, in order of appearance."""
    open_tracks: list[list[tuple[int, HullPart]]] = []
    for frame, people in found:
        used: set[int] = set()
        if open_tracks and people:
            # Everybody at once, from where they were going: two who pass each other do not take each other's place.
            cost_m = np.array([[_off_m(track, frame, part, fps, limits) for part in people] for track in open_tracks])
            for k, i in zip(*scipy.optimize.linear_sum_assignment(np.where(np.isfinite(cost_m), cost_m, _NEVER_M))):
                if np.isfinite(cost_m[k, i]):
                    open_tracks[k].append((frame, people[i]))
                    used.add(int(i))
        open_tracks += [[(frame, part)] for i, part in enumerate(people) if i not in used]
    lasting = [t for t in open_tracks if len(t) >= max(2, limits.share * len(found))]
    return [
        HullTrack(
            np.array([frame for frame, _ in t]),
            np.array([part.place_m for _, part in t]),
            np.mean([part.seen_by for _, part in t], axis=0) > 0.5,
        )
        for t in lasting
    ]


def _off_m(track: Sequence[tuple[int, HullPart]], frame: int, part: HullPart, fps: float, limits: HullLimits) -> float:
    """How far a part is from where a track was going, metres; inf where nobody gets to from where it was."""
    last, place_m = track[-1][0], track[-1][1].place_m
    elapsed_s = (frame - last) / fps
    if np.linalg.norm(part.place_m - place_m) > _JITTER_M + limits.speed_m_s * elapsed_s:
        return np.inf
    recent = [(t, p.place_m) for t, p in track if (last - t) / fps <= _HEADING_S]
    if len(recent) > 2 and elapsed_s <= _HEADING_S:
        times, places_m = np.array([t for t, _ in recent]) / fps, np.array([p for _, p in recent])
        slope, level = np.polyfit(times - last / fps, places_m, 1)
        place_m = level + slope * elapsed_s
    # Somebody seen just now goes on before somebody long unseen comes back, and before what was seen once and may be
    # nobody.
    return float(np.linalg.norm(part.place_m - place_m) + _UNSEEN_M_S * elapsed_s + _ONCE_M / len(track))


def _middle(cameras: Sequence[Camera]) -> np.ndarray:
    """(2,) where the cameras' optical axes pass closest to each other; the cameras' own middle when they are
    parallel."""
    normal, side = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        normal += across
        side += across @ camera.centre_m
    if np.linalg.cond(normal) > 1e4:
        return np.mean([c.centre_m[:2] for c in cameras], axis=0)
    return np.linalg.solve(normal, side)[:2]


def _box(low: np.ndarray, high: np.ndarray, voxel_m: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    x, y, z = (np.arange(a, b + 1e-9, voxel_m) for a, b in zip(low, high))
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3), (len(x), len(y), len(z))


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
