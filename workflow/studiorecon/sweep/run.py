# SPDX-License-Identifier: Apache-2.0
"""``sweep.run``: every configuration of a table, one after the other, each as a Snakemake run of its own:
``records.jsonl``.

A run starts from every finished job that its settings leave alone, so that it makes only what they change. A run that
fails, takes too long or measures nothing is a record with its reason, and the sweep goes on. Interrupted, it goes on
where it was.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil
import yaml

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.files import read_json, write_json, write_text
from studiorecon.signature import Place, Written
from studiorecon.sweep.fingerprint import busy_s, compiled_since, machine, seeds, versions
from studiorecon.sweep.jobs import Job, charge, cone, peak_memory_mb, read_jobs, reusable, share
from studiorecon.sweep.outcome import NOTHING_MEASURED, Outcome, outcome, why_it_failed
from studiorecon.sweep.records import FAILED, OK, Record, write_records
from studiorecon.sweep.table import Configuration, changes, full_configuration, read_configurations

# Filming a synthetic studio is no cost of reconstructing it, and scoring is none of making the film.
_NOT_CHARGED = ("studio", "report")
# Files of a run's folder: when it was begun, and what it took once it has come to its end.
_BEGUN, _CLOCK = "begun", "clock.json"


def run(
    configuration: str,
    scene: str,
    table: Path,
    presets: Place,
    snakefile: Place,
    cores: int,
    minutes: float,
    records: Written,
    work: Place,
) -> None:
    """Run the table's configurations over ``configuration`` (JSON); ``work`` keeps one folder per run, ``minutes`` is
    each one's limit."""
    given = with_absolute_paths(json.loads(configuration))
    given["dataset"] = str(Path(given["dataset"]).resolve()) if Path(given["dataset"]).exists() else given["dataset"]
    rows = read_configurations(table, given, presets)
    here = {"machine": machine(), "versions": versions()}
    _check_same_machine(work, here)
    told: list[Record] = []
    finished: list[tuple[Path, Mapping[str, Job], Mapping[str, Any]]] = []
    paid: set[tuple[str, float]] = set()
    base_paid: frozenset[tuple[str, float]] | None = None
    for number, row in enumerate(rows, 1):
        full, folder = full_configuration(given, rows[0], row, presets), work / row.name
        full |= {"scene": scene}
        target = f"results/{scene}/report/metrics.json"
        about = folder, full, finished, snakefile, target, cores, minutes
        status, output, wall_s, others_s = _timed(*about)
        # A run that was timed before compiled nothing: those that did were made anew.
        if status == 0 and not (folder / _CLOCK).is_file() and compiled_since((folder / _BEGUN).stat().st_mtime):
            say(
                f"{row.name}: kernels were compiled in this run; it runs once more, "
                "so that no other is charged for that"
            )
            shutil.rmtree(folder)
            status, output, wall_s, others_s = _timed(*about)
        made = read_jobs(folder)
        wall_s, others_s = clock(folder, made, wall_s, others_s)
        needed = cone(made, [target]) if status == 0 else made
        result = (
            outcome(folder / target)
            if status == 0
            else Outcome(sentence=why_it_failed(output, folder, minutes if status is None else None))
        )
        told.append(
            _record(
                scene,
                row,
                rows[0],
                full,
                folder,
                needed,
                result,
                wall_s,
                base_paid,
                frozenset(paid),
                here | {"others_cores": others_s / wall_s},
            )
        )
        # What a failed run finished before it failed is as good as anybody's.
        finished.append((folder, made, full))
        paid |= {job.execution for job in made.values()}
        if row is rows[0]:
            base_paid = frozenset(paid)
        _tell(number, len(rows), told[-1])
        if row is rows[0] and result.sentence == NOTHING_MEASURED:
            raise UserError(
                f"scene {scene}: {NOTHING_MEASURED}: a sweep needs held-out cameras; name "
                "some under held_out in capture.yaml"
            )
    write_records(records, str(table), told)
    failed = [record.name for record in told if record.verdict != OK]
    say(
        f"{len(told) - len(failed)} of {len(told)} configurations ran"
        + (f"; these failed: {', '.join(failed)}" if failed else "")
    )


def _record(
    scene: str,
    row: Configuration,
    base: Configuration,
    full: Mapping[str, Any],
    folder: Path,
    jobs: Mapping[str, Job],
    result: Outcome,
    wall_s: float,
    base_paid: frozenset[tuple[str, float]] | None,
    paid: frozenset[tuple[str, float]],
    here: Mapping[str, Any],
) -> Record:
    stages = charge(folder, jobs.values())
    beside_base = charge(folder, jobs.values(), base_paid or frozenset())
    ran = charge(folder, jobs.values(), paid)
    processor = charge(folder, jobs.values(), kind="cpu_seconds")
    charged = [
        {stage: s for stage, s in part.items() if stage not in _NOT_CHARGED}
        for part in (stages, beside_base, ran, processor)
    ]
    return Record(
        scene=scene,
        name=row.name,
        parameter=row.parameter,
        preset=row.preset,
        settings=changes(row, base),
        verdict=FAILED if result.sentence else OK,
        sentence=result.sentence,
        metrics=result.metrics,
        intervals=result.intervals,
        frames=result.frames,
        worst=result.worst,
        seconds={
            "from_nothing": sum(charged[0].values()),
            "marginal": sum(charged[1].values()),
            "ran": sum(charged[2].values()),
            "cpu": sum(charged[3].values()),
            "scoring": stages.get("report", 0.0),
            "wall": wall_s,
        },
        stages=charged[0],
        ran_stages=charged[2],
        peak_memory_mb=peak_memory_mb(folder, jobs.values()),
        seeds=seeds(full),
        scored=result.scored,
        **here,
    )


