# SPDX-License-Identifier: Apache-2.0
"""The page's table of solvers that have an exact and a cheap form: what each costs and how far off it is
(``resources/solvers.tsv``)."""

from __future__ import annotations

from pathlib import Path

from studiorecon.pages import html
from studiorecon.report.sections.cost import pareto_front
from studiorecon.scene.files import read_table

COLUMNS = ("solver", "form", "setting", "cost", "cost unit", "error", "error unit", "default")


def section(path: Path) -> str:
    """One table per page, a row per form, marked where no other form of the same solver is both cheaper and closer."""
    rows = read_table(path, COLUMNS)
    shown = []
    for solver in dict.fromkeys(row["solver"] for row in rows):
        forms = [row for row in rows if row["solver"] == solver]
        best = pareto_front([float(row["cost"]) for row in forms], [-float(row["error"]) for row in forms])
        for i, row in enumerate(forms):
            name = row["form"] + (" (used)" if row["default"] else "")
            told = [
                f"{row['cost']} {row['cost unit']}",
                f"{row['error']} {row['error unit']}",
                "yes" if i in best else "",
                row["setting"],
            ]
            shown.append([solver if i == 0 else "", name, *told])
    header = ["solver", "form", "cost", "error", "on the front", "setting"]
    lead = (
        "Measured on planted truth by this project's benches (python -m benchmarks.solvers), "
        "not on this scene. On the front: no other "
    )
    lead += "form of the same solver is both cheaper and closer."
    table = html.table(header, shown, numeric=(2, 3))
    return (
        "<h3>Exact and cheap solvers</h3><p "
        f'class="soft">{html.text(lead)}</p><details><summary>All '
        f"forms</summary>{table}</details>"
    )
