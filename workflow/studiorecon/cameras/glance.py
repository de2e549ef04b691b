# SPDX-License-Identifier: Apache-2.0
"""A few pictures and the header of a video, without decoding it: the doctor looks before anything is read in full."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.scene.dataset import PICTURE_SUFFIXES

_LIGHT = 250


@dataclass(frozen=True)
class Glance:
    """What a look at some footage shows.

    Attributes:
        pictures: (H, W, 3) uint8 RGB, upright, one per wanted frame.
        fps: pictures per second, 0 for a folder of pictures.
        frames: how many there are, by the header.
        rotation_deg: the rotation tag that was applied.
    """

    pictures: tuple[np.ndarray, ...]
    fps: float
    frames: int
    rotation_deg: int

    @property
    def wh(self) -> tuple[int, int]:
        return self.pictures[0].shape[1], self.pictures[0].shape[0]

    @property
    def brightness(self) -> float:
        """Mean grey, 0..1."""
        return float(np.mean([p[::4, ::4].mean() for p in self.pictures]) / 255)

    @property
    def burnt(self) -> float:
        """Share of pixels that are white in all channels."""
        return float(np.mean([(p[::4, ::4].min(-1) >= _LIGHT).mean() for p in self.pictures]))


def glance(source: Path, wanted: Sequence[int]) -> Glance:
    """The frames ``wanted`` (ascending; beyond the end: the last one that can be read) of a video or a folder of pictures.

    A video is sought to the key frame before each, so a frame costs at most one group of pictures. Raises Refusal when
    nothing can be read.
    """
    return _of_folder(source, wanted) if source.is_dir() else _of_video(source, wanted)


def _of_folder(source: Path, wanted: Sequence[int]) -> Glance:
    files = sorted(p for p in source.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith("."))
    pictures = [cv2.imread(str(files[min(i, len(files) - 1)])) for i in wanted] if files else []
    if not pictures or any(p is None for p in pictures):
        raise Refusal(f"{source} holds no readable picture; copy it again")
    return Glance(tuple(np.ascontiguousarray(p[..., ::-1]) for p in pictures), 0.0, len(files), 0)


def _of_video(source: Path, wanted: Sequence[int]) -> Glance:
    try:
        with av.open(str(source)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            fps = float(stream.average_rate or 0)
            seconds = float(stream.duration * stream.time_base) if stream.duration else (container.duration or 0) / av.time_base
            frames = stream.frames or round(seconds * fps)
            found = [_frame_at(container, stream, index, fps) for index in wanted]
    except (av.FFmpegError, IndexError) as error:
        raise Refusal(f"{source} cannot be read as a video ({error}); copy it again") from None
    if any(f is None for f in found):
        raise Refusal(f"{source} holds no readable frame; copy the recording again")
    turn = round(found[0].rotation / 90) * 90 % 360
    pictures = tuple(np.ascontiguousarray(np.rot90(f.to_ndarray(format="rgb24"), turn // 90)) for f in found)
    return Glance(pictures, fps, frames, turn)


def _frame_at(container: av.container.InputContainer, stream: av.VideoStream, index: int, fps: float) -> av.VideoFrame | None:
    """The frame shown at ``index`` / ``fps``, or the last one before the footage ends."""
    first = stream.start_time or 0
    target = first + (round(index / fps / stream.time_base) if fps else 0)
    half = 0.5 / fps / float(stream.time_base) if fps else 0.0
    container.seek(target, stream=stream, backward=True)
    last = None
    for frame in container.decode(stream):
        last = frame
        if frame.pts is None or frame.pts >= target - half:
            break
    return last
