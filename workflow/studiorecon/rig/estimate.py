# SPDX-License-Identifier: Apache-2.0
"""Poses and lenses of cameras from the people they see, as one estimate (``studiorecon.estimate``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtri

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.factors.bones import bone_factors
from studiorecon.estimate.factors.edges import room_edges
from studiorecon.estimate.factors.feet import feet_on_floor
from studiorecon.estimate.factors.keypoints import keypoint_factor, viewing_sides
from studiorecon.estimate.factors.lenses import known_lenses, similar_lenses, similarity_gain
from studiorecon.estimate.factors.poses import ANKLE_HEIGHT_M, known_poses
from studiorecon.estimate.solver import Solution, solve
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, PRINCIPAL, RADIAL, Unknowns
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import ANKLES, SHOULDERS, STABLE_KEYPOINTS
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.detector_noise import DetectorNoise, measure_detector_noise, shared_cells
from studiorecon.rig.floor_marks import FloorMarks
from studiorecon.rig.from_tracks import BONES, MIN_SHARED, Rig, Sightings
from studiorecon.rig.lens_knowledge import LensKnowledge, distort_points, undistort_points, undistort_tracks
from studiorecon.rig.room_turns import RoomTurn
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Rounds of grouping people and estimating; the search ends when focal lengths change by less than this share.
_ROUNDS, _SETTLED_SHARE = 8, 0.001
# Multiples of the limits' outlier units: at first, while lenses are guessed, and then. The factors' tails do the rest.
_LOOSE, _NARROW = 3.0, 1.5
# Probability with which the room may raise people's cost as much as it does.
_LEVEL = 0.99
# Patches of the floor overlap and are matched from several cameras: one counts as a third.
_MARK_WEIGHT = 0.3
# An edge that is this far from all of the room's directions, degrees, runs along none of them.
_ALONG_DEG = 2.0
_MARKS_MEET = Limits(min_confidence=0.1, huber_share=0.01, outlier_units=5.0)
# Bodies in one cell of this size, seen from one side, are in the same posture.
_CELL_M = 0.3
# Half the bones of ``BONES`` are left, half right, and a person's are equally long.
_KINDS = len(BONES) // 2


@dataclass(frozen=True)
class RoomEvidence:
    """Evidence of the empty room: views' ``turns`` by its straight ``edges`` (view → (N, 4) ends), and ``marks`` on its
    floor, both in distorted pixels."""

    turns: Mapping[int, RoomTurn] = field(default_factory=dict)
    edges: Mapping[int, Num[np.ndarray, "N 4"]] = field(default_factory=dict)
    marks: FloorMarks | None = None


_NO_ROOM = RoomEvidence()


@dataclass(frozen=True)
class RigEstimate:
    """The estimate of a rig.

    Attributes:
        cameras: pinholes; ``radial``: (V,) k1.
        rig: the people by which they were estimated, without distortion.
        points_m: (N, 3) the rig's points, NaN where they were not used.
        solution: of the solver.
        noise: of the keypoints.
        people_cost: twice the negative log posterior without the room.
        room: the evidence that was used; ``knowledge``: the prior.
    """

    cameras: list[Camera]
    radial: Num[np.ndarray, " V"]
    rig: Rig
    points_m: Num[np.ndarray, "N 3"]
    solution: Solution
    noise: DetectorNoise
    people_cost: float
    room: RoomEvidence
    knowledge: LensKnowledge

    @property
    def room_directions(self) -> Num[np.ndarray, "3 3"] | None:
        """The three directions of the room's edges as columns, on average over the cameras; None without any."""
        if not self.room.turns:
            return None
        each = [
            self.cameras[v].camera_from_world[:3, :3].T @ turn.rotation_camera_from_room
            for v, turn in self.room.turns.items()
        ]
        left, _, right = np.linalg.svd(np.sum(each, axis=0))
        return left @ right


