# SPDX-License-Identifier: Apache-2.0
"""All runs of a sweep as one table: what each was, how it ended, its measures, its seconds by stage."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

from studiorecon.report.sections.cost import STAGES
from studiorecon.sweep.records import Record
from studiorecon.sweep.tradeoff import measured


def columns(records: Sequence[Record]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of the table of all runs, as the CSV has it."""
    stages = in_order(stage for record in records for stage in record.stages)
    names = measured(records)
    header = [
        "name",
        "parameter",
        "preset",
        "verdict",
        *names,
        "from_nothing_s",
        "marginal_s",
        "ran_s",
        "cpu_s",
        "wall_s",
        "load",
        "peak_memory_mb",
    ]
    header += [f"{stage}_s" for stage in stages] + ["settings", "sentence"]
    rows = []
    for r in records:
        row: list[Any] = [r.name, r.parameter, r.preset, r.verdict, *(r.metrics.get(name) for name in names)]
        row += [
            *(r.seconds.get(name) for name in ("from_nothing", "marginal", "ran", "cpu", "wall")),
            r.others_cores,
            r.peak_memory_mb,
        ]
        row += [
            *(r.stages.get(stage) for stage in stages),
            "; ".join(f"{k}={v}" for k, v in r.settings.items()),
            r.sentence,
        ]
        rows.append(row)
    return header, rows


def as_csv(records: Sequence[Record]) -> str:
    """All runs as CSV; what was not measured is empty."""
    file = io.StringIO()
    header, rows = columns(records)
    csv.writer(file, lineterminator="\n").writerows([header, *rows])
    return file.getvalue()


def in_order(stages: Iterable[str]) -> list[str]:
    """Each stage once, in the order data flows."""
    return sorted(set(stages), key=lambda stage: (STAGES.index(stage) if stage in STAGES else len(STAGES), stage))
