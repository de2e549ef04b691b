# SPDX-License-Identifier: Apache-2.0
"""``sweep.page``: one page and one CSV of what accuracy costs, from the records of one or several sweeps."""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.pages import html
from studiorecon.progress import say
from studiorecon.report.sections.solvers import section as solvers_section
from studiorecon.scene.files import write_text
from studiorecon.signature import Written
from studiorecon.sweep.records import read_records
from studiorecon.sweep.runs_csv import as_csv
from studiorecon.sweep.section import scenes_section, section


def run(records: list[Path], solvers: Path, page: Written, table: Written) -> None:
    """Write the page, and ``table`` with all runs of the first file; several files show how much hangs on the scene.
    ``solvers`` is the table of exact and cheap solvers.

    Files of different machines are refused: their seconds do not belong into one picture.
    """
    if not records:
        raise UserError("name the records to show: --records results/SCENE/sweep/TABLE/records.jsonl")
    sweeps = [(path, *read_records(path)) for path in records]
    for path, _, found in sweeps[1:]:
        if found[0].machine != sweeps[0][2][0].machine:
            raise UserError(f"{path} was measured on another machine than {records[0]}: their seconds do not compare")
    body = [f"<h1>{html.text(', '.join(dict.fromkeys(found[0].scene for _, _, found in sweeps)))}</h1>"]
    for _, name, found in sweeps:
        body.append(section(name, found))
    body.append(scenes_section({found[0].scene: found for _, _, found in sweeps}))
    body.append(solvers_section(solvers))
    write_text(page, html.page("What accuracy costs", body))
    write_text(table, as_csv(sweeps[0][2]))
    say(f"the page needs no network: {page}")