def estimate_rig(
    cameras: Sequence[Camera],
    radial: Num[np.ndarray, " V"],
    seen: Sightings,
    knowledge: LensKnowledge,
    template_m: Num[np.ndarray, "12 3"],
    gate_m: float,
    limits: Limits,
) -> RigEstimate | None:
    """The cameras and lenses of maximum posterior probability; None where people show too little.

    It starts at ``cameras`` and groups people again between rounds.
    """
    found, noise = None, DetectorNoise.typical(cameras, limits)
    # Lenses differ at first: from equal ones, a lens of another make would not be released.
    alone = replace(knowledge, makes=tuple(range(len(cameras))))
    current, k1, lenses = list(cameras), np.asarray(radial, float), alone
    for number in range(_ROUNDS):
        outliers = limits.outlier_units * (_LOOSE if number == 0 else _NARROW)
        rig = _group_people(current, k1, seen, gate_m, replace(limits, outlier_units=outliers))
        if rig is None:
            return found
        before, found, measured = found, estimate_once(rig, k1, lenses, template_m, noise), noise
        current, k1, noise = found.cameras, found.radial, found.noise
        if number == 0:
            lenses = knowledge
        elif before is not None:
            change = [np.log(a.focal_px[0] / b.focal_px[0]) for a, b in zip(found.cameras, before.cameras)]
            if np.abs(change).max() >= _SETTLED_SHARE:
                continue
            if lenses is alone:
                break
            settled = replace(rig, cameras=dict(enumerate(current)))
            free = estimate_once(settled, k1, alone, template_m, measured, start_m=found.points_m)
            if found.solution.cost - free.solution.cost <= similarity_gain(knowledge.makes, knowledge.sigma):
                break
            # The pictures' sizes are equal, not the lenses.
            current, k1, lenses, found = free.cameras, free.radial, alone, free
    return found


def add_room_evidence(
    found: RigEstimate, template_m: Num[np.ndarray, "12 3"], room: RoomEvidence
) -> tuple[RigEstimate, bool]:
    """The estimate from people and the room, and whether people agree with it.

    They disagree where their cost rises above the 99 % quantile of a chi-square distribution with the cameras' degrees
    of freedom.
    """
    cameras = dict(enumerate(found.cameras))
    rig = replace(found.rig, cameras=cameras)
    after = estimate_once(rig, found.radial, found.knowledge, template_m, found.noise, room, found.points_m)
    numbers = int(found.solution.free[: PER_CAMERA * len(cameras)].sum())
    return after, bool(after.people_cost - found.people_cost <= chdtri(numbers, 1 - _LEVEL))


def _group_people(
    cameras: Sequence[Camera], radial: np.ndarray, seen: Sightings, gate_m: float, limits: Limits
) -> Rig | None:
    """People as ``cameras`` see them without distortion; None where they are too few."""
    straight = undistort_tracks(seen.detections, cameras, radial)
    observed, _ = make_observations(straight, cameras, seen.frames, gate_m)
    if not len(observed.frame):
        return None
    points = triangulate(observed.pixels, observed.confidence, cameras, limits)
    rig = Rig(dict(enumerate(cameras)), observed, points, 0)
    counted = rig.agreeing
    if counted.sum() < MIN_SHARED:
        return None
    return replace(rig, support=int(points.inliers[:, counted].sum()))


