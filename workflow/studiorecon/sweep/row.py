# SPDX-License-Identifier: Apache-2.0
"""``sweep.row``: runs one configuration of a table as a Snakemake run in a folder of its own, and writes its record.

The base runs from nothing. Every other row starts from a copy of the base's folder, so that Snakemake remakes only the
outputs that the row changes. A run that fails, takes too long or measures nothing gives a record with the reason.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil
import yaml

from studiorecon.arrays import mean_of_measured
from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.report.sections.cost import read_benchmark
from studiorecon.scene.files import read_json, write_json, write_text
from studiorecon.signature import Place, Written
from studiorecon.sweep.table import BASE, read_rows, row_configuration

# Filming a synthetic studio is not part of reconstructing it, and scoring not part of making the film.
NOT_CHARGED = ("studio", "report")
_PICTURES = ("psnr", "ssim", "lpips", "flip", "psnr_people", "psnr_background", "psnr_unseen", "warp_rms")


def run(
    row: str,
    configuration: str,
    scene: str,
    table: Path,
    base: list[Path],
    presets: Place,
    snakefile: Place,
    cores: int,
    minutes: float,
    record: Written,
    work: Place,
) -> None:
    """Run one row over ``configuration`` (JSON); ``base`` holds the base's record, ``work`` one folder per row."""
    rows = {entry.name: entry for entry in read_rows(table)}
    chosen, folder = rows[row], work / row
    given = with_absolute_paths(json.loads(configuration))
    whole = row_configuration(given, rows[BASE], chosen, presets) | {"scene": scene}
    if base and not (folder / ".snakemake").is_dir():
        copy_run(work / BASE, folder)
    write_text(folder / "config.yaml", yaml.safe_dump(whole, sort_keys=True, allow_unicode=True))
    target, began_s = f"results/{scene}/report/metrics.json", time.time()
    status, output = run_snakemake(snakefile, folder, [target, "--cores", str(cores)], minutes)
    wall_s = time.time() - began_s
    found: dict[str, Any] = {"failed": reason_of_failure(output, folder, None if status is not None else minutes)}
    if status == 0:
        _, summary = run_snakemake(snakefile, folder, [target, "--detailed-summary"], minutes)
        found = {**read_scores(folder / target), **run_cost(folder, timing_files(summary), began_s)}
    settings = dict(chosen.settings) if chosen.preset or row == BASE else {**rows[BASE].settings, **chosen.settings}
    about = {"name": row, "scene": scene, "parameter": chosen.parameter, "preset": chosen.preset, "settings": settings}
    write_json(record, {**about, **found, "wall_s": wall_s, "machine": describe_machine()})
    say(f"{row}: {found['failed'] or '{:.2f} dB, {:.0f} s'.format(found['metrics']['psnr'], found['from_nothing_s'])}")
    if row == BASE and found["failed"]:
        raise UserError(f"scene {scene}, sweep {table}: the base run failed, so no row can start: {found['failed']}")


def copy_run(source: Path, target: Path) -> None:
    """Copy a finished run's folder, with results as hard links where the disk allows it.

    Steps write to a temporary name and rename, and Snakemake removes outputs before it runs their job, so a link's
    other end never changes. Logs, timings and Snakemake's records are modified in place: these are real copies.
    """
    shutil.copytree(source / "results", target / "results", copy_function=_link, symlinks=True)
    for name in ("logs", "timings", ".snakemake/metadata"):
        shutil.copytree(source / name, target / name)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def run_snakemake(snakefile: Path, folder: Path, arguments: list[str], minutes: float) -> tuple[int | None, str]:
    """Exit status of Snakemake in ``folder`` (None: stopped at the limit) and its output, also kept in the folder."""
    where = ["--snakefile", str(snakefile.resolve()), "--directory", str(folder.resolve())]
    how = ["--configfile", str((folder / "config.yaml").resolve()), "--nolock", "--rerun-incomplete"]
    # A job's own share of threads must not limit the jobs of the run that it starts.
    own = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in own}
    with open(folder / "snakemake.txt", "w+", encoding="utf-8") as log:
        command = [sys.executable, "-m", "snakemake", *arguments, *where, *how]
        process = psutil.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
        try:
            status: int | None = process.wait(timeout=60 * minutes)
        except (psutil.TimeoutExpired, subprocess.TimeoutExpired):
            status = None
            for child in [*process.children(recursive=True), process]:
                child.kill()
            process.wait()
        log.seek(0)
        return status, log.read()


