# SPDX-License-Identifier: Apache-2.0
"""The pose of a board before one camera, over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.board.corners import Corners
from studiorecon.board.lens import FirstLens
from studiorecon.board.pattern import Board
from studiorecon.geometry.rotations import exp, from_quaternion, to_quaternion

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# A plane has two poses that look nearly alike; the better one counts if the other's error is this many times larger.
_AMBIGUOUS = 1.5
# Pictures further apart than this many steps are not interpolated: the board was out of sight in between.
_MAX_STEPS = 2.5


@dataclass(frozen=True)
class BoardTrack:
    """Poses of the board before a camera.

    Attributes:
        times_s: on the film's own time line, ascending.
        rotations, places_m: camera from board.
        pixels: corners as found; NaN where not seen.
        gap_s: pictures that are no further apart are interpolated.
    """

    times_s: Num[np.ndarray, " T"]
    rotations: Num[np.ndarray, "T 3 3"]
    places_m: Num[np.ndarray, "T 3"]
    pixels: Num[np.ndarray, "T N 2"]
    gap_s: float

    def neighbours(
        self, times_s: Num[np.ndarray, " ..."]
    ) -> tuple[Num[np.ndarray, " ..."], Num[np.ndarray, " ..."], Bool[np.ndarray, " ..."]]:
        """Index of the picture before each time, the share of the way to the next, and whether both are near."""
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, max(len(self.times_s) - 2, 0))
        after = np.minimum(before + 1, len(self.times_s) - 1)
        gap = self.times_s[after] - self.times_s[before]
        share = (times_s - self.times_s[before]) / np.where(gap > 0, gap, 1.0)
        exact = (np.abs(share) < 1e-6) | (np.abs(share - 1) < 1e-6)
        inside = (share > -1e-6) & (share < 1 + 1e-6)
        return before, np.clip(share, 0.0, 1.0), inside & (exact | ((gap > 0) & (gap <= self.gap_s)))

    def rotations_at(self, times_s: Num[np.ndarray, " ..."]) -> Num[np.ndarray, "... 3 3"]:
        """Rotations between pictures; NaN where the board was not seen."""
        before, share, near = self.neighbours(times_s)
        q = to_quaternion(self.rotations)
        one, two = q[before], q[np.minimum(before + 1, len(q) - 1)]
        two = np.where((one * two).sum(-1, keepdims=True) < 0, -two, two)
        mixed = (1 - share)[..., None] * one + share[..., None] * two
        turned = from_quaternion(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))
        return np.where(near[..., None, None], turned, np.nan)

    def pixels_at(self, times_s: Num[np.ndarray, " K"]) -> Num[np.ndarray, "K N 2"]:
        """The corners between pictures; NaN where not seen in both."""
        before, share, near = self.neighbours(times_s)
        one, two = self.pixels[before], self.pixels[np.minimum(before + 1, len(self.pixels) - 1)]
        weight = share[:, None, None]
        mixed = np.where(weight < 1e-6, one, np.where(weight > 1 - 1e-6, two, (1 - weight) * one + weight * two))
        return np.where(near[:, None, None], mixed, np.nan)

    def speed_at(self, times_s: Num[np.ndarray, " K"]) -> Num[np.ndarray, "K N 2"]:
        """Speed of the corners in pixels per second; NaN where not seen in neighbouring pictures."""
        before, _, near = self.neighbours(times_s)
        first, last = np.maximum(before - 1, 0), np.minimum(before + 1, len(self.pixels) - 1)
        gap = self.times_s[last] - self.times_s[first]
        near &= (gap > 0) & (gap <= 2 * self.gap_s)
        moved = (self.pixels[last] - self.pixels[first]) / np.where(gap > 0, gap, 1.0)[:, None, None]
        return np.where(near[:, None, None], moved, np.nan)


def board_track(seen: Corners, lens: FirstLens, board: Board) -> BoardTrack:
    """The poses of the board in those pictures of ``seen`` where they are unique."""
    ideal = lens.undistorted(seen.pixels)
    kept, rotations, places = [], [], []
    for index, view in enumerate(ideal):
        there = np.isfinite(view[:, 0])
        found = cv2.solvePnPGeneric(board.corners_m[there], view[there, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not found[0]:
            continue
        errors = np.ravel(found[3])
        if len(errors) > 1 and errors[1] < _AMBIGUOUS * max(errors[0], lens.sigma_px / lens.intrinsics[0, 0]):
            continue
        turn, place = cv2.solvePnPRefineLM(
            board.corners_m[there], view[there, None], np.eye(3), None, found[1][0], found[2][0]
        )
        kept.append(index)
        rotations.append(exp(np.ravel(turn)))
        places.append(np.ravel(place))
    gap_s = _MAX_STEPS * seen.step_s
    return BoardTrack(
        seen.times_s[kept],
        np.reshape(rotations, (-1, 3, 3)),
        np.reshape(places, (-1, 3)),
        seen.pixels[kept],
        gap_s,
    )
