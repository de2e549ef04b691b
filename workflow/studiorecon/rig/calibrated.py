# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras: how far people and the room require others than given, as one estimate with several freedoms.

The freedoms are priors: cameras exactly as given; within the calibration's error; with other focal lengths; with more
distortion; moved since. All are fitted to the same observations with the same errors, so their costs compare. A freedom
is used where it lowers the cost by more than chance would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtri

from studiorecon.estimate.intervals import Intervals, camera_intervals
from studiorecon.estimate.unknowns import PER_CAMERA
from studiorecon.geometry.camera_motion import PoseError, remove_drift
from studiorecon.geometry.rotations import angle, log
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.detector_noise import DetectorNoise
from studiorecon.rig.estimate import RigEstimate, RoomEvidence, estimate_once
from studiorecon.rig.floor_marks import floor_marks
from studiorecon.rig.from_tracks import MIN_SHARED, Rig, dense_tracks, propose_rigs
from studiorecon.rig.lens_knowledge import LensKnowledge, calibrated, undistort_tracks
from studiorecon.rig.room_evidence import edge_contradiction, edge_rotations, standing_area
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Standard deviations of a moved camera: several times the displacement of a knocked or replaced tripod. Beyond the
# others it is another position, or another camera's pose.
FREE_DEG, FREE_M = 20.0, 2.0
FURTHEST_DEG, FURTHEST_M = 10.0, 1.0
# A moved camera with a larger standard deviation is undetermined.
_MAX_SIGMA_DEG, _MAX_SIGMA_M = 2.5, 0.25
# Standard deviations of a given focal length, as a share, and of the distortion that a calibration left.
_FOCAL_SHARE, _RADIAL = 0.1, 0.3
# Probability with which chance lowers a cost by less than a freedom must, or raises people's by less than the room may.
_LEVEL = 0.999
# Gates of tracks in metres, and multiples of the usual errors, from coarse to fine; where most people agree, the search
# begins with the last ones.
_ROUNDS, _FINE = ((1.0, 16.0), (0.5, 8.0), (0.25, 4.0), (0.25, 2.0), (0.25, 1.0)), 2
# Frames of the search for a rig from people alone.
_RIG_FRAMES = 16
# Every camera agrees with this share of the observations with which the best one does.
_MIN_SHARE = 0.5
# Share of the edges' contradiction that may be left: what moved cameras do not explain has another cause, such as
# furniture that is not square. Of a real calibration that was 3.4° off 0.1 was left.
_MAX_LEFT = 0.5
# Largest distance between the cameras' floors, metres: at first, and after the first estimate.
_FLOOR_REACH_M = (0.25, 0.12)
# Standard deviation of rotations by points of a floor, which agree to a hundredth of a degree but do not show lenses.
_FLOOR_DEG = 0.1
_ALIGNED = 20
# Keypoints of a mean adult with arms out (metres): only gates depend on their size.
_SIDE_M = np.array([[0.16, 0.49], [0.44, 0.47], [0.70, 0.46], [0.10, -0.03], [0.16, -0.45], [0.15, -0.86]])
_ADULT_M = np.stack([np.pad(_SIDE_M * [s, 1.0], ((0, 0), (0, 1))) for s in (1.0, -1.0)], axis=1).reshape(-1, 3)
_NO_ROOM = RoomEvidence()


@dataclass(frozen=True)
class CalibratedEstimate:
    """The freedom that people and the room require, and the cameras by it.

    Attributes:
        freedom: "given", "poses", "focal", "radial" or "moved".
        cameras: the given ones where nothing else is required.
        seen: people as these cameras see them without further distortion.
        found: the estimate.
        by_people: every freedom's estimate by people alone.
    """

    freedom: str
    cameras: list[Camera]
    seen: Observations
    found: RigEstimate
    by_people: Mapping[str, RigEstimate]

    @property
    def radial(self) -> Num[np.ndarray, " V"]:
        """k1 of the distortion that the calibration left."""
        return self.found.radial

    @property
    def intervals(self) -> Intervals:
        """The cameras' uncertainty."""
        known = camera_intervals(self.found.solution)
        floor_deg = 0.0 if self.found.room.marks is None else _FLOOR_DEG
        return replace(
            known,
            turn_deg=np.hypot(known.turn_deg, floor_deg),
            between_deg=float(np.hypot(known.between_deg, 3 * floor_deg)),
        )

    def open_deg(self, given: Sequence[Camera]) -> tuple[float, float]:
        """By how much people alone would turn two of the ``given`` cameras, and half of the 95 % interval of that."""
        free = list(self.by_people.values())[-1]
        ours, theirs = ([c.camera_from_world[:3, :3] for c in group] for group in (free.cameras, given))
        turned = [angle(ours[a] @ ours[b].T, theirs[a] @ theirs[b].T) for a, b in combinations(range(len(ours)), 2)]
        return float(np.degrees(np.max(turned))), camera_intervals(free.solution).between_deg


