# SPDX-License-Identifier: Apache-2.0
"""Groups tracks of different cameras that show the same person, by the distance of their rays; needs no appearance.

A node is one track of one camera. The distance of two tracks of different cameras is the median, over frames and shared
keypoints, of the closest distance between their rays. A single pair proves little: two people of the same height may
fit by chance, and one keypoint may be anywhere along an epipolar line. So groups are chosen whole, by the sum of their
affinities over all views: four agreeing views count six pairs, a chance pair one (A10, A15).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.groups import groups_by_affinity
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

# Joints that a detector localises within centimetres from every side; faces are seen from the front only.
STABLE_KEYPOINTS = tuple(
    f"{s}_{j}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in ("left", "right")
)
SHOULDERS, ANKLES = ([STABLE_KEYPOINTS.index(f"{s}_{j}") for s in ("left", "right")] for j in ("shoulder", "ankle"))
_NEAR_M = 0.1
_MIN_SHARED = 4


@dataclass(frozen=True)
class TrackGraph:
    """M tracks and their pairwise distances.

    Attributes:
        view, track: index of the camera, and track id in it.
        distance_m: symmetric, NaN where the two share too little (also within one camera).
        moments: number of frames in which both are seen; on the diagonal, in which the track is.
    """

    view: Num[np.ndarray, " M"]
    track: Num[np.ndarray, " M"]
    distance_m: Num[np.ndarray, "M M"]
    moments: Integer[np.ndarray, "M M"]


def stable_indices(layout: str, wanted: Sequence[str] = STABLE_KEYPOINTS) -> list[int]:
    """Indices of the ``wanted`` keypoints in a layout; -1 for missing ones. Raises KeyError for an unknown layout.

    A body's joints replace missing detector points: their difference (M07) is the same in all cameras.
    """
    names = LAYOUTS[layout].keypoints
    at = {name: index for index, name in enumerate(names)}
    return [at.get(k, at.get(f"{k}_joint", -1)) for k in wanted]


def stable_detections(
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"] | None = None,
    wanted: Sequence[str] = STABLE_KEYPOINTS,
) -> list[Detections]:
    """The detections (of ``frames``, if given) with the ``wanted`` keypoints only, in this order for every layout."""
    chosen = []
    for d in detections:
        which = np.ones(len(d.frame), dtype=bool) if frames is None else np.isin(d.frame, frames)
        padded = np.concatenate([d.keypoints[which], np.full((int(which.sum()), 1, 3), [np.nan, np.nan, 0.0])], axis=1)
        chosen.append(
            Detections(d.camera, d.layout, d.frame[which], d.track[which], padded[:, stable_indices(d.layout, wanted)])
        )
    return chosen


def ray_distances(
    first_origin: Num[np.ndarray, " 3"],
    first: Num[np.ndarray, "... 3"],
    second_origin: Num[np.ndarray, " 3"],
    second: Num[np.ndarray, "... 3"],
    near_m: float = _NEAR_M,
) -> Num[np.ndarray, " ..."]:
    """Closest distance in metres between rays with unit directions; inf where they meet behind an origin (T06).

    Raises ValueError for other shapes. A direction that is not finite gives inf.
    """
    require("first", first, (..., 3))
    require("second", second, (..., 3))
    require("first_origin", first_origin, (3,))
    require("second_origin", second_origin, (3,))
    baseline = second_origin - first_origin
    cosine = (first * second).sum(-1)
    sine_squared = np.maximum(1 - cosine**2, 1e-12)
    along_first, along_second = first @ baseline, second @ baseline
    range_first = (along_first - cosine * along_second) / sine_squared
    range_second = (cosine * along_first - along_second) / sine_squared
    gap = first_origin + range_first[..., None] * first - second_origin - range_second[..., None] * second
    return np.where((range_first > near_m) & (range_second > near_m), np.linalg.norm(gap, axis=-1), np.inf)


def track_graph(detections: Sequence[Detections], cameras: Sequence[Camera]) -> TrackGraph:
    """The graph of all tracks of detections with one order of keypoints; a pair shares four of them in a frame."""
    nodes = [(v, int(t)) for v, d in enumerate(detections) for t in np.unique(d.track)]
    node_of = {node: i for i, node in enumerate(nodes)}
    count = len(nodes)
    distance, moments = np.full((count, count), np.nan), np.zeros((count, count), dtype=int)
    rays = [ray_directions(d.keypoints, c) for d, c in zip(detections, cameras)]
    for a in range(len(cameras)):
        for b in range(a, len(cameras)):
            first, second = _same_frame(detections[a].frame, detections[b].frame)
            rows = np.array([node_of[a, int(t)] for t in detections[a].track[first]], dtype=int)
            columns = np.array([node_of[b, int(t)] for t in detections[b].track[second]], dtype=int)
            np.add.at(moments, (rows, columns), 1)
            if a != b:
                np.add.at(moments, (columns, rows), 1)
            if a == b or not len(rows):
                continue
            apart = ray_distances(cameras[a].centre_m, rays[a][0][first], cameras[b].centre_m, rays[b][0][second])
            shared = rays[a][1][first] & rays[b][1][second]
            per_pair = median_over_shared(apart, shared, _MIN_SHARED)
            for row, column in sorted(set(zip(rows.tolist(), columns.tolist()))):
                seen = per_pair[(rows == row) & (columns == column)]
                seen = seen[~np.isnan(seen)]
                if len(seen):
                    distance[row, column] = distance[column, row] = np.median(seen)
    return TrackGraph(
        np.array([v for v, _ in nodes], dtype=int), np.array([t for _, t in nodes], dtype=int), distance, moments
    )


def track_groups(
    distance_m: Num[np.ndarray, "M M"], view: Num[np.ndarray, " M"], moments: Num[np.ndarray, "M M"], gate_m: float
) -> list[list[int]]:
    """Groups of nodes, best first, chosen greedily by the largest summed affinity 1 - d / gate.

    An affinity counts in proportion to the frames in which both are seen (``moments``), so that false detections in
    single frames do not outvote a person who is always present. The gate comes before the choice (A03): a group holds
    no two nodes further apart than it and no two of one camera that are seen together, and every member has a measured
    neighbour. A permutation of the nodes permutes the groups up to ties, which go to the lower node. Raises ValueError
    for other shapes.
    """
    sizes = require("distance_m", distance_m, ("M", "M"))
    require("view", view, ("M",), sizes)
    require("moments", moments, ("M", "M"), sizes)
    finite = np.isfinite(distance_m)
    affinity = np.where(
        finite & (np.nan_to_num(distance_m, nan=np.inf) < gate_m),
        1 - np.nan_to_num(distance_m, posinf=0.0) / gate_m,
        0.0,
    )
    forbidden = (finite | np.isinf(distance_m)) & ~(np.nan_to_num(distance_m, nan=0.0) < gate_m)
    forbidden |= (view[:, None] == view[None]) & (moments > 0)
    return groups_by_affinity(affinity * moments, forbidden)


def group_affinity(group: Sequence[int], distance_m: Num[np.ndarray, "M M"], gate_m: float) -> float:
    """Mean of 1 - d / gate over the measured pairs of a group, 0 when there is none."""
    block = distance_m[np.ix_(group, group)][np.triu_indices(len(group), 1)]
    block = block[np.isfinite(block)]
    return float(np.clip(1 - block / gate_m, 0, 1).mean()) if len(block) else 0.0


def ray_directions(
    keypoints: Num[np.ndarray, "D K 3"], camera: Camera
) -> tuple[Num[np.ndarray, "D K 3"], Bool[np.ndarray, "D K"]]:
    """Unit world directions of keypoints, and which are present. Raises ValueError for another shape."""
    require("keypoints", keypoints, ("D", "K", 3))
    present = (keypoints[..., 2] > 0) & np.isfinite(keypoints[..., :2]).all(-1)
    pixels = np.where(present[..., None], keypoints[..., :2], 0.0)
    directions = camera.unproject(pixels, np.ones(pixels.shape[:-1])) - camera.centre_m
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True), present


def _same_frame(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs (i, j) with first[i] == second[j]."""
    i, j = np.nonzero(first[:, None] == second[None])
    return i, j


def median_over_shared(
    values: Num[np.ndarray, "P K"], present: Bool[np.ndarray, "P K"], least: int
) -> Num[np.ndarray, " P"]:
    """Median over the values that are ``present``, NaN with fewer than ``least``; inf counts as large.

    Raises ValueError if the shapes differ.
    """
    require("present", present, ("P", "K"), require("values", values, ("P", "K")))
    count = present.sum(-1)
    ordered = np.sort(np.where(present, values, np.inf), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[:, None], axis=-1)[:, 0]
    return np.where(count >= max(least, 1), middle, np.nan)
