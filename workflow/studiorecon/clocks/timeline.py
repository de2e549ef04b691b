# SPDX-License-Identifier: Apache-2.0
"""Times of a footage's frames by the camera's own clock, and the moments that all cameras share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.footage.source import FootageSource
from studiorecon.footage.timing import EVEN_S
from studiorecon.scene.clocks import Clock, Clocks

# Moments within this much of a frame before or after a camera's first or last one still belong to it.
_REACH_FRAMES = 0.5 + 1e-3


@dataclass(frozen=True)
class Timeline:
    """Frames of a file on the file's own time line, which its sound shares.

    Attributes:
        fps: frames per second.
        frames: number of frames.
        first_s: time of the first one.
        times_s: of every frame after the first, where they are uneven; else empty.
    """

    fps: float
    frames: int
    first_s: float
    times_s: tuple[float, ...] = ()


def read_timeline(source: FootageSource) -> Timeline:
    """The timeline of ``source``; times are left out where its rate gives the same."""
    if not source.times_s:
        return Timeline(source.fps, source.frames, 0.0)
    own = np.array(source.times_s) - source.times_s[0]
    even = np.abs(own - np.arange(len(own)) / source.fps).max() <= EVEN_S
    return Timeline(source.fps, source.frames, source.times_s[0], () if even else tuple(own.tolist()))


def clock_as_filmed(camera: str, line: Timeline) -> Clock:
    """The clock of a camera as filmed: its first frame is at 0."""
    return Clock(camera, line.fps, line.frames, line.times_s)


def common_moments(clocks: Sequence[Clock], first: int, count: int) -> Clocks:
    """The moments that all ``clocks`` have in common, from the ``first`` of them on, ``count`` of them (0: all).

    Their rate is the most frequent one of cameras with even frames, or the slower of two. They are the frame times of
    the camera to which all others are nearest, so that as few frames as possible are resampled. ``refusal``: why there
    is no such moment.
    """
    rates = sorted(round(c.fps, 4) for c in clocks if not c.times_s) or sorted(round(c.fps, 4) for c in clocks)
    usual = max(rates, key=lambda rate: (rates.count(rate), -rate))
    fps = next(c.fps for c in clocks if round(c.fps, 4) == usual)
    begin = max(float(c.common_s[0]) for c in clocks) - _REACH_FRAMES / fps
    end = min(float(c.common_s[-1]) for c in clocks) + _REACH_FRAMES / fps
    tried = []
    for rank, clock in enumerate(clocks):
        later = clock.common_s[clock.common_s >= begin]
        if not len(later):
            continue
        whole = Clocks(fps, float(later[0]), max(0, int(np.floor((end - later[0]) * fps)) + 1), tuple(clocks))
        if whole.frames:
            tried.append(
                (round(sum(float(np.abs(whole.late_frames(c.camera)).mean()) for c in clocks), 6), rank, whole)
            )
    if not tried:
        gap = (
            max((float(c.common_s[0]), c.camera) for c in clocks),
            min((float(c.common_s[-1]), c.camera) for c in clocks),
        )
        nothing = (
            f"camera {gap[0][1]} begins {gap[0][0] - gap[1][0]:.1f} s after camera "
            f"{gap[1][1]} has ended: the videos share no moment; "
            "check that they are of one take, or write starts: {CAMERA: frame} into capture.yaml"
        )
        return Clocks(fps, 0.0, 0, tuple(clocks), nothing)
    whole = min(tried, key=lambda t: t[:2])[2]
    left = whole.frames - first
    if left < 1 or count > left:
        wanted = f"{first} to {first + count - 1}" if count else f"{first} and after"
        described = (
            f"the videos have {whole.frames} frames in common, but capture.yaml requests frames "
            f"{wanted}; change frames: in capture.yaml"
        )
        return replace(whole, frames=0, refusal=described)
    return replace(whole, start_s=whole.start_s + first / fps, frames=count or left)