def freedoms(given: Sequence[Camera], trust: PoseError) -> dict[str, LensKnowledge]:
    """The priors of ``given`` cameras, by name, from the least freedom on."""
    narrow = trust.turn_deg, trust.move_m
    return {
        "given": calibrated(given, 0.0, 0.0),
        "poses": calibrated(given, *narrow),
        "focal": calibrated(given, *narrow, _FOCAL_SHARE),
        "radial": calibrated(given, *narrow, _FOCAL_SHARE, _RADIAL),
        "moved": calibrated(given, FREE_DEG, FREE_M),
    }


def estimate_calibrated(
    given: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    limits: Limits,
    trust: PoseError,
    lost: bool = False,
    rooms: Sequence[RoomPicture | None] = (),
) -> CalibratedEstimate | None:
    """The cameras with the least freedom that explains people and the room; None where people show too little.

    ``trust``: the calibration's error. ``lost``: almost nobody agrees with the given cameras; then wider gates are
    tried, since identities and poses depend on each other, and at last a rig from people alone. ``rooms``: pictures of
    the room, where there are any.
    """
    priors = freedoms(given, trust)
    start = _search(given, detections, frames, gate_m, limits, priors["moved"], lost)
    rig = _grouped(given if start is None else start, detections, frames, gate_m, limits)
    if rig is None:
        return None
    if start is None:
        del priors["moved"]
    noise = DetectorNoise.typical(given, limits)
    fullest = list(priors)[-1]
    noise = _estimates(rig, {fullest: priors[fullest]}, noise)[fullest].noise
    by_people = _estimates(rig, priors, noise)
    if start is not None:
        known = camera_intervals(by_people["moved"].solution)
        if known.turn_deg.max() > _MAX_SIGMA_DEG or known.place_m.max() > _MAX_SIGMA_M:
            del priors["moved"]
    name = _required(priors, by_people)
    found = by_people[name]
    if len(rooms):
        name, found = _with_room(name, found, priors, rooms, limits)
    cameras = list(given)
    if name != "given":
        cameras = _align_to_unmoved(found.cameras, given, trust)
    straight = undistort_tracks(detections, cameras, found.radial)
    return CalibratedEstimate(name, cameras, make_observations(straight, cameras, frames, gate_m)[0], found, by_people)


def _estimates(
    rig: Rig,
    priors: Mapping[str, LensKnowledge],
    noise: DetectorNoise,
    room: RoomEvidence = _NO_ROOM,
    start_m: Num[np.ndarray, "N 3"] | None = None,
) -> dict[str, RigEstimate]:
    found = {}
    for name, prior in priors.items():
        about = rig if name == "moved" else replace(rig, cameras=dict(enumerate(prior.given)))
        found[name] = estimate_once(about, np.zeros(len(prior.given)), prior, _ADULT_M, noise, room, start_m)
    return found


def _required(priors: Mapping[str, LensKnowledge], found: Mapping[str, RigEstimate]) -> str:
    """The least freedom that explains the evidence up to chance."""
    best, *others = priors
    determined = {name: _count_determined(priors[name], found[name]) for name in priors}
    for name in others:
        more = max(determined[name] - determined[best], 1.0)
        if found[best].solution.cost - found[name].solution.cost > chdtri(more, 1 - _LEVEL):
            best = name
    return best


def _count_determined(prior: LensKnowledge, found: RigEstimate) -> float:
    """Numbers of the cameras that the evidence determines: the sum of 1 - posterior variance / prior variance."""
    sigma = np.concatenate([np.asarray(prior.pose_sigma), prior.sigma], axis=1).ravel()
    variance, free = np.diag(found.solution.covariance(PER_CAMERA * len(prior.given))), sigma > 0
    return float(np.clip(1 - variance[free] / sigma[free] ** 2, 0.0, 1.0).sum())


def _with_room(
    name: str,
    found: RigEstimate,
    priors: Mapping[str, LensKnowledge],
    rooms: Sequence[RoomPicture | None],
    limits: Limits,
) -> tuple[str, RigEstimate]:
    """The freedom and the estimate by people and the room, where people agree with it; otherwise those before."""
    # The room may require more freedom than people, not less.
    wider = list(priors)[list(priors).index(name) :]
    priors = {n: priors[n] for n in wider if n in (name, "poses", "moved")}
    best = name, found
    turns = edge_rotations(found.cameras, rooms)
    before = edge_contradiction(found.cameras, turns)
    if before is not None:
        edges = {v: room.edges_px for v, room in enumerate(rooms) if v in turns and room is not None}
        # Clear contradictions require other cameras, whether or not people show it.
        widest = list(priors)[-1] if before.clear else name
        after = _add_room(name, found, {widest: priors[widest]}, RoomEvidence(turns, edges))
        left = after and edge_contradiction(after[1].cameras, edge_rotations(after[1].cameras, rooms))
        if after and left and (not before.clear or left.off_deg <= _MAX_LEFT * before.off_deg):
            best = after
    for reach_m in _FLOOR_REACH_M:
        cameras = best[1].cameras
        marks = floor_marks(cameras, rooms, *standing_area(cameras, found.rig.seen, limits), reach_m)
        after = None if marks is None else _add_room(name, found, priors, replace(best[1].room, marks=marks))
        if not after:
            break
        best = after
        # Nearly always: cameras that stay match the same places of the floor again.
        if best[0] == "given":
            break
    return best


