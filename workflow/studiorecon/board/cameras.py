# SPDX-License-Identifier: Apache-2.0
"""Cameras from what all of them see of a board: lenses, offsets of the films, and one estimate of the poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.board.clocks import Link, links
from studiorecon.board.corners import MIN_CORNERS, Corners
from studiorecon.board.lens import FirstLens, first_lens
from studiorecon.board.pattern import Board
from studiorecon.board.poses import BoardTrack, board_track
from studiorecon.errors import UserError
from studiorecon.estimate.factor import Factor
from studiorecon.estimate.factors.board import board_factors
from studiorecon.estimate.factors.lenses import RADIAL_SIGMA, known_lenses
from studiorecon.estimate.intervals import camera_intervals
from studiorecon.estimate.solver import Solution, solve
from studiorecon.estimate.unknowns import CENTRE, RADIAL, TURN, Unknowns
from studiorecon.geometry.rotations import log
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Moments of the board in the estimate: an interval shrinks with their root, the work grows with their number.
_MOMENTS = 120
# Rounds of the estimate at most: delays converge by a factor of three each, until they move by less than a thousandth
# of a frame.
_ROUNDS = 8
_SETTLED_S = 1e-4
# Standard deviation of a webcam's principal point from the middle, as a share of the longer side.
_PRINCIPAL_SHARE = 0.02
# Standard deviation of a log focal length without any knowledge: 15 to 90 mm on full frame.
_FOCAL_SIGMA = 1.0
# Corners are found to this at best, pixels.
_LEAST_SIGMA_PX = 0.05


@dataclass(frozen=True)
class BoardCameras:
    """The cameras.

    Attributes:
        cameras: in the world of the first camera, metres; pinholes.
        distortion: camera → k1, k2.
        delays_s: camera → its film's time at the moment 0 of the first film.
        moments: camera → number of moments at which it and another camera see the board.
        error_px: camera → median distance of a corner from its place by the estimate.
        focal_sigma: camera → relative standard deviation of its focal length.
        between_deg: half of the 95 % interval of the rotation between the least certain two cameras.
    """

    cameras: list[Camera]
    distortion: Mapping[str, tuple[float, float]]
    delays_s: Mapping[str, float]
    moments: Mapping[str, int]
    error_px: Mapping[str, float]
    focal_sigma: Mapping[str, float]
    between_deg: float


def cameras_from_board(seen: Mapping[str, Corners], sizes: Mapping[str, tuple[int, int]], board: Board) -> BoardCameras:
    """The cameras that see ``board`` as ``seen``, with pictures of ``sizes``.

    Raises UserError naming the camera that sees the board too rarely, or never together with another one.
    """
    names = list(seen)
    lenses = [first_lens(name, seen[name], board, sizes[name]) for name in names]
    tracks = [board_track(seen[name], lens, board) for name, lens in zip(names, lenses, strict=True)]
    rotations, places, delays = _chained(names, links(tracks), board)
    times = _moments(tracks, delays)
    boards = _first_boards(tracks, times, delays, rotations, places)
    times, boards = times[np.isfinite(boards).all(1)], boards[np.isfinite(boards).all(1)]
    pinholes = [
        Camera(name, sizes[name], lens.intrinsics, _rigid(turn, place))
        for name, lens, turn, place in zip(names, lenses, rotations, places, strict=True)
    ]
    found = _estimate(pinholes, lenses, tracks, times, boards, delays, board)
    unknowns, seen_at = found.solution.unknowns, np.isfinite(found.views[..., 0]).any(2)
    intervals = camera_intervals(found.solution)
    # Corners of one picture share a part of their errors, by blur, a rolling shutter or a bent board, which is taken to
    # be as large as each corner's own.
    shared = np.sqrt(1 + np.isfinite(found.views[..., 0]).sum() / seen_at.sum())
    return BoardCameras(
        [unknowns.camera(pinhole, v) for v, pinhole in enumerate(pinholes)],
        {
            name: (float(unknowns.of_cameras[v, RADIAL]), float(unknowns.group("second", len(names))[v]))
            for v, name in enumerate(names)
        },
        dict(zip(names, found.delays_s.tolist(), strict=True)),
        dict(zip(names, seen_at.sum(1).tolist(), strict=True)),
        dict(zip(names, found.errors_px, strict=True)),
        dict(zip(names, (shared * intervals.focal).tolist(), strict=True)),
        float(shared * intervals.between_deg),
    )


@dataclass(frozen=True)
class _Estimate:
    solution: Solution
    views: Num[np.ndarray, "V M N 2"]
    delays_s: Num[np.ndarray, " V"]
    errors_px: list[float]


def _estimate(
    pinholes: list[Camera],
    lenses: list[FirstLens],
    tracks: list[BoardTrack],
    times_s: Num[np.ndarray, " M"],
    boards: Num[np.ndarray, "M 6"],
    delays_s: Num[np.ndarray, " V"],
    board: Board,
) -> _Estimate:
    """Cameras, lenses, delays and the board's poses ``boards`` at ``times_s``, from their first values on."""
    nothing = np.zeros(len(lenses))
    unknowns = Unknowns.of(
        pinholes,
        np.array([lens.radial for lens in lenses]),
        np.zeros((0, 3)),
        second=nothing,
        delays=nothing,
        boards=boards.ravel(),
    )
    sigma_px = max(float(np.median([lens.sigma_px for lens in lenses])), _LEAST_SIGMA_PX)
    # Again with the delays and with the errors that remain: they say what corners between pictures add to the noise.
    for _ in range(_ROUNDS):
        views = np.stack([track.pixels_at(times_s + delay) for track, delay in zip(tracks, delays_s, strict=True)])
        speeds = np.stack([track.speed_at(times_s + delay) for track, delay in zip(tracks, delays_s, strict=True)])
        corners, second = board_factors(unknowns, views, speeds, board.corners_m, np.full(len(lenses), sigma_px))
        solution = solve(unknowns, [corners, second, _lens_prior(unknowns, pinholes)], _free(unknowns))
        unknowns = solution.unknowns
        off = np.linalg.norm(corners.evaluate(unknowns), axis=1) * sigma_px
        # The median of a distance in the plane is this many standard deviations of an axis.
        sigma_px = max(float(np.median(off)) / np.sqrt(2 * np.log(2)), _LEAST_SIGMA_PX)
        moved = unknowns.group("delays", len(lenses))
        delays_s = delays_s + moved
        unknowns = unknowns.with_group("delays", nothing)
        if np.abs(moved).max() < _SETTLED_S:
            break
    return _Estimate(solution, views, delays_s, [float(np.median(off[corners.view == v])) for v in range(len(lenses))])


