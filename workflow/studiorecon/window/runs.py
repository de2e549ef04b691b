# SPDX-License-Identifier: Apache-2.0
"""Starts, observes and stops the Snakemake run of the current folder; all that it knows is in files.

A run that a terminal started is shown like our own, but only our own is stopped.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil

from studiorecon.cli.run_progress import PROGRESS
from studiorecon.cli.snakemake_call import environment
from studiorecon.errors import UserError
from studiorecon.progress import WARNING
from studiorecon.scene.files import write_json

_OURS = Path(".snakemake/window/run.json")
# Snakemake ends its jobs after an interrupt within a second; a job that writes a film may take a few.
_MAX_ENDING_S = 30.0
# What Snakemake says before it reads a Snakefile.
_CHATTER = ("Using workflow", "Config file", "Assuming unrestricted")
_starting = threading.Lock()
_children: list[subprocess.Popen[bytes]] = []


def log_file(scene: str) -> Path:
    """What the latest run that the window started for a scene printed; the first line is its command."""
    return Path(".snakemake/window") / f"{scene}.log"


def current_run() -> dict[str, Any] | None:
    """The run that is on in this folder, or None: its ``scene``, ``goal``, ``ours``, and its progress once it has some.

    Progress: ``done`` and ``total`` jobs, ``left`` (words), ``running``, ``stages`` (name, done, total), ``failed``.
    """
    ours, progress = _alive(_read(_OURS)), _read(PROGRESS)
    session = _session_of(progress.get("pid", 0)) if progress.get("on") else None
    if session is not None and (not ours or session == ours["pid"]):
        return {"goal": "film", **ours, **progress, "ours": bool(ours)}
    return {**ours, "ours": True, "left": "starting"} if ours else None


def last_run(scene: str) -> dict[str, Any]:
    """The latest run of a scene: whether it is ``unfinished``, its ``preset``, ``why`` it failed, and its ``log``."""
    progress, log = _read(PROGRESS), log_file(scene)
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.is_file() else []
    command = shlex.split(lines[0].removeprefix("$ ")) if lines else []
    presets = [Path(word).stem for word in command if Path(word).parent.name == "presets"]
    mine = progress if progress.get("scene") == scene else {}
    short = bool(mine) and mine["done"] < mine["total"]
    ended_badly = short or (
        bool(lines) and not any("(100%) done" in line or "Nothing to be done" in line for line in lines)
    )
    return {
        "why": _reasons(lines) if ended_badly else [],
        "unfinished": ended_badly,
        "preset": presets[0] if presets else "",
        "command": lines[0] if lines else "",
        "log": lines[-60:] if ended_badly else [],
    }


def _reasons(lines: Sequence[str]) -> list[str]:
    """The sentences of failed steps, whose logs Snakemake shows between lines of ``=``, or of a refused run."""
    found, is_log = [], False
    for line in lines:
        if line and not line.strip("="):
            is_log = not is_log
        elif is_log and line.strip() and not line.startswith(WARNING):
            found.append(line)
    if not found and not any(line.startswith("Job stats") for line in lines):
        found = [line for line in lines[1:] if line.strip() and not line.startswith(_CHATTER)][-3:]
    return list(dict.fromkeys(found))[-20:]


def start_run(goal: str, scene: str, command: Sequence[str]) -> None:
    """Start the command for ``goal`` (film, doctor, takes) in a session of its own, so that it outlives the window.

    A check by the doctor makes room for a film. Raises UserError while another run is on.
    """
    with _starting:
        run = current_run()
        if run and run["ours"] and run["goal"] == "doctor" and goal != "doctor":
            stop_run()
            run = current_run()
        if run:
            raise UserError(f"a run of {run['scene'] or 'takes'} is on in this folder; wait for its end, or stop it")
        log = log_file(scene)
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("w", encoding="utf-8") as written:
            print(f"$ {shlex.join(command)}", file=written, flush=True)
            process = subprocess.Popen(
                command,
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=written,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        _children.append(process)
        begun_s = psutil.Process(process.pid).create_time()
        write_json(_OURS, {"pid": process.pid, "begun_s": begun_s, "scene": scene, "goal": goal})


def stop_run() -> None:
    """Interrupt our run as Ctrl-C does, and wait for its end. Raises UserError for a run of a terminal."""
    run = current_run()
    if run is None:
        return
    if not run["ours"]:
        raise UserError(f"the run of {run['scene']} was started in a terminal; press Ctrl-C there")
    os.killpg(_read(_OURS)["pid"], signal.SIGINT)
    until_s = time.monotonic() + _MAX_ENDING_S
    while _alive(_read(_OURS)) and time.monotonic() < until_s:
        time.sleep(0.1)


def planned_jobs(command: Sequence[str]) -> dict[str, int]:
    """Rule → number of jobs that a run would start now; raises UserError with Snakemake's sentence where it cannot."""
    dry = [*command[:3], "--dry-run", "--nolock", *command[3:]]
    done = subprocess.run(dry, env=environment(), capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        raise UserError(
            (done.stderr or done.stdout).strip().splitlines()[-1] if done.stderr or done.stdout else "failed"
        )
    table = (done.stdout + done.stderr).partition("Job stats:")[2].partition("total")[0]
    rows = [line.split() for line in table.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit() and row[0] != "all"}


def _read(file: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def _alive(run: dict[str, Any]) -> dict[str, Any]:
    """A recorded run whose process is still that one; {} otherwise."""
    for child in [child for child in _children if child.poll() is not None]:
        _children.remove(child)
    try:
        process = psutil.Process(int(run["pid"]))
        is_it = abs(process.create_time() - run["begun_s"]) < 1 and process.status() != psutil.STATUS_ZOMBIE
        return run if is_it else {}
    except (KeyError, ValueError, psutil.Error):
        return {}


def _session_of(pid: int) -> int | None:
    """The session of a run in this folder, by the number of Snakemake's process; None where it is none, or has ended.

    In a container it can be 0: the leader of the session is then a process outside.
    """
    try:
        process = psutil.Process(pid)
        here = any("snakemake" in word for word in process.cmdline()) and Path(process.cwd()) == Path.cwd()
        return os.getsid(pid) if here and process.status() != psutil.STATUS_ZOMBIE else None
    except (psutil.Error, OSError):
        return None
