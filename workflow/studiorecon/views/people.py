# SPDX-License-Identifier: Apache-2.0
"""``views.people``: masks of people in a generated film by the network for people's masks: the paper's M.

Writes ``views/<segment>.people.mkv`` (FFV1 grey, the film's size): 255 for any person.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.models.catalogue.registry import find_card as card_of
from studiorecon.models.loading import load
from studiorecon.progress import progress, say
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Integer


def person_mask(
    maps: Iterable[Integer[np.ndarray, "H W"]], shares: list[float]
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """255 where a label map has a person; ``shares`` receives the share of such pixels."""
    for labels in maps:
        people = labels > 0
        shares.append(float(people.mean()))
        yield np.where(people, 255, 0).astype(np.uint8)


def run(segment: str, film: Path, network: str, chunk: int, weights: Place, device: str, people: Written) -> None:
    """Write the masks of people in the ``film`` of one gap by ``network``, ``chunk`` pictures at once."""
    segmenter = load("person segmenter", network, weights, device, chunk=chunk, prompt="person")
    shares: list[float] = []
    pictures = progress(read_frames(film), f"views of segment {segment}")
    write_lossless(people, person_mask(segmenter.segment(pictures), shares), 24.0)
    say(f"segment {segment}: {card_of(network).title} sees people in {np.mean(shares):.1%} of {len(shares)} views")