def _add_room(
    name: str, found: RigEstimate, priors: Mapping[str, LensKnowledge], room: RoomEvidence
) -> tuple[str, RigEstimate] | None:
    """The freedom of ``priors`` and the estimate by people and ``room``; None where people contradict them."""
    tried = _estimates(found.rig, priors, found.noise, room, found.points_m)
    required = _required(priors, tried)
    after, alone = tried[required], found
    if required != name:
        alone = _estimates(found.rig, {required: priors[required]}, found.noise, start_m=found.points_m)[required]
    numbers = max(int(after.solution.free[: PER_CAMERA * len(found.cameras)].sum()), 1)
    return (required, after) if after.people_cost - alone.people_cost <= chdtri(numbers, 1 - _LEVEL) else None


def _search(
    given: Sequence[Camera],
    detections: Sequence[Detections],
    frames: np.ndarray,
    gate_m: float,
    limits: Limits,
    prior: LensKnowledge,
    lost: bool,
) -> list[Camera] | None:
    """The cameras by people, wherever they stand near their given poses; None where people lead nowhere."""
    found = _settle(given, detections, frames, _ROUNDS[0 if lost else _FINE :], limits, prior)
    if found is not None or not lost:
        return found
    few = frames[:: max(1, len(frames) // _RIG_FRAMES)]
    proposed = propose_rigs(dense_tracks(detections, few, limits.min_confidence), given, _ADULT_M, gate_m, limits)
    rig = next((r for r in proposed if len(r.cameras) == len(given)), None)
    if rig is None:
        return None
    start = remove_drift([rig.cameras[v] for v in range(len(given))], given)[0]
    return _settle(start, detections, frames, _ROUNDS[_FINE:], limits, prior)


def _settle(
    start: Sequence[Camera],
    detections: Sequence[Detections],
    frames: np.ndarray,
    rounds: Sequence[tuple[float, float]],
    limits: Limits,
    prior: LensKnowledge,
) -> list[Camera] | None:
    """The cameras after the rounds; None with too little agreement, or with a camera far from its given pose."""
    current, usual = list(start), DetectorNoise.typical(start, limits)
    for gate_m, units in rounds:
        wide = replace(limits, huber_share=limits.huber_share * max(units / 2, 1.0))
        rig = _grouped(current, detections, frames, gate_m, wide)
        if rig is None:
            return None
        noise = DetectorNoise(usual.frame_px * units, usual.shared_m * units)
        current = estimate_once(rig, np.zeros(len(current)), prior, _ADULT_M, noise).cameras
    rig = _grouped(current, detections, frames, gate_m, limits)
    degrees, metres = pose_changes(current, prior.given)
    if rig is None or degrees.max() > FURTHEST_DEG or metres.max() > FURTHEST_M:
        return None
    counts = rig.points.inliers[:, rig.agreeing].sum(1)
    return current if counts.min() > _MIN_SHARE * counts.max() else None


def _grouped(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float, limits: Limits
) -> Rig | None:
    """People as ``cameras`` see them; None where they are too few."""
    seen, _ = make_observations(detections, cameras, frames, gate_m)
    if not len(seen.frame):
        return None
    rig = Rig(dict(enumerate(cameras)), seen, triangulate(seen.pixels, seen.confidence, cameras, limits), 0)
    return rig if rig.agreeing.sum() >= MIN_SHARED else None


def pose_changes(
    found: Sequence[Camera], given: Sequence[Camera]
) -> tuple[Num[np.ndarray, " V"], Num[np.ndarray, " V"]]:
    """Degrees and metres by which the cameras were turned and moved."""
    turned = np.stack([f.camera_from_world[:3, :3] @ g.camera_from_world[:3, :3].T for f, g in zip(found, given)])
    apart = np.array([f.centre_m - g.centre_m for f, g in zip(found, given)])
    return np.degrees(np.linalg.norm(log(turned), axis=-1)), np.linalg.norm(apart, axis=-1)


def _align_to_unmoved(found: Sequence[Camera], given: Sequence[Camera], trust: PoseError) -> list[Camera]:
    """The cameras aligned to the given ones that moved least, so that a knocked one does not displace the others.

    Where all were moved, they stay in the estimate's world, whose floor is under people's feet.
    """
    weights = np.ones(len(given))
    for _ in range(_ALIGNED):
        aligned = remove_drift(found, given, weights.tolist())[0]
        degrees, metres = pose_changes(aligned, given)
        weights = 1 / np.maximum(np.hypot(degrees / trust.turn_deg, metres / trust.move_m), 1.0)
    return aligned if weights.max() == 1.0 else list(found)
