# SPDX-License-Identifier: Apache-2.0
"""Sorts numbered files by their numbers, 2 before 10, and finds missing numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import islice, pairwise
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.scene.dataset import PICTURE_SUFFIXES

_MAX_NAMED = 3
_MAX_LISTED = 10_000


def natural_sort_key(name: str) -> list[tuple[int, str]]:
    """The sorting key of a name: runs of digits compare as numbers, frame_2 before frame_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder in the order of their numbers, without hidden files; UserError for two of one number."""
    named = (p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith("."))
    found = sorted(named, key=lambda path: (natural_sort_key(path.stem), path.name))
    for one, two in pairwise(found):
        if natural_sort_key(one.stem) == natural_sort_key(two.stem):
            raise UserError(f"{folder} has {one.name} and {two.name} for one picture; keep one")
    return found


def missing_numbers(files: Sequence[Path]) -> list[int]:
    """The numbers missing in a sequence of files between its first and its last.

    The last number in the names that differs counts. Nothing is missing where names are not numbered, or have a
    constant step (every fifth frame).
    """
    parts = [re.split(r"(\d+)", path.stem) for path in files]
    if len(files) < 2 or len({len(part) for part in parts}) > 1:
        return []
    differing = [k for k in range(len(parts[0])) if len({part[k] for part in parts}) > 1]
    if len(differing) != 1 or differing[0] % 2 == 0:
        return []
    numbers = sorted({int(part[differing[0]]) for part in parts})
    steps = [b - a for a, b in pairwise(numbers)]
    step = min(steps, default=1)
    # Names that are times have no constant step, so no number is missing.
    if not steps or any(gap % step for gap in steps) or sum(gap == step for gap in steps) < len(steps) / 2:
        return []
    return list(islice((n for a, b in pairwise(numbers) for n in range(a + step, b, step)), _MAX_LISTED))


def missing_numbers_text(files: Sequence[Path]) -> str:
    """The missing numbers in words (``3, 4, 9 and 5 more``); empty when none is missing."""
    missing = missing_numbers(files)
    more = len(missing) - _MAX_NAMED
    return ", ".join(map(str, missing[:_MAX_NAMED])) + (f" and {more} more" if more > 0 else "")
