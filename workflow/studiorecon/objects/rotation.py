# SPDX-License-Identifier: Apache-2.0
"""An object's rotation over time: a shape from the moment that shows it best, tracked both ways, then refined.

Each moment's pose is fitted to colours and outlines in all views at once (``pose_fit``), with a prior from neighbouring
moments. So a rotation that a view does not determine, such as a stick's about its own length, does not drift.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.geometry import rotations
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors
from studiorecon.objects.carving import init_carved_surface, reach_m, volume_m3
from studiorecon.objects.object_tracks import ObjectTrack
from studiorecon.objects.pose_fit import Fitter, ObjectObservation, Prior, move_pose, observe_crop
from studiorecon.objects.rigid import ObjectCrop, ShapeSettings, crop_at_pose, train_object, unoccluded_crops
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# The object's shape while poses are estimated: untrained, a board's turns about its length were 9° off instead of 1.
_SHAPE = ShapeSettings(gaussians=400, iterations=800)
# Blurs of the pictures while tracking, pixels, and steps at each; steps of later rounds.
_BLURS_PX, _STEPS, _LATER_STEPS = (2.0, 0.0), 6, 4
# Turns from which the first neighbour's fit starts, radians: the direction of rotation is not known yet.
_FIRST_RAD = 0.4
# A moment with this many times the median error is lost.
_LOST = 3.0
# Sigma of a middle around the position from outlines only, as a share of the reach.
_PLACE = 0.15
# An object whose rotation never differs by more than this from its mean is still.
_MIN_RAD = np.radians(6.0)
# No gain reaches this.
NEVER_DB = 100.0


@dataclass(frozen=True)
class TurnSettings:
    """Settings of the estimate of rotations; ``rad_s2`` is the typical largest angular acceleration."""

    rad_s2: float = 60.0
    gain_db: float = setting(
        1.0,
        "Minimum gain on validation crops for an object to rotate; 100 = no rotation, the fastest.",
        unit="dB",
        minimum=0,
        maximum=100,
    )


@dataclass(frozen=True)
class RigidMotion:
    """``world_from_thing``, and the frames in which it was ``measured``; other present frames are interpolated."""

    world_from_thing: Float[np.ndarray, "T 4 4"]
    measured: Bool[np.ndarray, " T"]


def track_rotation(
    track: ObjectTrack,
    cameras: Sequence[Camera],
    apart: Collection[tuple[int, int]],
    fps: float,
    settings: TurnSettings,
    rng: np.random.Generator,
    threads: int,
) -> RigidMotion | None:
    """A track's rotation over time without the validation crops ``apart``; None if it is still or undetermined.

    Some 0.1 s per frame and view; ``rng`` is for the training of its shape.
    """
    observations = _observations(track, cameras, apart)
    frames = sorted(observations)
    looks = [look for look in unoccluded_crops(track, cameras) if (look.frame, look.view) not in apart]
    if len(frames) < 3 or not looks:
        return None
    still = np.tile(np.eye(4), (len(track.centres_m), 1, 1))
    still[:, :3, 3] = np.nan_to_num(track.centres_m)
    best = _tightest_crops(looks, cameras, still)
    shape = _shape(best, rng, threads)
    if shape is None:
        return None
    poses = _follow(Fitter(*shape, threads), still, observations, best[0].frame, fps, settings)
    if _largest_rad(np.stack([poses[frame][:3, :3] for frame in frames])) < _MIN_RAD:
        return None
    # Once more with the shape from all moments; a third time changes nothing.
    shape = _shape([crop_at_pose(look, cameras, poses[look.frame]) for look in looks], rng, threads)
    if shape is None:
        return None
    fitter = Fitter(*shape, threads)
    poses = _refine_poses(fitter, still, poses, observations, fps, settings)
    misfits = {frame: np.divide(*fitter.misfit(poses[frame], observations[frame])) for frame in frames}
    measured = np.zeros(len(still), bool)
    measured[[frame for frame in frames if misfits[frame] <= _LOST * np.median(list(misfits.values()))]] = True
    measured &= track.valid
    turns = np.stack([poses[frame][:3, :3] if frame in poses else np.eye(3) for frame in range(len(still))])
    if measured.sum() < 3 or _largest_rad(turns[measured]) < _MIN_RAD:
        return None
    filled = still.copy()
    filled[:, :3, :3] = fill_rotations(turns, measured)
    middles = np.stack([poses[frame][:3, 3] if frame in poses else np.zeros(3) for frame in range(len(still))])
    filled[:, :3, 3] = fill_vectors(middles, measured)
    return RigidMotion(filled, measured)


def _largest_rad(turns: np.ndarray) -> float:
    """Largest angle between turns (N, 3, 3) and their mean."""
    return float(rotations.angle(rotations.mean(turns)[0], turns).max())


def _observations(
    track: ObjectTrack, cameras: Sequence[Camera], apart: Collection[tuple[int, int]]
) -> dict[int, list[ObjectObservation]]:
    """All cameras' observations by frame, including those where a person occludes a part."""
    found: dict[int, list[ObjectObservation]] = {}
    for frame, sighting in track.sightings:
        for view, region in sorted(sighting.regions.items()):
            if track.valid[frame] and (frame, view) not in apart:
                look = ObjectCrop(frame, view, region.corner, cameras[view], region.rgb, region.state)
                crop = crop_at_pose(look, cameras, np.eye(4)).camera
                found.setdefault(frame, []).append(observe_crop(crop, region.rgb, region.state))
    return found


