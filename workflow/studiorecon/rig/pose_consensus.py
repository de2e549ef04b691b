# SPDX-License-Identifier: Apache-2.0
"""The rig that people determine without any poses: the one with most support, cameras left out with reasons, and a
rival.

A camera without evidence is left out by name; the others are still used. The rival is another rig with about as much
support.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.geometry.camera_motion import remove_drift
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.calibrated import pose_changes
from studiorecon.rig.from_tracks import Rig, Sightings, dense_tracks, propose_rigs
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Num

# Fields of view to try without a given one: phones, action cameras, webcams, telephoto lenses.
_HFOV_DEG = (65.0, 85.0, 48.0, 105.0, 36.0)
# Real detectors are off by more than one error unit more often than synthetic ones: a second, wider search where the
# first fails.
_WIDER = (1.0, 2.0)
# In a different rig, cameras have relative rotations that differ by more than this.
_SAME_DEG = 5.0


@dataclass(frozen=True)
class PoseConsensus:
    """The cameras whose poses people determine.

    Attributes:
        cameras: their indices among all cameras, ascending.
        rig: the rig; its views count these cameras.
        sightings: their observations.
        left_out: all other cameras → why.
        rival: another rig of the same cameras with about as much support, or None.
    """

    cameras: list[int]
    rig: Rig
    sightings: Sightings
    left_out: Mapping[str, str]
    rival: Rig | None


def find_pose_consensus(
    detections: Sequence[Detections],
    wh: Sequence[tuple[int, int]],
    known_px: Mapping[str, float],
    frames: int,
    looked_at: int,
    template_m: Num[np.ndarray, "12 3"],
    gate_m: float,
    limits: Limits,
    rival_share: float,
) -> PoseConsensus | None:
    """The best rig of all cameras, or of as many as people determine; None if fewer than two.

    ``known_px``: camera → focal length, where it is known. At most ``looked_at`` of ``frames`` are used, spread over
    those in which two cameras see people; and as many again for each camera that the first search did not place.
    """
    names = [d.camera for d in detections]
    guesses = _HFOV_DEG if len(known_px) < len(names) else _HFOV_DEG[:1]
    shared, seen_by = np.unique(np.concatenate([np.unique(d.frame) for d in detections]), return_counts=True)
    shared = shared[(seen_by > 1) & (shared >= 0) & (shared < frames)]
    if not len(shared):
        return None
    seen = dense_tracks(detections, _spread(shared, looked_at), limits.min_confidence)
    best: list[Rig] = []

    def look(at: Sightings, hfov_deg: float, wider: float, known: Sequence[Rig] = ()) -> list[Rig]:
        start = _initial_cameras(known, names, wh, known_px, hfov_deg)
        return _better_rigs(best, propose_rigs(at, start, template_m, gate_m, _widen(limits, wider)))

    for wider, hfov_deg in itertools.product(_WIDER, guesses):
        if best and (wider > _WIDER[0] or len(best[0].cameras) == len(names)):
            break
        best = look(seen, hfov_deg, wider)
    if not best:
        return None
    if len(best[0].cameras) < len(names):
        # The focal lengths of the narrow search are a sufficient start for a wide one.
        best = look(seen, guesses[0], _WIDER[-1], best)
    missing = [v for v in range(len(names)) if v not in best[0].cameras]
    own = [frame for v in missing if len(frame := np.intersect1d(shared, detections[v].frame))]
    more = [_spread(frame, looked_at) for frame in own]
    if more and not np.isin(np.concatenate(more), seen.frames).all():
        again = dense_tracks(detections, np.unique(np.concatenate([seen.frames, *more])), limits.min_confidence)
        found = look(again, guesses[0], _WIDER[-1], best)
        best, seen = (found, again) if found[0] is not best[0] else (best, seen)
    placed = sorted(best[0].cameras)
    return PoseConsensus(
        placed,
        _renumber(best[0], placed),
        Sightings([detections[v] for v in placed], seen.frames, tuple(seen.pixels[v] for v in placed)),
        {n: _reason(detections[v]) for v, n in enumerate(names) if v not in placed},
        _rival([_renumber(other, placed) for other in best if sorted(other.cameras) == placed], rival_share),
    )


def pose_distance(rival: Rig, cameras: Sequence[Camera]) -> tuple[Num[np.ndarray, " V"], Num[np.ndarray, " V"]]:
    """Degrees and metres by which ``cameras`` differ from those of another rig aligned to them."""
    laid = remove_drift([rival.cameras[v] for v in sorted(rival.cameras)], cameras)[0]
    return pose_changes(laid, cameras)


def _spread(frames: np.ndarray, wanted: int) -> np.ndarray:
    chosen: np.ndarray = frames[spread_indices(len(frames), wanted)]
    return chosen


def _widen(limits: Limits, factor: float) -> Limits:
    return replace(limits, huber_share=limits.huber_share * factor)


def _initial_cameras(
    best: Sequence[Rig],
    names: Sequence[str],
    wh: Sequence[tuple[int, int]],
    known_px: Mapping[str, float],
    hfov_deg: float,
) -> list[Camera]:
    """Initial cameras, with known focal lengths, those of the best rig so far and their median, or guesses."""
    found_px = {v: c.focal_px[0] for v, c in best[0].cameras.items()} if best else {}
    usual = float(np.median(list(found_px.values()))) if found_px else None
    return [_pinhole(n, wh[v], known_px.get(n) or found_px.get(v) or usual, hfov_deg) for v, n in enumerate(names)]


def _better_rigs(first: list[Rig], second: list[Rig]) -> list[Rig]:
    """The list whose best rig has more cameras, or more support with as many."""
    if not first or not second:
        return first or second
    one, other = ((len(found[0].cameras), found[0].support) for found in (first, second))
    return second if other > one else first


def _pinhole(name: str, wh: tuple[int, int], focal_px: float | None, hfov_deg: float) -> Camera:
    focal = focal_px or 0.5 * max(wh) / np.tan(np.radians(hfov_deg) / 2)
    return Camera(name, wh, np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]]), np.eye(4))


def _renumber(rig: Rig, placed: Sequence[int]) -> Rig:
    """The rig with its views counted among the ``placed``."""
    return replace(rig, cameras={k: rig.cameras[v] for k, v in enumerate(placed)})


def _reason(seen: Detections) -> str:
    if not len(seen.frame):
        return "it sees no person, and without a calibration, cameras are estimated from people"
    return "it shares too few keypoints with the other cameras"


def _rival(found: Sequence[Rig], rival_share: float) -> Rig | None:
    first = found[0]
    for other in found[1:]:
        turned = [_relative_turn_deg(first, other, v) for v in range(1, len(first.cameras))]
        if other.support >= rival_share * first.support and max(turned) > _SAME_DEG:
            return other
    return None


def _relative_turn_deg(first: Rig, second: Rig, view: int) -> float:
    a, b = (
        r.cameras[view].camera_from_world[:3, :3] @ r.cameras[0].camera_from_world[:3, :3].T for r in (first, second)
    )
    return float(np.degrees(angle(a, b)))
