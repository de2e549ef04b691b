# SPDX-License-Identifier: Apache-2.0
"""Maps numbers in keypoint files to frames of the film: the first number and the step.

Numbers count frames from 0, 1 or another number, or they are times in thousandths, millionths or billionths of a
second. Where the film's length does not decide, its pictures do (``keypoints.motion_agreement``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Integer

_TIMES = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
# Headers and decoders may differ by so many frames at a film's end.
_LOOSE_FRAMES = 2
# A step between times may differ from a whole number of frames by this share of a frame: milliseconds are rounded.
_STEP_OFF = 0.15
_MAX_STRIDE = 10
# At most so many first numbers are compared with the pictures: those around the likeliest.
_MAX_FIRSTS = 60


@dataclass(frozen=True)
class Numbering:
    """One way in which numbers count a film's frames.

    Attributes:
        frame_of: frame of every picture; below 0 or beyond the film where it has no such frame.
        first: the number of the film's first frame.
        words: how the numbers are read, for messages; "" where they count from 0, or as the user configured.
    """

    frame_of: Integer[np.ndarray, " P"]
    first: int
    words: str = ""


@dataclass(frozen=True)
class Numberings:
    """The possible numberings of a film's keypoints, the likeliest first; ``certain``: the length leaves only that.

    ``is_plausible``: whether it may be used, with a sentence, where the pictures do not decide.
    """

    possible: tuple[Numbering, ...]
    certain: bool
    is_plausible: bool = True


def possible_numberings(
    pictures: Integer[np.ndarray, " P"], frames: int, fps: float, given: int | None, counted: bool
) -> Numberings:
    """The ways in which ``pictures`` (numbers, ascending) may count a film's ``frames``.

    ``given``: the number of the film's first frame by the configuration; ``counted``: the format counts frames from 0.
    """
    if not len(pictures):
        return Numberings((_counted(pictures, given or 0),), True)
    low, high = int(pictures[0]), int(pictures[-1])
    times = list(_as_times(pictures, frames, fps, given))
    if given is not None:
        return Numberings((replace((*times, _counted(pictures, given))[0], words=""),), True)
    if counted:
        return Numberings((_counted(pictures, 0), *_strided(pictures, frames)), True)
    if len(pictures) == frames:
        in_order = np.arange(frames)
        words = "" if low == 0 and high == frames - 1 else f"its {frames} pictures, in order, are the film's frames"
        if high - low == frames - 1 or len(np.unique(np.diff(pictures))) == 1 or times:
            return Numberings((Numbering(in_order, low, words),), True)
    if times:
        return Numberings(tuple(times), len(times) == 1)
    if high < frames + (_LOOSE_FRAMES if low == 0 else 0):
        others = [_counted(pictures, 1)] if low == 1 else []
        return Numberings((_counted(pictures, 0), *others, *_strided(pictures, frames)), not others)
    if high - low >= frames:
        return Numberings((_counted(pictures, 0), *_strided(pictures, frames)), False)
    firsts = list(range(low, max(high - frames, low - _MAX_FIRSTS), -1))
    likely = [1] if 1 in firsts else []
    ordered = [*likely, *(first for first in firsts if first not in likely)]
    return Numberings(tuple(_counted(pictures, first) for first in ordered), len(firsts) == 1, bool(likely))


def _counted(pictures: np.ndarray, first: int) -> Numbering:
    words = "" if first == 0 else f"number {first} is the film's first frame"
    return Numbering(pictures - first, first, words)


def _as_times(pictures: np.ndarray, frames: int, fps: float, given: int | None) -> Iterator[Numbering]:
    """Numberings as times since the film's start, and since another time."""
    low, high = int(pictures[0]), int(pictures[-1])
    if high - low < frames or len(pictures) < 2:
        return
    for name, unit in _TIMES.items():
        per_frame = unit / fps
        steps = np.diff(pictures) / per_frame
        stride = float(np.median(steps))
        if (high - low) / per_frame > frames - 0.5 or round(stride) < 1 or abs(stride - round(stride)) > _STEP_OFF:
            continue
        since_first = Numbering(
            np.round((pictures - low) / per_frame).astype(np.int64), low, f"numbers are {name} since picture {low}"
        )
        if given is not None:
            yield Numbering(
                np.round((pictures - given) / per_frame).astype(np.int64), given, f"numbers are {name} since {given}"
            )
            return
        if high / per_frame <= frames - 0.5:
            words = f"numbers are {name} since the film's beginning"
            yield Numbering(np.round(pictures / per_frame).astype(np.int64), 0, words)
            if low < 0.5 * per_frame:
                return
        yield since_first
        return


def _strided(pictures: np.ndarray, frames: int) -> Iterator[Numbering]:
    """Numberings of every n-th frame, or of a film of n times as many frames."""
    count = int(pictures[-1]) + 1
    for stride in range(2, _MAX_STRIDE + 1):
        if abs(count * stride - frames) <= stride and count > 1:
            yield Numbering(pictures * stride, 0, f"its {count} pictures are every {stride}th frame of the film")
        if abs(frames * stride - count) <= stride:
            kept = np.where(pictures % stride == 0, pictures // stride, -1)
            yield Numbering(kept, 0, f"the film shows every {stride}th of its {count} pictures")
