# SPDX-License-Identifier: Apache-2.0
"""Camera poses from tracks of people alone: a pair from its epipolar geometry, the others by resection.

The identities of tracks in different cameras are unknown. So every pair of tracks proposes a relative pose of its two
cameras, all other tracks vote on it, and the rig grows from the best pair, one camera at a time, with bundle adjustment
in between. Lengths are metres from the first pair on, because people's bones are about as long as the body model's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factors.keypoints import keypoint_factor
from studiorecon.estimate.solver import solve
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, Unknowns
from studiorecon.geometry.relative_pose import (
    essential_matrix,
    is_in_front,
    relative_pose,
    reprojection_distances,
    resection,
    sampson,
)
from studiorecon.geometry.scale import scene_scale
from studiorecon.geometry.triangulation import Limits, TriangulatedPoints, triangulate, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS, stable_detections
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

_BONES = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "hip"))
BONES = np.array([[STABLE_KEYPOINTS.index(f"{s}_{e}") for e in bone] for s in ("left", "right") for bone in _BONES])
# Pairs of tracks to try per pair of cameras; most pairs of cameras from which a rig is grown, and rigs of all cameras
# that suffice.
_TRIED_TRACKS = 9
_TRIED_SEEDS, _ENOUGH_WORLDS = 8, 2
MIN_SHARED = 60
# Share of a pair of tracks that must agree to be one person: wrong pairs reach 0.8 in one pair of cameras, but not
# together with the right pairs of all others.
_AGREE = 0.6
_LOOSE = 3.0
# Steps of an adjustment: people are grouped again, and adjusted once more, after it.
_ITERATIONS = 8
_UNSCALED_GATE = 0.1


@dataclass(frozen=True)
class Sightings:
    """Tracks of every camera on common frames: ``pixels``, per camera and person, of the stable keypoints, NaN if not
    confident."""

    detections: Sequence[Detections]
    frames: Integer[np.ndarray, " F"]
    pixels: tuple[tuple[Num[np.ndarray, "F 12 2"], ...], ...]


@dataclass(frozen=True)
class Rig:
    """Cameras in metres, in the axes of one of them, with their evidence.

    Attributes:
        cameras: view → camera; views that could not be placed are absent.
        seen: observations of the placed views, in ascending order of view.
        points: their triangulation.
        support: number of observations that agree.
    """

    cameras: Mapping[int, Camera]
    seen: Observations
    points: TriangulatedPoints
    support: int

    @property
    def agreeing(self) -> Bool[np.ndarray, " N"]:
        """Which points three cameras agree on (of two cameras: both)."""
        return self.points.verified if len(self.cameras) > 2 else self.points.valid


def dense_tracks(
    detections: Sequence[Detections], frames: Integer[np.ndarray, " F"], min_confidence: float
) -> Sightings:
    """Dense tracks of the detections in ``frames``."""
    stable = stable_detections(detections, frames)
    place = {int(f): i for i, f in enumerate(frames)}
    dense = []
    for d in stable:
        of_view = []
        for track in np.unique(d.track):
            which = np.flatnonzero(d.track == track)
            grid = np.full((len(frames), len(STABLE_KEYPOINTS), 2), np.nan)
            sure = d.keypoints[which, :, 2:] >= min_confidence
            grid[[place[int(f)] for f in d.frame[which]]] = np.where(sure, d.keypoints[which, :, :2], np.nan)
            of_view.append(grid)
        dense.append(tuple(of_view))
    return Sightings(detections, frames, tuple(dense))


def propose_rigs(
    seen: Sightings, cameras: Sequence[Camera], template_m: Num[np.ndarray, "12 3"], gate_m: float, limits: Limits
) -> list[Rig]:
    """The best rigs, most support first; of ``cameras`` only sizes and lenses are used.

    ``template_m``: stable keypoints of a body of mean shape.
    """
    unit = float(np.mean(unit_px(cameras, limits) / [np.mean(c.focal_px) for c in cameras]))
    seeds = [s for a, b in combinations(range(len(cameras)), 2) if (s := _pair(seen, cameras, a, b, unit)) is not None]
    seeds.sort(key=lambda s: (-s[0], s[1]))
    grown: list[Rig] = []
    for seed in seeds[:_TRIED_SEEDS]:
        # Two people of the same height may fit a pair of cameras better than one person does: such a rig does not grow.
        if sum(len(r.cameras) == len(cameras) for r in grown) >= _ENOUGH_WORLDS:
            break
        rig = _grow_rig(seen, cameras, seed, template_m, gate_m, limits)
        grown += [rig] if rig is not None else []
    return sorted(grown, key=lambda r: (-len(r.cameras), -r.support))


def _adjust_rig(rig: Rig, limits: Limits) -> tuple[list[Camera], Num[np.ndarray, "N 3"]]:
    """The rig's cameras (ascending view) with better poses, and its points, NaN where they did not determine them.

    Lenses are guesses yet, and only relative errors matter.
    """
    cameras, used = [rig.cameras[v] for v in sorted(rig.cameras)], rig.agreeing
    view, point = np.nonzero(rig.points.inliers[:, used])
    seen = rig.seen.of(used)
    sigma_px = unit_px(cameras, limits)[view] / np.sqrt(seen.confidence[view, point])
    start = Unknowns.of(cameras, np.zeros(len(cameras)), rig.points.points_m[used])
    aspect = np.array([c.focal_px[1] / c.focal_px[0] for c in cameras])
    free = np.ones(len(start.values), bool)
    numbers = free[: PER_CAMERA * len(cameras)].reshape(-1, PER_CAMERA)
    # The world is the first camera's.
    numbers[0], numbers[:, LOG_FOCAL:] = False, False
    factor = keypoint_factor(start, view, point, seen.pixels[view, point], sigma_px, aspect)
    found = solve(start, [factor], free, _ITERATIONS).unknowns
    points_m = np.full_like(rig.points.points_m, np.nan)
    points_m[used] = found.group("points", 3 * int(used.sum())).reshape(-1, 3)
    return [found.camera(c, v) for v, c in enumerate(cameras)], points_m


def bone_factor(
    points_m: Num[np.ndarray, "N 3"],
    rig_points: TriangulatedPoints,
    seen: Observations,
    template_m: Num[np.ndarray, "12 3"],
) -> float | None:
    """Factor on all lengths that makes people's bones (points, NaN unknown) as long as the template's.

    ``template_m`` are the stable keypoints of a body of mean shape. None when too few bones are seen.
    """
    people, person = np.unique(seen.group, return_inverse=True)
    times, time = np.unique(seen.frame, return_inverse=True)
    grid = np.full((len(people), len(times), len(STABLE_KEYPOINTS), 3), np.nan)
    sigma = np.zeros(grid.shape[:3])
    grid[person, time, seen.keypoint] = points_m
    sigma[person, time, seen.keypoint] = np.where(np.isfinite(rig_points.sigma_m), rig_points.sigma_m, 0.0) / np.sqrt(3)
    found = scene_scale(grid, np.repeat(template_m[None], len(people), axis=0), BONES, np.isfinite(grid).all(-1), sigma)
    return 1 / found.world_per_metre if found.determined else None


def scale_camera(camera: Camera, factor: float) -> Camera:
    """The camera in a world scaled by ``factor``."""
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= factor
    return replace(camera, camera_from_world=pose)


def _normalise_pixels(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    return (pixels - np.array(camera.principal_px)) / np.array(camera.focal_px)


def _pair(
    seen: Sightings, cameras: Sequence[Camera], a: int, b: int, unit: float
) -> tuple[int, int, int, np.ndarray] | None:
    """(votes, a, b, second_from_first (4, 4) with a unit baseline) of the best hypothesis on the tracks' identities."""
    first = [_normalise_pixels(p, cameras[a]).reshape(-1, 2) for p in seen.pixels[a]]
    second = [_normalise_pixels(p, cameras[b]).reshape(-1, 2) for p in seen.pixels[b]]
    shared = {}
    for i, one in enumerate(first):
        for j, two in enumerate(second):
            both = np.isfinite(one).all(-1) & np.isfinite(two).all(-1)
            if both.sum() >= MIN_SHARED:
                shared[i, j] = both
    best = None
    for i, j in sorted(shared, key=lambda ij: (-int(shared[ij].sum()), ij))[:_TRIED_TRACKS]:
        found = relative_pose(first[i][shared[i, j]], second[j][shared[i, j]], unit)
        if found is None:
            continue
        matched, votes = _vote_tracks(first, second, shared, found[0], found[1], unit)
        if best is None or votes > best[0]:
            best = votes, matched, found
    if best is None or not best[1]:
        return None
    _, matched, found = best
    one = np.concatenate([first[i][shared[i, j]] for i, j in matched])
    two = np.concatenate([second[j][shared[i, j]] for i, j in matched])
    again = relative_pose(one, two, unit)
    rotation, translation, _ = again if again is not None and again[2].sum() >= best[0] else found
    second_from_first = np.eye(4)
    second_from_first[:3, :3], second_from_first[:3, 3] = rotation, translation
    return _vote_tracks(first, second, shared, rotation, translation, unit)[1], a, b, second_from_first


