# SPDX-License-Identifier: Apache-2.0
"""The room of a planned rig: an upright box with a stage in it, and a person in the way."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# People keep this far from walls, where cameras are, but use at least half of a small room.
_MARGIN_M = 0.75
# Heights at which people are evaluated: ankles, hips, head.
FEET_M, HIPS_M, HEAD_M = 0.1, 1.0, 1.65
# A person in the way: a cylinder about as wide as shoulders seen from all sides.
WIDTH_M, TALL_M = 0.44, 1.75
_STEP_M = 0.3
_WALL_STEP_M = 0.35
# For cameras in an unmeasured room: assumed distance of its walls behind them, and least height of its ceiling.
_BEHIND_M, _CEILING_M = 0.3, 2.5


@dataclass(frozen=True)
class Room:
    """An upright box between two opposite corners, metres; the floor is at z = low_m[2]."""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    @property
    def size_m(self) -> Float[np.ndarray, " 3"]:
        """Width, depth and height."""
        return np.subtract(self.high_m, self.low_m)

    @property
    def middle_m(self) -> Float[np.ndarray, " 2"]:
        """Middle of the floor."""
        return np.add(self.low_m, self.high_m)[:2] / 2

    def stage_m(self) -> Float[np.ndarray, "N 2"]:
        """Positions of people on the floor, on a grid that is symmetric about the middle."""
        half = self.size_m[:2] / 2
        reach = np.maximum(half - _MARGIN_M, half / 2)
        across = [np.linspace(-r, r, max(2 * round(r / _STEP_M) + 1, 3)) for r in reach]
        return self.middle_m + np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, 2)

    def at_height(self, height_m: float) -> Float[np.ndarray, "N 3"]:
        """The stage's positions at a height above the floor."""
        stage = self.stage_m()
        return np.column_stack([stage, np.full(len(stage), self.low_m[2] + height_m)])

    def bystanders_m(self) -> Float[np.ndarray, "K 2"]:
        """Positions of a person in the way: the stage's middle and half-way to its corners."""
        reach = self.stage_m().max(axis=0) - self.middle_m
        return self.middle_m + np.array([(0, 0), (1, 1), (-1, 1), (-1, -1), (1, -1)]) * reach / 2

    def surfaces_m(self) -> dict[str, Float[np.ndarray, "M 3"]]:
        """Points of equal area each on "floor", "walls" and "ceiling"."""
        x, y, z = (
            low + (np.arange(count) + 0.5) * (high - low) / count
            for low, high in zip(self.low_m, self.high_m)
            for count in [max(round((high - low) / _WALL_STEP_M), 2)]
        )
        flat = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        walls = [
            np.stack(np.meshgrid([at], y, z, indexing="ij"), axis=-1).reshape(-1, 3)
            for at in (self.low_m[0], self.high_m[0])
        ]
        walls += [
            np.stack(np.meshgrid(x, [at], z, indexing="ij"), axis=-1).reshape(-1, 3)
            for at in (self.low_m[1], self.high_m[1])
        ]
        return {
            "floor": np.column_stack([flat, np.full(len(flat), self.low_m[2])]),
            "walls": np.concatenate(walls),
            "ceiling": np.column_stack([flat, np.full(len(flat), self.high_m[2])]),
        }

    def holds(self, place_m: Float[np.ndarray, " 3"], margin_m: float) -> bool:
        """Whether a position is inside, with a margin to every side."""
        return bool(
            (place_m >= np.add(self.low_m, margin_m)).all() and (place_m <= np.subtract(self.high_m, margin_m)).all()
        )


def read_room(text: str) -> Room:
    """The room of ``6x5x2.8``, metres, one corner of the floor in the origin; raises UserError for other text."""
    found = re.fullmatch(r"([\d.]+)[x×]([\d.]+)[x×]([\d.]+)", text.strip().lower())
    try:
        size = tuple(float(part) for part in found.groups()) if found else ()
    except ValueError:
        size = ()
    if len(size) != 3 or min(size[:2]) < 1 or size[2] < 1.9 or max(size) > 100:
        raise UserError(
            f"the room is {text!r}; write WIDTHxDEPTHxHEIGHT in metres, 6x5x2.8, at "
            "least 1 by 1 and 1.9 high, at most 100"
        )
    return Room((0.0, 0.0, 0.0), size)


def room_about(cameras: Sequence[Camera]) -> Room:
    """The room assumed around cameras: the box of their positions with a margin, its floor at z = 0."""
    centres = np.array([camera.centre_m for camera in cameras])
    low, high = centres.min(axis=0) - _BEHIND_M, centres.max(axis=0) + _BEHIND_M
    # Cameras in a row do not determine the depth of their room: it is set to their width.
    across = (high - low)[:2].max()
    for axis in (0, 1):
        if high[axis] - low[axis] < across / 2:
            ahead = np.mean([camera.forward[axis] for camera in cameras])
            low[axis], high[axis] = (low[axis], low[axis] + across) if ahead > 0 else (high[axis] - across, high[axis])
    return Room((float(low[0]), float(low[1]), 0.0), (float(high[0]), float(high[1]), max(float(high[2]), _CEILING_M)))


def is_blocked(
    eyes_m: Float[np.ndarray, "V 3"],
    points_m: Float[np.ndarray, "N 3"],
    person_m: Float[np.ndarray, " 2"],
    floor_m: float,
) -> Bool[np.ndarray, "V N"]:
    """Whether a person at (x, y) ``person_m`` hides the point from the eye.

    The person is a cylinder, intersected with each line of sight exactly.
    """
    start = (eyes_m[:, :2] - person_m)[:, None]
    along = (points_m[None, :, :2] - eyes_m[:, None, :2]).astype(np.float64)
    a, b = (along**2).sum(-1), (along * start).sum(-1)
    c = (start**2).sum(-1) - (WIDTH_M / 2) ** 2
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    safe = np.where(a > 1e-12, a, 1.0)
    enter, leave = np.clip((-b - root) / safe, 0, 1), np.clip((-b + root) / safe, 0, 1)
    rise = points_m[None, :, 2] - eyes_m[:, None, 2]
    lowest = eyes_m[:, None, 2] - floor_m + np.minimum(rise * enter, rise * leave)
    return (b * b > a * c) & (leave > enter) & (lowest < TALL_M) & (a > 1e-12)
