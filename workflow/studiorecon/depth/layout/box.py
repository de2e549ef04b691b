# SPDX-License-Identifier: Apache-2.0
"""From votes to a room: the most voted wall on each side and its offset to the centimetre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.layout.votes import Votes
from studiorecon.depth.stereo.plates import Picture

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Lower scores belong to other surfaces and would bias the mean that places a plane.
_SAME_SURFACE = 0.2
_MIN_VOTERS = 30
# Walls with this share of the best one's votes are its rivals; the window that decides is a tenth of the picture's
# width.
_RIVAL_SHARE, _MAX_RIVALS = 0.2, 6
_WIDE_SHARE = 20


@dataclass(frozen=True)
class Matching:
    """How planes are compared: window in pixels, weight of the mean difference, depth range in metres."""

    window: int
    mean_weight: float
    near_m: float
    far_m: float


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
            score = picture.score(other, plane, how.window, how.mean_weight, how.near_m, how.far_m)[voters[i]]
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
    shift = 0.0
    if 0 < best < len(value) - 1:
        before, at, after = value[best - 1 : best + 2]
        bend = before - 2 * at + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
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
        p.camera.unproject(p.camera.pixel_centres(), p.depth(plane, how.near_m, how.far_m))[v]
        for p, v in zip(pictures, voters)
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


def choose_face_offset(
    pictures: Sequence[Picture],
    votes: Votes,
    normal: Float[np.ndarray, " 3"],
    offsets: Sequence[float],
    beyond: float,
    side: int,
    how: Matching,
) -> float:
    """The strong wall on one side that best explains the pixels of all candidates, through a wide window.

    A striped wallpaper correlates with itself one period further, and gathers votes there; in a window wide enough for
    a picture or a door frame it no longer does. Neither the most voted nor the outermost plane is reliable.
    """
    if len(offsets) == 1:
        return offsets[0]
    rivals = (votes.planes[:, :3] @ normal > 0.999) & (side * (votes.planes[:, 3] - beyond) > 0)
    pixels = [m & rivals[c] for c, m in zip(votes.chosen, votes.confident)]
    wide = 2 * (max(p.camera.wh[0] for p in pictures) // _WIDE_SHARE) + 1
    explained = []
    for k, offset in enumerate(offsets):
        voters = votes.voters(normal, offset, 0.1)
        offsets = [*offsets[:k], place_plane(pictures, voters, normal, offset, 0.06, 0.02, how)[0], *offsets[k + 1 :]]
        plane, total = np.array([*normal, offsets[k]]), 0.0
        for i, picture in enumerate(pictures):
            others = [
                picture.score(o, plane, wide, how.mean_weight, how.near_m, how.far_m)
                for j, o in enumerate(pictures)
                if j != i
            ]
            total += float(np.clip(np.max(others, axis=0)[pixels[i]], 0, 1).sum(dtype=np.float64))
        explained.append(total)
    return offsets[int(np.argmax(explained))]


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
    return float(turns[int(value.argmax())]) if value.any() else 0.0
