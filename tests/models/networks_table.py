# SPDX-License-Identifier: Apache-2.0
"""The table of networks in docs/networks.md, written from their cards: ``python -m tests.models.networks_table``."""

from __future__ import annotations

from pathlib import Path

from studiorecon.models.catalogue.card import Card
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import CHOICES, POINTS

PAGE = Path(__file__).resolve().parents[2] / "docs/networks.md"
BEGIN, END = "<!-- networks -->\n", "<!-- networks end -->\n"
TRIED = {"random weights": "with random weights", "parts": "its parts alone", "never": "never"}
# Networks that no setting names.
ELSEWHERE = {
    "body model": "`body`",
    "perceptual distance": "`report.lpips`, LPIPS terms of training",
    "canonical avatar": "`humans/PERSON.canonical.ply`, on request; photos in a film's `replace`",
}


def settings_of(card: Card) -> str:
    """The settings that name a network."""
    found = [f"`{where}`" for where, choice in CHOICES.items() if card.name in choice.networks]
    found += [f"`{POINTS}`"] if card.kind == "point detector" else []
    return ", ".join(found) or ELSEWHERE[card.kind]


def table() -> str:
    """The table as Markdown, a row per card."""
    head = ("network", "setting", "code", "weights", "commercial use", "ran here", "not checked here")
    rows = [head, ("---",) * len(head)]
    for card in MODELS.values():
        terms = card.terms
        gate = ", gated: request access" if any(file.gated for file in card.weights) else ""
        condition = f": {terms.condition}" if terms.condition else ""
        allowed = terms.commercial + condition
        rows.append(
            (
                f"{card.title}, `{card.name}`",
                settings_of(card),
                terms.code,
                terms.weights + gate,
                allowed,
                TRIED[card.tried],
                card.unchecked,
            )
        )
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def written(text: str) -> str:
    """``text`` with the table between its marks renewed; ValueError when it has no marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"docs/networks.md has no {BEGIN.strip()} … {END.strip()}")
    return before + begin + table() + end + after


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
