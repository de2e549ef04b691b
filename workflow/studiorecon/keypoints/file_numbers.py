# SPDX-License-Identifier: Apache-2.0
"""Numbers in the names of keypoint files or of pictures: decides which group of digits counts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

from studiorecon.errors import UserError

MAX_NUMBER = 2**63 - 1
"""Nanoseconds since 1970 have 19 digits; more fit no integer."""


def number_names(names: Sequence[str], where: str) -> list[int]:
    """The number of each of ``names`` (without suffixes), from the group of digits that counts pictures.

    That group differs in every name; of several, the one that grows most evenly, and of these the last. A single name
    has the digits before ``_keypoints``, or its last ones. Raises UserError naming ``where`` and the names: without
    digits, with other groups of digits, and where two names have one number.
    """
    groups = [re.findall(r"\d+", name) for name in names]
    if bare := [name for name, found in zip(names, groups) if not found]:
        raise UserError(f"{where}: {bare[0]!r} has no frame number in its name; number the pictures from 0")
    if len(names) == 1:
        before = re.search(r"(\d+)_keypoints", names[0])
        return [_whole(before[1] if before else groups[0][-1], names[0], where)]
    least = min(map(len, groups))
    columns = [[found[k] for found in groups] for k in range(least)]
    if any(len(found) > least for found in groups):
        columns += [[found[k - least] for found in groups] for k in range(least)]
    values = [[_whole(digits, name, where) for digits, name in zip(column, names)] for column in columns]
    counting = [(_unevenness(column), -place, column) for place, column in enumerate(values)
                if len(set(column)) == len(column)]  # fmt: skip
    if not counting:
        last = values[-1]
        first = next(i for i, number in enumerate(last) if last.count(number) > 1)
        second = last.index(last[first], first + 1)
        raise UserError(
            f"{where}: {names[first]!r} and {names[second]!r} are both numbered {last[first]}; keep one per picture, "
            "or number the pictures from 0"
        )
    return min(counting)[2]


def _whole(digits: str, name: str, where: str) -> int:
    if int(digits[:25]) > MAX_NUMBER or len(digits) > 25:
        raise UserError(f"{where}: the number {digits[:25]} in {name!r} is too long; number the pictures from 0")
    return int(digits)


def _unevenness(numbers: Sequence[int]) -> int:
    """How many different steps there are between the sorted numbers."""
    ordered = sorted(numbers)
    return len({after - before for before, after in pairwise(ordered)})