def _timed(
    folder: Path,
    full: Mapping[str, Any],
    finished: list[tuple[Path, Mapping[str, Job], Mapping[str, Any]]],
    snakefile: Path,
    target: str,
    cores: int,
    minutes: float,
) -> tuple[int | None, str, float, float]:
    """Status and output of one start of a run, its clock seconds, and processor seconds of everything else
    meanwhile."""
    _prepare(folder, full, finished)
    began, before = time.monotonic(), busy_s()
    status, output = _snakemake(snakefile, folder, target, cores, minutes)
    wall_s, after = time.monotonic() - began, busy_s()
    return status, output, wall_s, max(0.0, (after[0] - before[0]) - (after[1] - before[1]))


def _prepare(
    folder: Path, full: Mapping[str, Any], finished: list[tuple[Path, Mapping[str, Job], Mapping[str, Any]]]
) -> None:
    """The run's folder: its whole configuration and, unless it was begun before, every job it can start from."""
    begun = (folder / ".snakemake").is_dir()
    write_text(folder / "config.yaml", yaml.safe_dump(dict(full), sort_keys=True, allow_unicode=True))
    if not begun:
        for source, jobs in reusable(finished, full):
            share(source, jobs, folder)
    if not (folder / _BEGUN).is_file():
        (folder / _BEGUN).touch()
    (folder / ".snakemake").mkdir(exist_ok=True)
    byte_code, kept = folder / ".snakemake/bytecode", Path(".snakemake/bytecode")
    if not byte_code.is_symlink() and kept.parent.is_dir():
        kept.mkdir(exist_ok=True)
        byte_code.symlink_to(kept.resolve(), target_is_directory=True)


def clock(folder: Path, made: Mapping[str, Job], wall_s: float, others_s: float) -> tuple[float, float]:
    """Clock seconds of a run, and processor seconds of everything else meanwhile, over all times it was started; a
    start that had nothing left to do does not count."""
    path, jobs = folder / _CLOCK, sorted([log, started] for log, started in (job.execution for job in made.values()))
    if path.is_file():
        earlier = read_json(path)
        if earlier["jobs"] == jobs:
            return earlier["wall_s"], earlier["others_s"]
        wall_s, others_s = wall_s + earlier["wall_s"], others_s + earlier["others_s"]
    write_json(path, {"wall_s": wall_s, "others_s": others_s, "jobs": jobs})
    return wall_s, others_s


def _snakemake(snakefile: Path, folder: Path, target: str, cores: int, minutes: float) -> tuple[int | None, str]:
    """Exit status (None: stopped at the limit) and everything Snakemake said, which is also kept in the run's
    folder."""
    command = [
        sys.executable,
        "-m",
        "snakemake",
        target,
        "--snakefile",
        str(snakefile.resolve()),
        "--directory",
        str(folder.resolve()),
    ]
    command += [
        "--cores",
        str(cores),
        "--configfile",
        str((folder / "config.yaml").resolve()),
        "--nolock",
        "--rerun-incomplete",
    ]
    with open(folder / "snakemake.txt", "w+", encoding="utf-8") as log:
        running = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=_environment())
        try:
            status: int | None = running.wait(timeout=60 * minutes)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            _stop(running)
        log.seek(0)
        return status, log.read()


def _environment() -> dict[str, str]:
    # A job's own share of threads must not become the limit of every job below it: Snakemake announces each one's anew.
    return {name: value for name, value in os.environ.items() if name not in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}


def _stop(running: subprocess.Popen) -> None:
    if running.poll() is None:
        family = [psutil.Process(running.pid), *psutil.Process(running.pid).children(recursive=True)]
        for process in family:
            if process.is_running():
                process.kill()
        running.wait()


def with_absolute_paths(value: Any) -> Any:
    """A configuration whose files and folders that exist from here have absolute names, since every run has a folder of
    its own.

    A word without a slash or a dot, such as ``depth``, is a choice and no path, whatever folders lie around.
    """
    if isinstance(value, Mapping):
        return {key: with_absolute_paths(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_absolute_paths(inner) for inner in value]
    is_path = isinstance(value, str) and ("/" in value or "." in value) and Path(value).exists()
    return str(Path(value).resolve()) if is_path else value


def _check_same_machine(work: Path, here: Mapping[str, Any]) -> None:
    """Seconds of two machines do not belong into one picture."""
    path = work / "machine.json"
    if path.is_file() and read_json(path) != json.loads(json.dumps(here)):
        raise UserError(
            f"{work} was begun on another machine or with other versions of software; "
            "move it away and start the sweep anew"
        )
    write_json(path, here)


def _tell(number: int, count: int, record: Record) -> None:
    psnr, seconds = record.metrics.get("psnr"), record.seconds
    reached = f"{psnr:.2f} dB" if psnr is not None else record.sentence
    spent = (
        f"{seconds['from_nothing']:.0f} s from nothing, ran {seconds['ran']:.0f} s of "
        f"it, {seconds['wall']:.0f} s by the clock"
    )
    say(f"{number}/{count} {record.name}: {reached}; {spent}")
