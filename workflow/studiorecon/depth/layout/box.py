# SPDX-License-Identifier: Apache-2.0
"""From votes to a room: the most voted wall on each side and its offset to the centimetre."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.layout.votes import Votes
from studiorecon.depth.stereo.matching import UNKNOWN
from studiorecon.depth.stereo.plates import Picture, best_score
from studiorecon.depth.sweep_settings import Matching
from studiorecon.geometry.statistics import peak_position
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Lower scores belong to other surfaces and would bias the mean that places a plane.
_SAME_SURFACE = 0.2
_MIN_VOTERS = 30
# Walls with this share of the best one's votes are its rivals; the window that decides is a tenth of the picture's
# width.
_RIVAL_SHARE, _MAX_RIVALS = 0.2, 6
_WIDE_SHARE = 20
# Score that is as likely on a wrong surface as on the right one, and the score below which lower ones say no more.
_EVEN_SCORE, _LEAST_SCORE = 0.32, -0.2


def plane_support(
    pictures: Sequence[Picture],
    voters: Sequence[Bool[np.ndarray, "H W"]],
    plane: Float[np.ndarray, " 4"],
    how: Matching,
) -> tuple[float, int]:
    """Mean score of a plane over the pixels that voted for it (all pairs that see it), and number of comparisons."""
    total, count = 0.0, 0
    for i, picture in enumerate(pictures):
        if voters[i].sum() < _MIN_VOTERS:
            continue
        for j, other in enumerate(pictures):
            if i == j:
                continue
            score = picture.score(other, plane, how)[voters[i]]
            score = score[score > _SAME_SURFACE]
            total, count = total + float(score.sum(dtype=np.float64)), count + len(score)
    return total / max(count, 1), count


def place_plane(
    pictures: Sequence[Picture],
    voters: Sequence[Bool[np.ndarray, "H W"]],
    normal: Float[np.ndarray, " 3"],
    offset: float,
    span_m: float,
    step_m: float,
    how: Matching,
) -> tuple[float, float]:
    """The offset near ``offset`` at which the voters' pictures agree best (parabola through three), and its score."""
    tried = offset + np.arange(-round(span_m / step_m), round(span_m / step_m) + 1) * step_m
    support = [plane_support(pictures, voters, np.array([*normal, o]), how) for o in tried]
    # Comparisons are lost at a wrong offset, so the mean alone would reward a plane that few pixels still match.
    most = max(count for _, count in support)
    if most < _MIN_VOTERS:
        return offset, float("nan")
    value = np.array([mean * np.sqrt(count / most) for mean, count in support])
    best = int(value.argmax())
    shift = peak_position(value[best - 1 : best + 2]) if 0 < best < len(value) - 1 else 0.0
    return float(tried[best] + shift * step_m), float(support[best][0])


def offset_of_turned_plane(
    pictures: Sequence[Picture],
    voters: Sequence[Bool[np.ndarray, "H W"]],
    plane: Float[np.ndarray, " 4"],
    normal: Float[np.ndarray, " 3"],
    how: Matching,
) -> float:
    """Offset of a plane that is turned to ``normal`` about the middle of the surface that its voters see."""
    per_picture = [
        p.camera.unproject(p.camera.pixel_centres(), p.depth(plane, how))[v] for p, v in zip(pictures, voters)
    ]
    points = np.concatenate(per_picture)
    return float(np.median(points, axis=0) @ normal) if len(points) else float(plane[3])


def most_voted_offsets(
    planes: Float[np.ndarray, "L 4"],
    votes: Integer[np.ndarray, " L"],
    normal: Float[np.ndarray, " 3"],
    beyond: float,
    side: int,
    least_votes: float,
) -> list[float]:
    """Offsets of the most voted planes with this normal on the outer side of ``beyond``, best first.

    Local maxima of the votes of three neighbouring planes, down to a share of the best one's and to ``least_votes``.
    """
    parallel = np.flatnonzero((planes[:, :3] @ normal > 0.999) & (side * (planes[:, 3] - beyond) > 0))
    if not len(parallel):
        return []
    parallel = parallel[np.argsort(planes[parallel, 3], kind="stable")]
    count = votes[parallel].astype(np.float64)
    around = np.convolve(count, np.ones(3), mode="same")
    padded = np.pad(around, 1, constant_values=-1)
    peaks = np.flatnonzero(
        (around > padded[:-2]) & (around >= padded[2:]) & (around >= max(least_votes, _RIVAL_SHARE * around.max()))
    )
    offsets = []
    for peak in peaks[np.argsort(-around[peaks], kind="stable")][:_MAX_RIVALS]:
        span = slice(max(peak - 1, 0), peak + 2)
        offsets.append(float((planes[parallel, 3][span] * count[span]).sum() / count[span].sum()))
    return offsets


