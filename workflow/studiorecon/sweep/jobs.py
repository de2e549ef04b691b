# SPDX-License-Identifier: Apache-2.0
"""Jobs as Snakemake remembers them: what each made, from what, under which settings, and what it cost.

A job's key is a digest of its rule, its log's name (which holds its wildcards) and the sections of the configuration
that it and everything above it read. Jobs of two configurations with the same key made the same files, so the second
one may start from those. Snakemake still decides on what has to run again: a key that is wrong costs time, never
correctness.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from base64 import urlsafe_b64decode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studiorecon.report.sections.cost import read_benchmark

METADATA = Path(".snakemake/metadata")
# Settings that say where things are or which sweep this is, not how they are made.
_NOT_SETTINGS = ("scene", "sweep", "sweep_minutes")
# What they compile is the same under all settings of their stage; who waits for it shares none of its settings.
_COMPILING = ("background_kernels", "depth_kernels")


@dataclass(frozen=True)
class Job:
    """A finished job: its rule, log (which names it), files relative to the run's folder, and when it started.

    ``records`` are Snakemake's own files about the outputs. The same log and start in two runs is the same execution.
    """

    rule: str
    log: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    started: float
    records: tuple[str, ...]

    @property
    def execution(self) -> tuple[str, float]:
        """What tells this execution from every other."""
        return self.log, self.started

    @property
    def stage(self) -> str:
        """The stage whose settings it reads; ``studio`` for the synthetic studio."""
        parts = Path(self.log).parts  # logs/<scene>/<stage>/… or logs/studio/<name>/…
        return "studio" if parts[1] == "studio" else parts[2]

    @property
    def benchmark(self) -> str:
        """Snakemake's file of seconds and memory, named as the log is."""
        return str(Path("timings", *Path(self.log).parts[1:]).with_suffix(".tsv"))


def read_jobs(folder: Path) -> dict[str, Job]:
    """log → job, of everything that was made in a run's folder and is still there."""
    parts: dict[str, dict[str, Any]] = {}
    for path in sorted(p for p in (folder / METADATA).rglob("*") if p.is_file()):
        output = _output(path.relative_to(folder / METADATA))
        record = json.loads(path.read_text(encoding="utf-8"))
        if not record.get("log") or record.get("incomplete") or not (folder / output).exists():
            continue
        job = parts.setdefault(
            record["log"][0], {"rule": record["rule"], "started": 0.0, "made": {}, "inputs": set(), "records": []}
        )
        job["made"][output] = record
        job["started"] = max(job["started"], record.get("starttime") or 0.0)
        job["inputs"] |= set(record.get("input") or ())
        job["records"].append(str(path.relative_to(folder)))
    return {
        log: Job(
            j["rule"], log, tuple(sorted(j["made"])), tuple(sorted(j["inputs"])), j["started"], tuple(j["records"])
        )
        for log, j in parts.items()
    }


def cone(jobs: Mapping[str, Job], targets: Iterable[str]) -> dict[str, Job]:
    """Those jobs that the targets (paths) need, directly or not."""
    makers = {output: job for job in jobs.values() for output in job.outputs}
    found: dict[str, Job] = {}
    waiting = list(targets)
    while waiting:
        job = _maker(makers, waiting.pop())
        if job is not None and job.log not in found:
            found[job.log] = job
            waiting += job.inputs
    return found


def keys(jobs: Mapping[str, Job], configuration: Mapping[str, Any]) -> dict[str, str]:
    """log → key of every job under a configuration."""
    makers = {output: job for job in jobs.values() for output in job.outputs}
    sections: dict[str, frozenset[str]] = {}

    def above(job: Job) -> frozenset[str]:
        if job.log not in sections:
            own = frozenset() if job.rule in _COMPILING else frozenset({job.stage})
            sections[job.log] = own  # a cycle cannot be, but must not hang
            parents = {p.log: p for path in job.inputs if (p := _maker(makers, path)) is not None}
            sections[job.log] = own.union(*(above(parent) for parent in parents.values()))
        return sections[job.log]

    common = {k: v for k, v in configuration.items() if not isinstance(v, Mapping) and k not in _NOT_SETTINGS}
    result = {}
    for log, job in jobs.items():
        told = [job.rule, log, common, {name: configuration.get(name) for name in sorted(above(job))}]
        result[log] = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:20]
    return result


def share(source: Path, jobs: Iterable[Job], target: Path) -> None:
    """Put finished jobs into another run's folder: outputs as hard links (copies where the disk has none), times kept.

    Steps write beside a name and rename, and Snakemake removes outputs before it runs their job, so that a link's other
    end never changes. Benchmarks and Snakemake's records are written in place, and are therefore copied.
    """
    for job in jobs:
        for path in job.outputs:
            _link(source / path, target / path)
        for path in (*job.records, job.benchmark):
            if (source / path).is_file():
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source / path, target / path)


def charge(
    folder: Path, jobs: Iterable[Job], paid: frozenset[tuple[str, float]] = frozenset(), kind: str = "seconds"
) -> dict[str, float]:
    """stage → wall seconds (or ``kind`` cpu_seconds) of the jobs, but for executions that are already paid for.

    A job whose time Snakemake could not measure (a few hundredths of a second) counts nothing.
    """
    stages: dict[str, float] = {}
    for job in jobs:
        if job.execution not in paid:
            stages[job.stage] = stages.get(job.stage, 0.0) + (_spent(folder, job, kind) or 0.0)
    return stages


def peak_memory_mb(folder: Path, jobs: Iterable[Job]) -> float | None:
    """Memory of the largest job; None where none was measured."""
    return max((m for job in jobs if (m := _spent(folder, job, "peak_memory_mb")) is not None), default=None)


def reusable(
    finished: Sequence[tuple[Path, Mapping[str, Job], Mapping[str, Any]]], configuration: Mapping[str, Any]
) -> list[tuple[Path, list[Job]]]:
    """Per finished run (folder, jobs, configuration), in order, the jobs that a new configuration may start from.

    Each job is taken from the first run that has it, so that inputs are never newer than what was made of them.
    """
    taken: set[str] = set()
    plan = []
    for folder, jobs, theirs in finished:
        have, want = keys(jobs, theirs), keys(jobs, configuration)
        same = [job for log, job in jobs.items() if have[log] == want[log] and log not in taken]
        taken |= {job.log for job in same}
        plan.append((folder, same))
    return plan


def _maker(makers: Mapping[str, Job], path: str) -> Job | None:
    """The job that made a path, or the directory it lies in."""
    for candidate in (path, *map(str, Path(path).parents)):
        if candidate in makers:
            return makers[candidate]
    return None


def _output(record: Path) -> str:
    """Snakemake's name of a record is the output's path in base64; long ones are split into folders whose names begin
    with @."""
    return urlsafe_b64decode("".join(part.removeprefix("@") for part in record.parts)).decode()


def _link(source: Path, target: Path) -> None:
    if source.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        for child in source.iterdir():
            _link(child, target / child.name)
        shutil.copystat(source, target)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _spent(folder: Path, job: Job, name: str) -> float | None:
    path = folder / job.benchmark
    return read_benchmark(path)[name] if path.is_file() else None