def estimate_once(
    rig: Rig,
    radial: Num[np.ndarray, " V"],
    knowledge: LensKnowledge,
    template_m: Num[np.ndarray, "12 3"],
    noise: DetectorNoise,
    room: RoomEvidence = _NO_ROOM,
    start_m: Num[np.ndarray, "N 3"] | None = None,
) -> RigEstimate:
    """The estimate from the people in ``rig``, starting at its cameras with ``radial`` terms.

    ``template_m``: (12, 3) stable keypoints of a mean adult; ``noise`` of the keypoints; ``start_m``: the
    first points, by default those triangulated by the rig's cameras.
    """
    cameras, used = [rig.cameras[v] for v in sorted(rig.cameras)], rig.agreeing
    points_m = (rig.points.points_m if start_m is None else start_m)[used]
    seen = rig.seen.of(used)
    people, person = np.unique(seen.group, return_inverse=True)
    place = _places(seen, person)
    template = np.linalg.norm(template_m[BONES[:_KINDS, 0]] - template_m[BONES[:_KINDS, 1]], axis=-1)
    usual_m = np.tile(template, len(people))
    first, second, kind = _bones(place)
    repeats = _count_repeats(seen, points_m, person, place, cameras[0])
    calibrated = knowledge.pose_sigma is not None
    lower, axes, floor = _lower_ankles(place, points_m)
    if calibrated:
        axes, floor = np.eye(3), np.array([0.0, 0.0, ANKLE_HEIGHT_M])
    marks, on_floor = _marks(room.marks, cameras, radial)
    every_m = np.concatenate([points_m, on_floor])
    start = Unknowns.of(cameras, radial, every_m, bones=np.log(usual_m), floor=floor, room=np.zeros(3))
    view, point = np.nonzero(rig.points.inliers[:, used])
    pixels = distort_points(seen.pixels[view, point], cameras, radial, view)
    cell, px_per_m = shared_cells(seen, points_m, cameras, place, view, point)
    count = np.bincount(cell)
    # Unknown lenses show where people seldom are, so a short cell weighs as a long one. Poses of known lenses are
    # better by the mean of all frames: off by 0.06 instead of 0.14 degrees where errors are new in every frame.
    sharing = (count**2).sum() / count.sum() if calibrated else count[cell]
    shared_px = noise.shared_m * px_per_m * np.sqrt(sharing)
    sigma_px = np.hypot(noise.frame_px[view], shared_px) / np.sqrt(np.maximum(seen.confidence[view, point], 0.1))
    aspect = np.array([c.focal_px[1] / c.focal_px[0] for c in cameras])
    of_people = keypoint_factor(start, view, point, pixels, sigma_px, aspect)
    factors: list[Factor] = [
        of_people,
        # Lengths of a calibration are metres, whatever people's size.
        *bone_factors(start, first, second, kind, repeats[first], usual_m)[: 1 if calibrated else 2],
        *([feet_on_floor(start, lower, axes, repeats[lower])] if len(lower) else []),
        known_lenses(start, knowledge.expected, knowledge.sigma),
        *similar_lenses(start, knowledge.makes),
    ]
    if knowledge.pose_sigma is not None:
        rotations = np.stack([c.camera_from_world[:3, :3] for c in knowledge.given])
        centres_m = np.stack([c.centre_m for c in knowledge.given])
        factors += known_poses(start, rotations, centres_m, knowledge.pose_sigma)
    of_room: list[Factor] = []
    if room.turns:
        of_room.append(room_edges(start, *_edges(room, cameras, radial), aspect))
    if marks is not None:
        views, which = np.nonzero(np.isfinite(marks.pixels).all(-1))
        at, sure_px = len(points_m) + which, marks.sigma_px[views] / np.sqrt(_MARK_WEIGHT)
        of_room.append(keypoint_factor(start, views, at, marks.pixels[views, which], sure_px, aspect))
    free = np.ones(len(start.values), bool)
    numbers = free[: PER_CAMERA * len(cameras)].reshape(-1, PER_CAMERA)
    numbers[:, [LOG_FOCAL, RADIAL, PRINCIPAL.start, PRINCIPAL.start + 1]] = knowledge.sigma > 0
    if knowledge.pose_sigma is None:
        # The world is the first camera's.
        numbers[0, :6] = False
    else:
        numbers[:, :6] = knowledge.pose_sigma > 0
    free[start.starts["floor"] :][:3], free[start.starts["room"] :] = len(lower) > 0, len(room.turns) > 0
    solution = solve(start, [*factors, *of_room], free)
    found = solution.unknowns
    after = np.full_like(rig.points.points_m, np.nan)
    after[used] = found.group("points", 3 * len(points_m)).reshape(-1, 3)
    return RigEstimate(
        [found.camera(c, v) for v, c in enumerate(cameras)],
        found.of_cameras[:, RADIAL].copy(),
        rig,
        after,
        solution,
        measure_detector_noise(of_people.evaluate(found) * sigma_px[:, None], view, cell, px_per_m, cameras),
        sum(f.cost(f.evaluate(found)) for f in factors),
        room,
        knowledge,
    )


