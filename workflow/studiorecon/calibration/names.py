# SPDX-License-Identifier: Apache-2.0
"""Which camera of a calibration belongs to which video."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from studiorecon.errors import UserError
from studiorecon.scene.numbered import natural


def match_names(footage: Sequence[str], calibrated: Sequence[str], source: str) -> tuple[dict[str, str], str | None]:
    """{footage name: calibrated name} for every footage name, and a sentence when the names were not simply equal.

    Tried in order, each only if it pairs every video with exactly one camera: equal; equal but for case; the video's
    name as a part of the calibration's (``int_cam01_img``); the same digits without leading zeros (``0`` and
    ``cam_00``). Raises UserError with both lists when none does: the calibration is for other cameras.
    """
    rules: list[tuple[str, Callable[[str, str], bool]]] = [
        ("", lambda f, c: f == c),
        ("apart from upper and lower case", lambda f, c: f.casefold() == c.casefold()),
        ("as a part of the calibration's name", lambda f, c: f.casefold() in _parts(c)),
        ("by their numbers", lambda f, c: _number(f) is not None and _number(f) == _number(c)),
    ]
    for how, same in rules:
        pairs = {f: [c for c in calibrated if same(f, c)] for f in footage}
        found = {f: c[0] for f, c in pairs.items() if len(c) == 1}
        if len(found) == len(footage) == len(set(found.values())):
            note = (
                None
                if not how
                else f"videos and cameras of {source} were paired {how}: "
                + ", ".join(f"{f} = {c}" for f, c in found.items())
            )
            return found, note
    raise UserError(
        f"{source} is a calibration for other cameras: it has "
        f"{', '.join(calibrated) or 'none'}, the footage has {', '.join(footage)}; "
        "rename the videos, or name the right file in capture.yaml: calibration: FILE"
    )


def match_in_order(footage: Sequence[str], count: int, source: str) -> tuple[dict[str, str], str]:
    """{footage name: number} for a calibration of ``count`` cameras without names: the sorted videos in its order.

    Numbers sort as numbers (cam2 before cam10). Raises UserError when the counts differ, since then nobody knows which
    is missing.
    """
    if len(footage) != count:
        raise UserError(
            f"{source} has {count} cameras without names, the footage has {len(footage)} ({', '.join(footage)}); "
            "bring all videos of the capture, or a calibration with names"
        )
    ordered = sorted(footage, key=natural)
    return (
        {name: str(index) for index, name in enumerate(ordered)},
        f"{source} has no camera names: its cameras were taken in the order {', '.join(ordered)}",
    )


def _parts(name: str) -> set[str]:
    """All runs of whole words of a name, so that cam01 is a part of int_cam01_img but cam0 is not."""
    words = re.findall(r"[^_\-. ]+|[_\-. ]+", name.casefold())
    return {"".join(words[i:j]) for i in range(len(words)) for j in range(i + 1, len(words) + 1)}


def _number(name: str) -> int | None:
    """The only number in a name (cam_00 → 0); None when there is none or more than one."""
    numbers = re.findall(r"\d+", name)
    return int(numbers[0]) if len(numbers) == 1 else None
