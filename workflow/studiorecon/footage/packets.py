# SPDX-License-Identifier: Apache-2.0
"""How many frames some footage has, and when each is shown, from the packets of its file: nothing is decoded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.container import opened
from studiorecon.footage.source import FootageSource
from studiorecon.machine.refusals import without_thread

if TYPE_CHECKING:
    from jaxtyping import Num


def shown_s(path: Path) -> Num[np.ndarray, " T"]:
    """(T,) times of all frames that a decoder will give, in order; NaN where the file says none.

    Raises UserError naming the file when its packets cannot be read.
    """
    try:
        with opened(path) as container:
            stream = container.streams.video[0]
            base_s = stream.time_base
            times = [
                np.nan if packet.pts is None or base_s is None else float(packet.pts * base_s)
                for packet in container.demux(stream)
                if packet.size and not packet.is_discard
            ]
    except av.FFmpegError as error:
        if without_thread(error):
            raise
        raise UserError(f"{path} cannot be read as a video ({error.strerror or error}); copy it again") from None
    return np.sort(np.array(times, dtype=np.float64))


def frame_count(source: FootageSource) -> int:
    """How many frames ``source`` has: as its header or its listing says, else as many as there are packets.

    What was streamed, or cut off while it was recorded, announces no number. Raises UserError as ``shown_s`` does.
    """
    return len(shown_s(source.path)) if source.declared_frames is None else source.declared_frames
