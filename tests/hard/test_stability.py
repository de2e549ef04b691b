# SPDX-License-Identifier: Apache-2.0
"""docs/stability.md: in every case ours stays where it should, and the textbook's formula does not."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tests.hard import stability


@pytest.mark.parametrize("case", stability.CASES, ids=lambda case: case.name)
def test_ours_stays_and_the_textbooks_does_not(case: stability.Case) -> None:
    assert max(abs(case.kept(x)) for x in case.xs) <= case.bar
    assert max(np.nan_to_num(abs(case.textbook(x)), nan=np.inf) for x in case.xs) > 10 * case.bar


def test_the_page_shows_every_case() -> None:
    assert (stability.DOCS / "stability.md").read_text(encoding="utf-8") == stability.page(), (
        "run: python -m tests.hard.stability"
    )
    names = {path.stem for path in (stability.DOCS / "stability").glob("*.svg")}
    assert names == {case.name for case in stability.CASES}
    for case in stability.CASES:
        drawn = ElementTree.fromstring(stability.plot(case))
        assert len(drawn.findall("{http://www.w3.org/2000/svg}polyline")) == 2


def test_every_family_of_hard_cases_is_shown() -> None:
    table = (stability.DOCS / "hard-cases.md").read_text(encoding="utf-8")
    families = set(re.findall(r"^## ([A-Z]): ", table, re.MULTILINE))
    assert families == {letter for case in stability.CASES for letter in re.findall(r"\b([A-Z])\d", case.ids)}
