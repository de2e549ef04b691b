# SPDX-License-Identifier: Apache-2.0
"""``masks.network``: people in one camera's frames by an upstream network, with the network's own numbers for people.

Writes ``masks/<camera>.tracks.mkv`` (FFV1 grey: 0 no person, else the number). ``masks.segment`` matches each to a
fitted person.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.models.catalogue.registry import find_card as card_of
from studiorecon.models.choices import MaskSource
from studiorecon.models.loading import load
from studiorecon.progress import progress, say
from studiorecon.scene.capture import read_footage
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Integer

_MAX = 254


@dataclass(frozen=True)
class Sam3Settings:
    """Settings of SAM 3: frames per chunk, and its text prompt."""

    chunk: int = setting(200, "Frames per call; memory grows with them.", minimum=1)
    prompt: str = "person"


@dataclass(frozen=True)
class Settings:
    """Which network, and its settings."""

    source: MaskSource = setting(
        "embedded",
        "embedded (plate difference and bodies), sam3, or precomputed; masks in the dataset take precedence.",
        paper="sam3",
        paper_value="sam3",
    )
    sam3: Sam3Settings = setting(Sam3Settings(), "How SAM 3 runs.")


def to_uint8_labels(
    maps: Iterable[Integer[np.ndarray, "H W"]], found: set[int]
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """Yields label maps as uint8; numbers beyond 254 become background, and ``found`` collects all that occurred."""
    for labels in maps:
        found.update(np.unique(labels[labels > 0]).tolist())
        yield np.where(labels <= _MAX, labels, 0).astype(np.uint8)


def run(
    settings: Settings, camera: str, video: Path, footage: Path, weights: Place, device: str, tracks: Written
) -> None:
    """Write the label maps of one camera's working frames."""
    about = read_footage(footage)
    network = load("person segmenter", settings.source, weights, device, **asdict(settings.sam3))
    title = card_of(settings.source).title
    found: set[int] = set()
    frames = progress(read_frames(video), f"frames of {camera}", total=about.frames)
    write_lossless(tracks, to_uint8_labels(network.segment(frames), found), about.fps)
    if not found:
        say(f"camera {camera}: {title} sees no {settings.sam3.prompt} in any frame")
        return
    say(f"camera {camera}: {title} follows {len(found)} people")
    if max(found) > _MAX:
        say(f"camera {camera}: only the first {_MAX} numbers are kept; use longer chunks (masks.sam3.chunk)")