def _vote_tracks(
    first: Sequence[np.ndarray],
    second: Sequence[np.ndarray],
    shared: Mapping[tuple[int, int], np.ndarray],
    rotation: np.ndarray,
    translation: np.ndarray,
    unit: float,
) -> tuple[list[tuple[int, int]], int]:
    """Which tracks of two cameras are one person under a relative pose, and how many points agree; each track once at a
    time."""
    essential, votes = essential_matrix(rotation, translation), {}
    for (i, j), both in shared.items():
        one, two = first[i][both], second[j][both]
        agreed = int(
            ((np.abs(sampson(essential, one, two)) < unit) & is_in_front(rotation, translation, one, two)).sum()
        )
        if agreed >= _AGREE * both.sum():
            votes[i, j] = agreed
    matched: list[tuple[int, int]] = []
    taken: dict[tuple[str, int], np.ndarray] = {}
    for i, j in sorted(votes, key=lambda ij: (-votes[ij], ij)):
        both = shared[i, j]
        if not any((taken[key] & both).any() for key in (("a", i), ("b", j)) if key in taken):
            matched.append((i, j))
            for key in (("a", i), ("b", j)):
                taken[key] = taken.get(key, np.zeros_like(both)) | both
    return matched, sum(votes[ij] for ij in matched)


