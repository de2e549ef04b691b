# SPDX-License-Identifier: Apache-2.0
"""The stretches of every film in which people are looked for before the rest: ``clocks/moments.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ListOf, MappingOf, whole
from studiorecon.scene.step_files import read

Stretch = tuple[int, int, int]
"""Number of a stretch of the take, the first frame of a part of it in a film, and the number of its frames."""


def write_moments(path: Path, stretches: Mapping[str, Sequence[Stretch]]) -> None:
    """Write the stretches of every camera's film in the order in which they are looked at."""
    write_json(path, {camera: [list(one) for one in own] for camera, own in stretches.items()})


def read_moments(path: Path, camera: str) -> list[Stretch]:
    """The stretches of one camera's film; raises UserError as ``step_files.read`` does."""
    held: dict[str, list[Stretch]] = read(path, MappingOf(ListOf(whole("3", low=0))))
    return [(number, first, count) for number, first, count in held[camera]]


def unseen(looked: Sequence[tuple[int, int]], first: int, count: int) -> list[tuple[int, int]]:
    """(first, count) of the parts of ``count`` frames from ``first`` on that are in none of ``looked``."""
    found, begin, stop = [], first, first + count
    for one, length in [*sorted(looked), (stop, 0)]:
        if begin < min(one, stop):
            found.append((begin, min(one, stop) - begin))
        begin = max(begin, one + length)
    return found
