# SPDX-License-Identifier: Apache-2.0
"""Tables of the prose that are made from registries: ``python -m tests.layout.registry_tables`` writes them anew.

Each stands between ``<!-- NAME -->`` and ``<!-- end of NAME -->`` in its page.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from studiorecon.calibration import formats
from studiorecon.keypoints import layouts, readers
from studiorecon.survey import effects

ROOT = Path(__file__).resolve().parents[2]
# Page and name of the table → what writes it.
TABLES: dict[tuple[str, str], Callable[[], str]] = {
    ("docs/capture.md", "calibration formats"): formats.formats_table,
    ("docs/capture.md", "keypoint files"): readers.formats_table,
    ("docs/capture.md", "keypoint layouts"): layouts.layouts_table,
    ("config/README.md", "effects"): effects.effects_table,
}


def marks(name: str) -> tuple[str, str]:
    return f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"


def standing(page: str, name: str) -> str:
    """The table as it stands in its page; ValueError when its marks are not there."""
    begin, end = marks(name)
    text = (ROOT / page).read_text(encoding="utf-8")
    start = text.index(begin) + len(begin)
    return text[start : text.index(end, start)]


def main() -> None:
    for (page, name), table in TABLES.items():
        text = (ROOT / page).read_text(encoding="utf-8")
        begin, end = marks(name)
        before, _, rest = text.partition(begin)
        (ROOT / page).write_text(before + begin + table() + end + rest.partition(end)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