def _lens_prior(unknowns: Unknowns, pinholes: list[Camera]) -> Factor:
    expected = np.array([[np.log(c.focal_px[0]), 0.0, *(np.array(c.wh) / 2)] for c in pinholes])
    sigma = [[_FOCAL_SIGMA, RADIAL_SIGMA, *2 * [_PRINCIPAL_SHARE * max(c.wh)]] for c in pinholes]
    return known_lenses(unknowns, expected, np.array(sigma))


def _free(unknowns: Unknowns) -> Bool[np.ndarray, " U"]:
    """All, but for the pose and the delay of the first camera."""
    free = np.ones(len(unknowns.values), dtype=bool)
    free[np.r_[TURN, CENTRE]] = False
    free[unknowns.starts["delays"]] = False
    return free


def _rigid(rotation: Num[np.ndarray, "3 3"], place: Num[np.ndarray, " 3"]) -> Num[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def _chained(names: list[str], tree: list[Link], board: Board) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations and places of all cameras from the first, and the films' delays, along the links."""
    rotations: dict[int, np.ndarray] = {0: np.eye(3)}
    places: dict[int, np.ndarray] = {0: np.zeros(3)}
    delays: dict[int, float] = {0: 0.0}
    for _ in names:
        for link in tree:
            a, b, turn, place, delay = link.first, link.second, link.rotation, link.place_m, link.delay_s
            if b in rotations and a not in rotations:
                a, b, turn, place, delay = b, a, turn.T, -turn.T @ place, -delay
            if a in rotations and b not in rotations:
                rotations[b], places[b], delays[b] = turn @ rotations[a], turn @ places[a] + place, delays[a] + delay
    if alone := [name for v, name in enumerate(names) if v not in rotations]:
        raise UserError(
            f"no moment shows the board ({board.in_words}) to {', '.join(alone)} and to another camera; move the board "
            "slowly through the places that both see"
        )
    order = range(len(names))
    return (
        np.stack([rotations[v] for v in order]),
        np.stack([places[v] for v in order]),
        np.array([delays[v] for v in order]),
    )


def _moments(tracks: list[BoardTrack], delays_s: Num[np.ndarray, " V"]) -> Num[np.ndarray, " M"]:
    """Moments on the first film's time line, spread over the film; among neighbours the one that most cameras see, and
    then the slowest, where errors of time hardly count."""
    times = np.unique(np.round(np.concatenate([t.times_s - d for t, d in zip(tracks, delays_s, strict=True)]), 9))
    seen = np.stack(
        [(np.isfinite(t.pixels_at(times + d)[..., 0]).sum(1) >= MIN_CORNERS) for t, d in zip(tracks, delays_s)]
    )
    count = seen.sum(0)
    moved = np.stack([t.speed_at(times + d) for t, d in zip(tracks, delays_s, strict=True)])
    speed = np.linalg.norm(np.nan_to_num(moved), axis=-1).mean(-1).max(0)
    kept = []
    for part in np.array_split(np.flatnonzero(count >= 2), _MOMENTS):
        if len(part):
            kept.append(part[np.lexsort((speed[part], -count[part]))[0]])
    return times[kept]


def _first_boards(
    tracks: list[BoardTrack],
    times_s: Num[np.ndarray, " M"],
    delays_s: Num[np.ndarray, " V"],
    rotations: Num[np.ndarray, "V 3 3"],
    places: Num[np.ndarray, "V 3"],
) -> Num[np.ndarray, "M 6"]:
    """Axis-angle and place of the board in the world, from the nearest pose before any camera; NaN without one."""
    found = np.full((len(times_s), 6), np.nan)
    nearest = np.full(len(times_s), np.inf)
    for track, delay, turn, place in zip(tracks, delays_s, rotations, places, strict=True):
        if not len(track.times_s):
            continue
        index = np.abs(track.times_s[None] - (times_s + delay)[:, None]).argmin(1)
        away = np.abs(track.times_s[index] - times_s - delay)
        better = (away < nearest) & (away <= track.gap_s)
        world = np.concatenate([log(turn.T @ track.rotations[index]), (track.places_m[index] - place) @ turn], axis=1)
        found[better], nearest[better] = world[better], away[better]
    return found
