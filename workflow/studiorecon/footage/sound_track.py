# SPDX-License-Identifier: Apache-2.0
"""Reads the sound of a film's file, on the time line of its frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from studiorecon.footage.container import open_container

if TYPE_CHECKING:
    from jaxtyping import Float

RATE_HZ = 8000
"""Of all sound here: twice the highest frequency that speech and claps need."""


def read_sound(path: Path) -> Float[np.ndarray, " N"] | None:
    """Float32 mono samples at ``RATE_HZ`` from time 0 of the file's own time line; None without sound.

    From the first sound track that can be decoded, up to its first damaged place.
    """
    if path.is_dir():
        return None
    try:
        with open_container(path) as container:
            tracks = [n for n, stream in enumerate(container.streams.audio) if stream.codec_context is not None]
    except (av.FFmpegError, ValueError):
        return None
    return next((samples for track in tracks if (samples := _samples(path, track)) is not None), None)


def _samples(path: Path, track: int) -> np.ndarray | None:
    pieces: list[np.ndarray] = []
    first_s = 0.0
    try:
        with open_container(path) as container:
            resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE_HZ)
            for frame in container.decode(container.streams.audio[track]):
                first_s = first_s if pieces else float(frame.time or 0.0)
                pieces += [piece.to_ndarray().reshape(-1) for piece in resampler.resample(frame)]
            pieces += [piece.to_ndarray().reshape(-1) for piece in resampler.resample(None)]
    except (av.FFmpegError, ValueError, IndexError):
        pass  # sound up to a damaged place is as good as all of it
    samples = np.concatenate(pieces) if pieces else np.zeros(0, np.float32)
    if not len(samples):
        return None
    begin = round(first_s * RATE_HZ)
    return np.concatenate([np.zeros(begin, np.float32), samples]) if begin >= 0 else samples[-begin:]