def _grow_rig(
    seen: Sightings,
    cameras: Sequence[Camera],
    seed: tuple[int, int, int, np.ndarray],
    template_m: np.ndarray,
    gate_m: float,
    limits: Limits,
) -> Rig | None:
    _, a, b, second_from_first = seed
    placed = {
        a: replace(cameras[a], camera_from_world=np.eye(4)),
        b: replace(cameras[b], camera_from_world=second_from_first),
    }
    rig = _refined_rig(seen, placed, template_m, gate_m, limits, first_pair=True)
    while rig is not None:
        candidates = [
            (v, found)
            for v in range(len(cameras))
            if v not in rig.cameras and (found := _place_camera(seen, cameras[v], v, rig, limits))
        ]
        if not candidates:
            return rig
        view, (_, pose) = max(candidates, key=lambda c: (c[1][0], -c[0]))
        rig = _refined_rig(
            seen, {**rig.cameras, view: replace(cameras[view], camera_from_world=pose)}, template_m, gate_m, limits
        )
    return None


def _refined_rig(
    seen: Sightings,
    placed: Mapping[int, Camera],
    template_m: Num[np.ndarray, "12 3"],
    gate_m: float,
    limits: Limits,
    first_pair: bool = False,
) -> Rig | None:
    """The rig after two rounds of grouping, triangulation and adjustment; people's bones give a first pair its scale.

    Before its scale is known (``first_pair``), the gate is a tenth of the pair's baseline.
    """
    views = sorted(placed)
    current = dict(placed)
    loose = replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    rig = None
    for round_number in range(3):
        cameras = [current[v] for v in views]
        gate = _UNSCALED_GATE if first_pair and round_number == 0 else gate_m
        found, _ = make_observations([seen.detections[v] for v in views], cameras, seen.frames, gate)
        if not len(found.frame):
            return None
        points = triangulate(found.pixels, found.confidence, cameras, loose if round_number < 2 else limits)
        counted = points.verified if len(views) > 2 else points.valid
        if counted.sum() < MIN_SHARED:
            return None
        rig = Rig(dict(current), found, points, int(points.inliers[:, counted].sum()))
        if round_number == 2:
            break
        better, points_m = _adjust_rig(rig, limits)
        factor = bone_factor(points_m, points, found, template_m)
        if factor is None:
            return None
        current = {v: scale_camera(c, factor) for v, c in zip(views, better)}
    return rig


def _place_camera(
    seen: Sightings, camera: Camera, view: int, rig: Rig, limits: Limits
) -> tuple[int, np.ndarray] | None:
    """(points that agree, camera_from_world) of a further camera from the best match of its tracks to groups."""
    found = rig.points
    place = {int(f): i for i, f in enumerate(seen.frames)}
    unit = float(limits.huber_share * max(camera.wh) / np.mean(camera.focal_px)) * 2
    row = np.array([place[int(f)] for f in rig.seen.frame])
    tracks = [_normalise_pixels(p, camera) for p in seen.pixels[view]]
    pairs = {}
    for g in np.unique(rig.seen.group):
        which = np.flatnonzero((rig.seen.group == g) & found.valid)
        for k, track in enumerate(tracks):
            pixels = track[row[which], rig.seen.keypoint[which]]
            present = np.isfinite(pixels).all(-1)
            if present.sum() >= MIN_SHARED:
                pairs[int(g), k] = found.points_m[which][present], pixels[present]
    best: tuple[int, np.ndarray] | None = None
    for key in sorted(pairs, key=lambda gk: (-len(pairs[gk][0]), gk))[:_TRIED_TRACKS]:
        answer = resection(*pairs[key], unit)
        if answer is None:
            continue
        votes, chosen = _count_agreeing(pairs, answer[0], unit)
        again = (
            resection(
                np.concatenate([pairs[k][0] for k in chosen]), np.concatenate([pairs[k][1] for k in chosen]), unit
            )
            if chosen
            else None
        )
        pose = again[0] if again is not None else answer[0]
        votes = _count_agreeing(pairs, pose, unit)[0]
        if votes and (best is None or votes > best[0]):
            best = votes, pose
    return best


def _count_agreeing(
    pairs: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]], pose: np.ndarray, unit: float
) -> tuple[int, list[tuple[int, int]]]:
    """Number of points that agree with a pose, every track with one group at most, and those pairs."""
    votes = {}
    for key, (points, pixels) in pairs.items():
        agreed = int((reprojection_distances(pose, points, pixels) < unit).sum())
        if agreed >= _AGREE * len(points):
            votes[key] = agreed
    chosen: list[tuple[int, int]] = []
    for key in sorted(votes, key=lambda k: (-votes[k], k)):
        if all(key[1] != other[1] for other in chosen):
            chosen.append(key)
    return sum(votes[k] for k in chosen), chosen
