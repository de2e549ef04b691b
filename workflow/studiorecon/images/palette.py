# SPDX-License-Identifier: Apache-2.0
"""Colours of people in pictures and films, safe for colour-blind readers (Okabe and Ito), and grey for nobody."""

from __future__ import annotations

UNASSIGNED = 255
"""Label of a mask's pixels that show somebody or something else; people are 1, 2, …, the background is 0."""
NOBODY = (160, 160, 160)
_PEOPLE = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167))


def person_colour(index: int) -> tuple[int, int, int]:
    """8-bit RGB of the person with this index; the eighth has the first one's again."""
    return _PEOPLE[index % len(_PEOPLE)]
