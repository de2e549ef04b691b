# SPDX-License-Identifier: Apache-2.0
"""The pages for users have short sentences without worn words, and the glossary stays short.

A help for writers, not the judge: it measures what can be measured and lists every offender with its line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import studiorecon

ROOT = Path(__file__).resolve().parents[2]
# The appendix on the paper quotes it; the code of conduct is not ours.
EXEMPT = {"paper", "readings", "code_of_conduct"}
PAGES = [ROOT / "README.md", ROOT / "config/README.md", *sorted((ROOT / "docs").glob("*.md"))]
# The style asks for 25 words; a hard bound leaves room for a list within a sentence.
MAX_WORDS = 40
MAX_TERMS = 40
MORE_THAN_MAX = re.compile(rf"(?:[^\W_]\S*\W+){{{MAX_WORDS}}}[^\W_]")
OVERUSED = re.compile(r"\b(told|whoever|stood|asked|what is beside|put right|speaks? for|tells? of)\b", re.IGNORECASE)
# A code block, or a table that is generated from the code.
NOT_PROSE = re.compile(r"^```.*?^```|<!-- [\w ]+ -->\n\|.*?<!-- ", re.MULTILINE | re.DOTALL)


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """Line number and text of every sentence; a cell of a table and an entry of a list end one too."""
    text = NOT_PROSE.sub(lambda match: "\n" * match[0].count("\n"), text)
    line = 1
    for block in re.split(r"(\n(?=\s*(?:[-*|#>]|\d+\.)\s)|\n\s*\n)", text):
        for sentence in re.split(r"(?<=[.!?])\s+|\s[·|]\s", block):
            yield line, " ".join(re.sub(r"\]\([^)]*\)|`[^`]*`", " code ", sentence).split())
        line += block.count("\n")


@pytest.mark.parametrize("offence", [MORE_THAN_MAX, OVERUSED], ids=["long sentences", "overused words"])
def test_sentences_of_the_pages_are_plain(offence: re.Pattern[str]) -> None:
    offenders = [
        f"{page.relative_to(ROOT)}:{line}: {sentence}"
        for page in PAGES
        if page.stem not in EXEMPT
        for line, sentence in sentences(page.read_text(encoding="utf-8"))
        if offence.search(sentence)
    ]
    assert not offenders, "\n".join(offenders)


def test_glossary_is_short() -> None:
    terms = (studiorecon.__doc__ or "").partition("Glossary\n--------\n")[2].partition("\n\n")[0].split("\n")
    assert 20 <= len(terms) <= MAX_TERMS
