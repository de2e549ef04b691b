# SPDX-License-Identifier: Apache-2.0
"""``masks.network``: who is where in one camera's frames, by an upstream network, with the network's own numbers for people.

Writes ``masks/<camera>.tracks.mkv`` (FFV1 grey: 0 nobody, else the number). ``masks.segment`` finds out which fitted person each one is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.images.video import read_frames, write_lossless
from studiorecon.models.sam3 import Sam3
from studiorecon.progress import progress, say
from studiorecon.scene.capture import read_footage

_MOST = 254


@dataclass(frozen=True)
class Sam3Settings:
    """How SAM 3 runs: frames per chunk, and the word it looks for."""

    chunk: int
    prompt: str


@dataclass(frozen=True)
class Settings:
    """See config.yaml."""

    sam3: Sam3Settings


def in_bytes(maps: Iterable[np.ndarray], found: set[int]) -> Iterator[np.ndarray]:
    """(H, W) uint8 of label maps; numbers beyond 254 are nobody's, and ``found`` receives all that occurred."""
    for labels in maps:
        found.update(np.unique(labels[labels > 0]).tolist())
        yield np.where(labels <= _MOST, labels, 0).astype(np.uint8)


def run(settings: Settings, camera: str, video: Path, footage: Path, weights: Path, device: str, tracks: Path) -> None:
    """Write the label maps of one camera's working frames."""
    about = read_footage(footage)
    network = Sam3(weights, device, settings.sam3.chunk, settings.sam3.prompt)
    found: set[int] = set()
    frames = progress(read_frames(video), f"frames of {camera}", total=about.frames)
    write_lossless(tracks, in_bytes(network.segment(frames), found), about.fps)
    if not found:
        say(f"camera {camera}: SAM 3 sees no {settings.sam3.prompt} in any frame")
        return
    say(f"camera {camera}: SAM 3 follows {len(found)} people")
    if max(found) > _MOST:
        say(f"camera {camera}: only the first {_MOST} numbers are kept; shorter chunks of a crowd make many")
