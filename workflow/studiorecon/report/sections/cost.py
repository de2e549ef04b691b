# SPDX-License-Identifier: Apache-2.0
"""The cost of a run from Snakemake's benchmark files: seconds and memory per stage and rule."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from studiorecon.stages import STAGES

# The order that readers expect; all other stages follow.
_ORDER = ("studio", *STAGES)
_COLUMNS = {"seconds": "s", "cpu_seconds": "cpu_time", "peak_memory_mb": "max_rss"}


def read_benchmark(path: Path) -> dict[str, float | None]:
    """Seconds, CPU seconds and peak memory (MB) of one job; None where Snakemake could not measure (very short jobs).

    Of a repeated benchmark with several rows it takes the median time and the largest memory.
    """
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    measured = {
        name: sorted(v for row in rows if (v := _number(row.get(column))) is not None)
        for name, column in _COLUMNS.items()
    }
    return {
        name: (v[-1] if name == "peak_memory_mb" else v[len(v) // 2]) if v else None for name, v in measured.items()
    }


def cost(folder: Path) -> dict[str, Any]:
    """Cost of a scene from ``timings/<scene>``: per stage, per rule, per job; files are ``<stage>/<step>[/<job>].tsv``.

    Seconds are sums over jobs, which may have run in parallel; peak memory is the largest single job's.
    """
    jobs: dict[str, dict[str, dict[str, dict[str, float | None]]]] = {}
    for path in sorted(folder.rglob("*.tsv")):
        stage, step, *rest = (
            path.relative_to(folder).with_suffix("").parts
            if len(path.relative_to(folder).parts) > 1
            else ("run", path.stem)
        )
        jobs.setdefault(stage, {}).setdefault(step, {})["/".join(rest) or "scene"] = read_benchmark(path)
    stages = {}
    for stage in sorted(jobs, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER)):
        steps = jobs[stage]
        rules = {step: {**_total(list(entries.values())), "jobs": entries} for step, entries in steps.items()}
        stages[stage] = {**_total([job for entries in steps.values() for job in entries.values()]), "rules": rules}
    everything = _total([job for steps in jobs.values() for entries in steps.values() for job in entries.values()])
    return {"stages": stages, "total": everything, "reason": None if stages else "there are no benchmark files"}


def pareto_front(costs: Sequence[float], qualities: Sequence[float]) -> list[int]:
    """Indices of the points that no other point dominates, cheapest first; greater quality is better."""
    front: list[int] = []
    for i in sorted(range(len(costs)), key=lambda i: (costs[i], -qualities[i], i)):
        if not front or qualities[i] > qualities[front[-1]]:
            front.append(i)
    return front


def _total(entries: list[dict[str, float | None]]) -> dict[str, float | None]:
    total: dict[str, float | None] = {"count": float(len(entries))}
    for name in _COLUMNS:
        values = [v for entry in entries if (v := entry[name]) is not None]
        total[name] = (max(values) if name == "peak_memory_mb" else sum(values)) if values else None
    return total


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text not in (None, "", "-", "NA") else None
    except ValueError:
        return None
