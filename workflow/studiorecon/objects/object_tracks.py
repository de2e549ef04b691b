# SPDX-License-Identifier: Apache-2.0
"""Tracks objects: links sightings of successive moments, then estimates positions with one radius per track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.smoothing import fill_vectors
from studiorecon.objects.sightings import Sighting, fit_sphere
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Largest ratio between radii of one object at two moments.
_ONE_SIZE = 2.0
# A sphere whose outlines are off by more pixels than this is rejected.
_WORST_PX = 3.0
# A round object's outlines are a sphere's within this many pixels or this share of its radius, whichever is more.
_ROUND_PX, _ROUND = 1.2, 0.12


@dataclass(frozen=True)
class FollowSettings:
    """Limits of tracking.

    Attributes:
        speed_m_s: largest deviation from the predicted velocity.
        gap_s: longest time without a sighting; shorter gaps are filled by a straight line.
        min_s: time in which two cameras must see it, half of it without occlusion by people.
    """

    speed_m_s: float = 8.0
    gap_s: float = 0.4
    min_s: float = 0.3


@dataclass(frozen=True)
class ObjectTrack:
    """An object over time; ``centres_m``, ``valid`` and ``present`` as in ``RigidObject``; ``sightings`` by
    frame.

    ``is_sphere`` is whether its outlines are those of a sphere; other objects are at the intersection of the rays
    through their regions' middles.
    """

    centres_m: Float[np.ndarray, "T 3"]
    valid: Bool[np.ndarray, " T"]
    present: Bool[np.ndarray, " T"]
    radius_m: float
    sightings: tuple[tuple[int, Sighting], ...]
    is_sphere: bool = True


def link_sightings(
    found: Sequence[tuple[int, list[Sighting]]], fps: float, settings: FollowSettings
) -> list[list[tuple[int, Sighting]]]:
    """Sightings of successive frames linked into tracks, each to the track with the nearest predicted position."""
    tracks: list[list[tuple[int, Sighting]]] = []
    for frame, things in found:
        pairs = []
        for k, track in enumerate(tracks):
            elapsed_s = (frame - track[-1][0]) / fps
            if elapsed_s > settings.gap_s + 1 / fps:
                continue
            expected = _predict(track, frame)
            for i, thing in enumerate(things):
                # An object that bounces leaves its predicted path.
                off_m = float(
                    min(np.linalg.norm(thing.centre_m - place) for place in (expected, track[-1][1].centre_m))
                )
                ratio = thing.radius_m / track[-1][1].radius_m
                if off_m <= settings.speed_m_s * elapsed_s and 1 / _ONE_SIZE < ratio < _ONE_SIZE:
                    pairs.append((off_m, k, i))
        grown: set[int] = set()
        used: set[int] = set()
        for _, k, i in sorted(pairs):
            if k not in grown and i not in used:
                tracks[k].append((frame, things[i]))
                grown.add(k)
                used.add(i)
        tracks += [[(frame, thing)] for i, thing in enumerate(things) if i not in used]
    return tracks


def track_object(
    track: Sequence[tuple[int, Sighting]], cameras: Sequence[Camera], frames: int, fps: float, settings: FollowSettings
) -> ObjectTrack | str:
    """The track of an object over all ``frames``, or a sentence why it is rejected.

    The radius is the median of the moments in which no person occludes it; with it every moment's outlines give the
    middle. Nothing is smoothed over time: outlines fix the middle within millimetres, and a bounce is not smooth.
    """
    free = [sighting for _, sighting in track if sighting.free >= 2]
    least = max(2.0, settings.min_s * fps)
    if len(track) < least or 2 * len(free) < least:
        return (
            f"two cameras see it for {len(track) / fps:.2f} s, with no person in front of it for {len(free) / fps:.2f} "
            f"s; {settings.min_s:g} s and half as much are needed"
        )
    radius_m, centres, is_round = _spheres(track, free, cameras, frames)
    if not is_round:
        radius_m, centres = _middles(track, free, cameras, frames)
    whole = [frame for frame, sighting in track if sighting.free >= 2]
    valid = np.isfinite(centres).all(axis=1)
    if valid.sum() < least:
        return (
            f"only {valid.sum() / fps:.2f} s agree with a thing of {100 * radius_m:.0f} cm "
            f"radius; {settings.min_s:g} s are needed"
        )
    if sum(valid[frame] for frame in whole) < least / 2:
        return f"less than {settings.min_s / 2:g} s that agree show the whole of it"
    reach = np.ptp(centres[valid], axis=0)
    if np.linalg.norm(reach) <= radius_m:
        return "it does not move: it belongs on the plate"
    present = is_covered(valid, fps, settings)
    filled = np.where(present[:, None], fill_vectors(np.nan_to_num(centres), valid), np.nan)
    return ObjectTrack(filled, valid, present, radius_m, tuple(track), is_round)


def _spheres(
    track: Sequence[tuple[int, Sighting]], free: Sequence[Sighting], cameras: Sequence[Camera], frames: int
) -> tuple[float, np.ndarray, bool]:
    """The radius of most unoccluded sightings, centres of spheres of that radius (NaN for none), and if it is one."""
    centres = np.full((frames, 3), np.nan)
    fits = np.array([fit_sphere(cameras, sighting)[1:] for sighting in free])
    fits = fits[np.isfinite(fits).all(axis=1)]
    if 2 * len(fits) < len(free):
        return float("nan"), centres, False
    radius_m, error_px = np.median(fits, axis=0).tolist()
    radius_px = np.median(
        [radius_m * c.focal_px[0] / c.project(s.centre_m)[1] for s in free for c in (cameras[v] for v in s.regions)]
    )
    for frame, sighting in track:
        centre, _, off_px = fit_sphere(cameras, sighting, radius_m)
        if np.isfinite(centre).all() and off_px <= _WORST_PX:
            centres[frame] = centre
    return radius_m, centres, error_px <= max(_ROUND_PX, _ROUND * radius_px)


def _middles(
    track: Sequence[tuple[int, Sighting]], free: Sequence[Sighting], cameras: Sequence[Camera], frames: int
) -> tuple[float, np.ndarray]:
    """Radius of the disc with the regions' usual area, and the points nearest to the rays through their middles.

    Where two cameras show unoccluded regions, only these are used: the middle of a visible part is not the object's.
    """
    radius_m = float(np.median([sighting.radius_m for sighting in free]))
    centres = np.full((frames, 3), np.nan)
    for frame, sighting in track:
        used = [(v, r) for v, r in sorted(sighting.regions.items()) if r.free or sighting.free < 2]
        across, at = np.zeros((3, 3)), np.zeros(3)
        for view, region in used:
            ray = cameras[view].unproject(region.centre_px, np.ones(())) - cameras[view].centre_m
            ray /= np.linalg.norm(ray)
            across += np.eye(3) - np.outer(ray, ray)
            at += (np.eye(3) - np.outer(ray, ray)) @ cameras[view].centre_m
        # Rays of a sighting meet at an angle; a sighting with parallel rays was rejected before.
        centre = np.linalg.solve(across, at)
        off_px = [np.linalg.norm(cameras[view].project(centre)[0] - region.centre_px) for view, region in used]
        if np.sqrt(np.mean(np.square(off_px))) <= _WORST_PX:
            centres[frame] = centre
    return radius_m, centres


def _predict(track: Sequence[tuple[int, Sighting]], frame: int) -> np.ndarray:
    """(3,) position predicted from the last two sightings at constant velocity."""
    last_frame, last = track[-1]
    if len(track) < 2:
        return last.centre_m
    before_frame, before = track[-2]
    return last.centre_m + (last.centre_m - before.centre_m) * (frame - last_frame) / (last_frame - before_frame)


def is_covered(valid: Bool[np.ndarray, " T"], fps: float, settings: FollowSettings) -> Bool[np.ndarray, " T"]:
    """Measured frames, and the gaps between them that are short enough to be filled."""
    present, at = valid.copy(), np.flatnonzero(valid)
    for a, b in pairwise(at):
        if b - a - 1 <= round(settings.gap_s * fps):
            present[a:b] = True
    return present
