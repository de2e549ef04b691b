# SPDX-License-Identifier: Apache-2.0
"""Working videos from any frame on, without decoding everything before it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.video import pixels


def read_frames_from(path: Path, start: int, stop: int) -> Iterator[np.ndarray]:
    """Frames ``start`` … ``stop`` - 1 of a working video, as ``read_frames`` gives them, after a jump to the last key frame before.

    Only for videos this package wrote: their frames lie on a regular grid of times, which is what makes a frame's number known after
    a jump. Raises Refusal naming the file when it is missing, unreadable or ends early.
    """
    if not path.is_file():
        raise Refusal(f"{path} is missing")
    expected = start
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            seconds_per_tick, rate = stream.time_base, stream.average_rate
            container.seek(int(start / rate / seconds_per_tick), stream=stream, backward=True)
            for frame in container.decode(stream):
                number = round(frame.pts * seconds_per_tick * rate)
                if expected == stop:
                    return
                if number < expected:
                    continue
                if number > expected:
                    break
                yield pixels(frame)
                expected += 1
    except (av.FFmpegError, IndexError) as error:
        raise Refusal(f"{path} cannot be read at frame {expected} ({error}); it may be truncated: make it again") from None
    if expected < stop:
        raise Refusal(f"{path} has no frame {expected} where frames up to {stop - 1} are needed; make it again")


def read_frame_at(path: Path, index: int) -> np.ndarray:
    """One frame of a working video."""
    return next(read_frames_from(path, index, index + 1))