def choose_faces(
    pictures: Sequence[Picture],
    votes: Votes,
    bare: RoomBox,
    offsets: Mapping[int, Sequence[float]],
    how: Matching,
) -> dict[int, float]:
    """The offset of each face with which the whole box explains all pixels best; faces that explain nothing lack.

    ``bare`` is the box with its floor, its other faces too far away to match; ``offsets`` are each face's candidates.
    Faces change one by one while the cost falls. No camera sees through a wall: the front of furniture, however many
    pixels vote for it, would hide the floor and the walls that the photos match behind it. A striped wallpaper matches
    itself one period further, but not in a window wide enough for a picture or a door frame.
    """
    wide = replace(how, window=2 * (max(p.camera.wh[0] for p in pictures) // _WIDE_SHARE) + 1)
    rays, every = [p.camera.rays() for p in pictures], range(len(pictures))

    @cache
    def cost(face: int, offset: float) -> list[Float[np.ndarray, "H W"]]:
        plane = np.array([*bare.axes[face // 2], offset])
        best = [best_score(pictures, i, plane, wide) for i in every]
        return [np.where(b > UNKNOWN, _EVEN_SCORE - np.maximum(b, _LEAST_SCORE), 0) for b in best]

    def total(placed: Mapping[int, float]) -> float:
        box, judged = bare.with_faces(placed), {4: float(bare.low_m[2]), **placed}
        return sum(
            float(cost(face, offset)[i][seen == face].sum(dtype=np.float64))
            for i, seen in enumerate(box.intersect(*ray)[1] for ray in rays)
            for face, offset in judged.items()
        )

    def refined(face: int, offset: float) -> float:
        normal = bare.axes[face // 2]
        return place_plane(pictures, votes.voters(normal, offset, 0.1), normal, offset, 0.06, 0.02, how)[0]

    tried = {f: [refined(f, o) for o in near] if len(near) > 1 else near for f, near in offsets.items() if near}
    placed, before = {face: near[0] for face, near in tried.items()}, np.inf
    least = total(placed)
    while least < before:
        before = least
        for face, near in tried.items():
            rest = {other: offset for other, offset in placed.items() if other != face}
            least, placed = min(
                ((total(one), one) for one in (placed, rest, *({**rest, face: o} for o in near))), key=itemgetter(0)
            )
    return placed


def refine_yaw(
    pictures: Sequence[Picture],
    walls: Sequence[tuple[Float[np.ndarray, " 4"], list[Bool[np.ndarray, "H W"]]]],
    span_rad: float,
    step_rad: float,
    how: Matching,
) -> float:
    """Turn (radians) of all walls that matches best; 0 without walls.

    Each wall is a plane with, per picture, the pixels on it; it turns about the middle of its visible part.
    """
    turns = np.arange(-round(span_rad / step_rad), round(span_rad / step_rad) + 1) * step_rad
    value = np.zeros(len(turns))
    for plane, pixels in walls:
        if sum(int(p.sum()) for p in pixels) < _MIN_VOTERS:
            continue
        for k, turn in enumerate(turns):
            c, s = np.cos(turn), np.sin(turn)
            turned = np.array([c * plane[0] - s * plane[1], s * plane[0] + c * plane[1], 0.0])
            mean, count = plane_support(
                pictures, pixels, np.array([*turned, offset_of_turned_plane(pictures, pixels, plane, turned, how)]), how
            )
            value[k] += mean * count
    if not value.any():
        return 0.0
    best = int(value.argmax())
    # A step of 0.1° is 7 mm at 4 m.
    shift = peak_position(value[best - 1 : best + 2]) if 0 < best < len(value) - 1 else 0.0
    return float(turns[best] + shift * step_rad)