def timing_files(summary: str) -> list[Path]:
    """Timing files of the jobs in Snakemake's ``--detailed-summary``, relative to the run's folder.

    A job's timing file is named as its log: ``logs/<scene>/…log`` → ``timings/<scene>/…tsv``.
    """
    lines = [line.split("\t") for line in summary.splitlines()]
    head = next(i for i, cells in enumerate(lines) if "log-file(s)" in cells)
    column = lines[head].index("log-file(s)")
    logs = {cells[column] for cells in lines[head + 1 :] if len(cells) > column and cells[column].startswith("logs/")}
    return [Path("timings", *Path(log).parts[1:]).with_suffix(".tsv") for log in sorted(logs)]


def run_cost(folder: Path, paths: list[Path], began_s: float) -> dict[str, Any]:
    """Seconds and memory of a run, from the timing files ``paths`` of its jobs.

    ``from_nothing_s`` is of all its jobs, ``ran_s`` of those run since ``began_s`` (seconds of the epoch); also
    ``processor_s``, seconds per stage and the largest job's memory.
    """
    stages: dict[str, float] = {}
    ran_s = processor_s = peak_mb = 0.0
    for path in paths:
        stage = "studio" if path.parts[1] == "studio" else path.parts[2]
        if stage in NOT_CHARGED or not (folder / path).is_file():
            continue
        job = read_benchmark(folder / path)
        seconds = job["seconds"] or 0.0
        stages[stage] = stages.get(stage, 0.0) + seconds
        ran_s += seconds if (folder / path).stat().st_mtime >= began_s else 0.0
        processor_s += job["cpu_seconds"] or 0.0
        peak_mb = max(peak_mb, job["peak_memory_mb"] or 0.0)
    total = {"from_nothing_s": sum(stages.values()), "ran_s": ran_s, "processor_s": processor_s}
    return {**total, "stages_s": stages, "peak_memory_mb": peak_mb}


def read_scores(path: Path) -> dict[str, Any]:
    """Measures of a run's ``metrics.json`` and PSNR per camera and frame; ``failed`` says why there are none."""
    metrics = read_json(path)
    pictures = metrics["pictures"]["enhanced" if "enhanced" in metrics["pictures"] else "raw"]
    if pictures["psnr"]["value"] is None:
        why = pictures["psnr"]["reason"] or "no picture was compared with a photo: a sweep needs held-out cameras"
        return {"failed": why}
    values = {name: pictures.get(name, {}).get("value") for name in _PICTURES}
    jitter = mean_of_measured(person["joints_mm_f2"] for person in metrics["jitter"].values())
    values |= {"joints_mm": metrics["bodies"]["mpjpe_world_mm"], "jitter_mm_f2": jitter}
    frames = {camera: entry["frames"] for camera, entry in pictures["psnr"]["cameras"].items()}
    return {"failed": "", "metrics": values, "frames": frames}


def reason_of_failure(output: str, folder: Path, limit_minutes: float | None) -> str:
    """One sentence: the last line of the first failed job's log, else Snakemake's own last line."""
    if limit_minutes is not None:
        return f"stopped after {limit_minutes:g} minutes (sweep_minutes)"
    for block in output.split("Error in rule ")[1:]:
        log = re.search(r"log: ([^\s(]+)", block)
        if log and (folder / log.group(1)).is_file():
            text = (folder / log.group(1)).read_text(encoding="utf-8", errors="replace").strip()
            if text:
                return f"{block.split(':')[0]}: {text.splitlines()[-1].strip()}"
    return (output.strip().splitlines() or ["Snakemake wrote nothing"])[-1].strip()


def describe_machine() -> dict[str, Any]:
    """Processor, cores and Python, because seconds of two machines are not comparable."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE) if info.is_file() else []
    processor = names[0] if names else platform.processor() or platform.machine()
    return {"processor": processor, "cores": os.cpu_count(), "python": platform.python_version()}


def with_absolute_paths(value: Any) -> Any:
    """A configuration with absolute paths of existing files and folders, since every run has its own folder.

    A word without a slash or a dot, such as ``depth``, is a choice and no path.
    """
    if isinstance(value, Mapping):
        return {key: with_absolute_paths(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_absolute_paths(inner) for inner in value]
    is_path = isinstance(value, str) and ("/" in value or "." in value) and Path(value).exists()
    return str(Path(value).resolve()) if is_path else value
