# SPDX-License-Identifier: Apache-2.0
"""Frames in which a person is present: measured ones, a short margin, and gaps in which a camera sees them at times.

A person who walks in at the third second was not present before, and one who comes back after ten did not glide across
the room meanwhile. All limits are seconds, so that any frame rate gives the same result.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Margin around measured frames: a detector that is a few frames late must not make people blink.
STAYS_S = 0.5
# A person whom no camera sees for longer than this is away.
UNSEEN_S = 2.0
# Times of frames are not exact: 0.5 s are 15 frames at 30 per second.
_EXACT_S = 1e-9


def presence(measured: Bool[np.ndarray, " T"], seen: Bool[np.ndarray, " T"], fps: float) -> Bool[np.ndarray, " T"]:
    """Frames in which a person is present, from frames with a ``measured`` body and frames ``seen`` by any camera.

    They are present up to ``STAYS_S`` before and after every measured frame. A gap between two is bridged if no stretch
    of it without a sighting is longer than ``UNSEEN_S``. Otherwise they are away in all of it but those margins, since
    a pose interpolated so far is no longer theirs. One camera's sightings before the first measured frame, or after the
    last, do not count: they do not determine a position. Raises ValueError for other shapes, and a frame rate that is
    not positive.
    """
    sizes = require("measured", measured, ("T",))
    require("seen", seen, ("T",), sizes)
    if not fps > 0:
        raise ValueError(f"fps must be positive, not {fps}")
    at = np.flatnonzero(measured)
    there = np.zeros(len(measured), bool)
    if not len(at):
        return there
    stays = int(np.floor(STAYS_S * fps + _EXACT_S))
    for frame in at:
        there[max(frame - stays, 0) : frame + stays + 1] = True
    known = np.flatnonzero(measured | seen)
    for first, last in pairwise(at):
        if last == first + 1:
            continue
        between = known[(known >= first) & (known <= last)]
        if np.diff(between).max() <= UNSEEN_S * fps + _EXACT_S:
            there[first:last] = True
    return there


def true_runs(chosen: Bool[np.ndarray, " T"]) -> list[tuple[int, int]]:
    """(first, last) of every stretch of True."""
    at = np.flatnonzero(chosen)
    parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
    return [(int(part[0]), int(part[-1])) for part in parts]


def fill_gaps(
    local: Num[np.ndarray, "T J 3 3"],
    trans_m: Num[np.ndarray, "T 3"],
    measured: Bool[np.ndarray, " T"],
    there: Bool[np.ndarray, " T"],
) -> tuple[Num[np.ndarray, "T J 3 3"], Num[np.ndarray, "T 3"]]:
    """Joints' rotations and pelvis positions with frames that were not ``measured`` filled between measured ones.

    Every stretch in which a person is ``there`` is filled separately: before leaving they stop, and do not start
    towards their point of return. Between stretches the pose is interpolated, so that a camera that follows them
    arrives in time. Raises ValueError when no frame is measured, and for other shapes.
    """
    local = np.where(measured[:, None, None, None], local, np.eye(3))
    trans_m = np.where(measured[:, None], trans_m, 0.0)
    for first, last in true_runs(there):
        part = slice(first, last + 1)
        local[part], trans_m[part] = (
            fill_rotations(local[part], measured[part]),
            fill_vectors(trans_m[part], measured[part]),
        )
    return fill_rotations(local, there), fill_vectors(trans_m, there)