def _edges(
    room: RoomEvidence, cameras: Sequence[Camera], radial: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """View, ends (distorted pixels) and direction of every edge that runs along one, and the directions."""
    views, ends, axes = [], [], []
    for v, turn in room.turns.items():
        points = undistort_points(room.edges[v].reshape(-1, 2), cameras[v], radial[v]).reshape(-1, 2, 2)
        rays = (points - cameras[v].principal_px) / np.array(cameras[v].focal_px)
        rays = np.concatenate([rays, np.ones((len(points), 2, 1))], axis=-1)
        normals = np.cross(rays[:, 0], rays[:, 1])
        off = np.abs(normals @ turn.rotation_camera_from_room) / np.linalg.norm(normals, axis=1, keepdims=True)
        near = off.min(1) < np.radians(_ALONG_DEG)
        views.append(np.full(int(near.sum()), v))
        ends.append(room.edges[v][near])
        axes.append(off[near].argmin(1))
    first = next(iter(room.turns.values()))
    world_from_room = first.rotation_camera_from_world.T @ first.rotation_camera_from_room
    return np.concatenate(views), np.concatenate(ends), np.concatenate(axes), world_from_room


def _marks(
    marks: FloorMarks | None, cameras: Sequence[Camera], radial: np.ndarray
) -> tuple[FloorMarks | None, np.ndarray]:
    """Those of the floor's points that the cameras see in one place, and these places."""
    if marks is None:
        return None, np.zeros((0, 3))
    straight = np.stack([undistort_points(p, c, k1) for p, c, k1 in zip(marks.pixels, cameras, radial)])
    # Matches were compared before; the cameras may still be off by more than their sigma.
    found = triangulate(straight, np.isfinite(straight).all(-1).astype(float), cameras, _MARKS_MEET)
    return marks.of(found.valid), found.points_m[found.valid]


def _places(seen: Observations, person: np.ndarray) -> np.ndarray:
    """(people, frames, joints) index of each point, -1 where there is none."""
    times, time = np.unique(seen.frame, return_inverse=True)
    place = np.full((int(person.max()) + 1, len(times), len(STABLE_KEYPOINTS)), -1)
    place[person, time, seen.keypoint] = np.arange(len(seen.frame))
    return place


def _bones(place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of every bone that was seen, and which length it has."""
    ends = place[:, :, BONES]
    who, when, bone = np.nonzero((ends >= 0).all(-1))
    return ends[who, when, bone, 0], ends[who, when, bone, 1], who * _KINDS + bone % _KINDS


def _count_repeats(
    seen: Observations, points_m: np.ndarray, person: np.ndarray, place: np.ndarray, camera: Camera
) -> np.ndarray:
    """(N,) in how many frames the person of each point is in that place, seen from that side by ``camera``."""
    time = np.unique(seen.frame, return_inverse=True)[1]
    body, of_body = np.unique(np.stack([person, time], axis=1), axis=0, return_inverse=True)
    ends = place[body[:, 0], body[:, 1]]
    whole = np.where((ends >= 0)[..., None], points_m[ends], np.nan)
    cells = np.floor(np.nanmean(whole, axis=1) / _CELL_M).astype(int)
    shoulders = whole[:, SHOULDERS]
    side = viewing_sides((shoulders[:, 0] - shoulders[:, 1]) @ camera.camera_from_world[:3, :3].T)
    key = np.concatenate([body[:, :1], cells, side[:, None]], axis=1)
    _, cell, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    return count[cell.reshape(-1)][of_body.reshape(-1)].astype(float)


def _lower_ankles(place: np.ndarray, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the lower ankles, axes with people's mean direction upwards last, and a first floor in these."""
    ends = place[:, :, [*SHOULDERS, *ANKLES]]
    whole = ends[(ends >= 0).all(-1)]
    if len(whole) < 10:
        return np.zeros(0, int), np.eye(3), np.zeros(3)
    joints = points_m[whole]
    up = np.median(joints[:, :2].mean(1) - joints[:, 2:].mean(1), axis=0)
    up /= np.linalg.norm(up)
    axes = np.concatenate([np.linalg.svd(up[None])[2][1:], up[None]])
    ankles = whole[:, 2:]
    lower = ankles[np.arange(len(ankles)), (points_m[ankles] @ up).argmin(1)]
    return lower, axes, np.array([0.0, 0.0, np.median(points_m[lower] @ up)])