def _tightest_crops(looks: Sequence[ObjectCrop], cameras: Sequence[Camera], still: np.ndarray) -> list[ObjectCrop]:
    """The crops of the moment with the smallest hull, which contains the object, among those that most cameras show."""
    by_frame: dict[int, list[ObjectCrop]] = {}
    for look in looks:
        by_frame.setdefault(look.frame, []).append(crop_at_pose(look, cameras, still[look.frame]))
    most = max(map(len, by_frame.values()))
    volumes_m3 = {frame: volume_m3(own) for frame, own in by_frame.items() if len(own) == most}
    return by_frame[min(volumes_m3, key=volumes_m3.__getitem__)]


def _shape(looks: Sequence[ObjectCrop], rng: np.random.Generator, threads: int) -> tuple[Gaussians, float] | None:
    """Gaussians from crops in the object's own frame, and their reach in metres; None where nothing is left."""
    found, reach = init_carved_surface(looks, _SHAPE.gaussians), reach_m(looks)
    return None if found is None else (train_object(looks, found, reach, _SHAPE, rng, threads, "pose")[0], reach)


def _follow(
    fitter: Fitter,
    still: np.ndarray,
    observations: Mapping[int, list[ObjectObservation]],
    start: int,
    fps: float,
    settings: TurnSettings,
) -> dict[int, np.ndarray]:
    """Poses (4, 4) by frame, tracked from the moment ``start`` both ways."""
    frames = sorted(observations)
    poses = {start: still[start]}
    at = frames.index(start)
    for way in (frames[at + 1 :], frames[:at][::-1]):
        before: list[int] = [start]
        for frame in way:
            last, gap = poses[before[-1]], abs(frame - before[-1])
            expected = still[frame].copy()
            expected[:3, :3] = last[:3, :3]
            starts = [expected]
            if len(before) == 1:
                slack_rad = 2 * _FIRST_RAD * gap
                starts += [
                    move_pose(expected, sign * _FIRST_RAD * unit) for unit in np.eye(6)[:3] for sign in (1.0, -1.0)
                ]
            else:
                slack_rad = settings.rad_s2 * (gap / fps) ** 2
                first = poses[before[-2]][:3, :3]
                share = gap / abs(before[-1] - before[-2])
                going = expected.copy()
                going[:3, :3] = last[:3, :3] @ rotations.exp(share * rotations.log(first.T @ last[:3, :3]))
                starts, expected = [expected, going], going
            prior = Prior(expected, max(slack_rad, 0.05), fitter.reach_m * _PLACE)
            found = [fitter.fit(pose, observations[frame], prior, _BLURS_PX, _STEPS) for pose in starts]
            poses[frame] = min(found, key=lambda pose: fitter.cost(pose, observations[frame], prior, 0.0))
            before.append(frame)
    return poses


def _refine_poses(
    fitter: Fitter,
    still: np.ndarray,
    poses: Mapping[int, np.ndarray],
    observations: Mapping[int, list[ObjectObservation]],
    fps: float,
    settings: TurnSettings,
) -> dict[int, np.ndarray]:
    """Poses by frame, fitted again with another shape, each with a prior from its neighbours on both sides."""
    frames, new = sorted(observations), dict(poses)
    for i, frame in enumerate(frames):
        low, high = frames[max(i - 1, 0)], frames[min(i + 1, len(frames) - 1)]
        share = (frame - low) / (high - low)
        expected = still[frame].copy()
        expected[:3, :3] = rotations.slerp(new[low][:3, :3], new[high][:3, :3], share)
        # At an end there is one neighbour, which does not limit the rotation.
        slack_rad = settings.rad_s2 * ((high - low) / fps) ** 2 / 2
        prior = Prior(expected, max(slack_rad, 0.05), fitter.reach_m * _PLACE)
        new[frame] = fitter.fit(new[frame], observations[frame], prior, (0.0,), _LATER_STEPS)
    return new
