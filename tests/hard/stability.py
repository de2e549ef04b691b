# SPDX-License-Identifier: Apache-2.0
"""What breaks in the textbook formula, and what ours does: ``python -m tests.hard.stability`` writes
``docs/stability.md`` and its plots.

A case or more for each of the families of ``docs/hard-cases.md``: an input that gets harder along x, the error of
either formula along y, measured against an answer that is known exactly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hard import stability_geometry, stability_pictures
from tests.hard.stability_case import Case

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Below this an error counts as none, on the plots.
FLOOR = 1e-16
# In the order of the page: the families of docs/hard-cases.md.
CASES = (*stability_geometry.CASES, *stability_pictures.CASES)


def plot(case: Case, width: int = 460, height: int = 220) -> str:
    """The two errors as an SVG picture, errors in powers of ten."""
    left, top, right, bottom = 64, 26, width - 12, height - 40
    lines = {
        "textbook": [max(abs(np.nan_to_num(case.textbook(x), nan=1e3)), FLOOR) for x in case.xs],
        "ours": [max(abs(case.kept(x)), FLOOR) for x in case.xs],
    }
    powers = np.log10([value for values in lines.values() for value in values])
    low, high = float(np.floor(powers.min())), float(np.ceil(powers.max()) + (powers.max() == powers.min()))
    # Hardest on the right.
    harder = 1.0 if case.xs[-1] > case.xs[0] else -1.0
    across = harder * np.log10(case.xs) if case.log_x else np.array(case.xs)
    span = float(across.max() - across.min())

    def place(index: int, value: float) -> str:
        x = left + (right - left) * (across[index] - across.min()) / span
        y = bottom - (bottom - top) * (np.log10(value) - low) / (high - low)
        return f"{x:.1f},{y:.1f}"

    drawn = [
        f'<polyline fill="none" stroke="{colour}" stroke-width="2" points="'
        + " ".join(place(i, value) for i, value in enumerate(lines[name]))
        + '"/>'
        for name, colour in (("textbook", "#b3541e"), ("ours", "#1e6fb3"))
    ]
    texts = [
        (left - 6, top + 8, "end", f"1e{high:.0f}"),
        (left - 6, bottom, "end", f"1e{low:.0f}"),
        (left, bottom + 14, "start", f"{case.xs[int(np.argmin(across))]:g}"),
        (right, bottom + 14, "end", f"{case.xs[int(np.argmax(across))]:g}"),
        ((left + right) / 2, height - 8, "middle", case.along),
        (left, top - 10, "start", case.error),
    ]
    words = [f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{text}</text>' for x, y, anchor, text in texts]
    names = '<tspan fill="#b3541e">textbook</tspan> <tspan fill="#1e6fb3">ours</tspan>'
    key = f'<text x="{right - 4}" y="{top - 10}" text-anchor="end">{names}</text>'
    frame = f'<path d="M{left} {top}V{bottom}H{right}" fill="none" stroke="#888"/>'
    body = "\n".join([frame, *drawn, *words, key])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="11" fill="#333">\n<rect width="{width}" height="{height}" fill="#fff"/>\n{body}\n</svg>\n'
    )


def page() -> str:
    """docs/stability.md."""
    rows = [
        f"## {case.title}\n\n![{case.title}: errors of the textbook and of ours](stability/{case.name}.svg)\n\n"
        f"*Textbook:* {case.breaks}. *Ours:* {case.ours}. Cases {case.ids} of the [hard cases](hard-cases.md).\n"
        for case in CASES
    ]
    return (
        "# Numerically stable, shown\n\nMade by `python -m tests.hard.stability`; do not edit by hand. A case or more "
        "for each family of [hard cases](hard-cases.md): an input gets harder to the right, and the error of the "
        "formula that stands in most textbooks is drawn beside that of the one that is used here, against an answer "
        "that is known exactly. All 161 cases are tests.\n\n" + "\n".join(rows)
    )


def main() -> None:
    (DOCS / "stability").mkdir(exist_ok=True)
    for case in CASES:
        (DOCS / "stability" / f"{case.name}.svg").write_text(plot(case), encoding="utf-8")
    (DOCS / "stability.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
