# SPDX-License-Identifier: Apache-2.0
"""Detects and removes the lock of a run that was killed, but not that of a live run."""

from __future__ import annotations

import os
import platform
import re
import shutil
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import psutil

_RUNS = ("snakemake", "studiorecon")


def clear_stale_lock(folder: Path) -> str:
    """Removes the lock that a killed run left in a working ``folder``, and returns a sentence about it.

    Returns "" when there is no lock or its owner cannot be determined. A run is live when a process of this machine
    works in that folder. Locks of runs on other machines stay; Snakemake's own message gives the remedy.
    """
    locks = folder / ".snakemake" / "locks"
    since_s = [path.stat().st_mtime for path in locks.iterdir()] if locks.is_dir() else []
    if not since_s:
        return ""
    if _host_of_the_run(folder, min(since_s)) not in (platform.node(), None) or any(_living(folder)):
        return ""
    shutil.rmtree(locks)
    return f"the previous run in {folder.resolve()} was killed: its lock was removed"


def _living(folder: Path) -> Iterator[int]:
    """Processes that may be runs or steps in ``folder``, and those that cannot be inspected."""
    own = {os.getpid(), *(parent.pid for parent in psutil.Process().parents())}
    for process in psutil.process_iter():
        try:
            if process.pid in own or not any(name in word for word in process.cmdline() for name in _RUNS):
                continue
            if Path(process.cwd()).resolve() == folder.resolve():
                yield process.pid
        except psutil.NoSuchProcess:
            continue
        except (psutil.AccessDenied, OSError):
            yield process.pid


def _host_of_the_run(folder: Path, since_s: float) -> str | None:
    """The machine named in the log of the run that took the lock: the last begun before it (dry runs log too)."""
    logs = [(_begun_s(path), path) for path in (folder / ".snakemake" / "log").glob("*.log")]
    for _, path in sorted((pair for pair in logs if pair[0] <= since_s + 1), reverse=True):
        with open(path, encoding="utf-8", errors="replace") as file:
            if found := re.search(r"^ *Host: (\S+)", file.read(4000), re.MULTILINE):
                return found.group(1)
    return None


def _begun_s(log: Path) -> float:
    """The time when a log was begun, from its name; otherwise the time of its last change."""
    try:
        return datetime.strptime(log.name.partition(".snakemake")[0], "%Y-%m-%dT%H%M%S.%f").timestamp()
    except ValueError:
        return log.stat().st_mtime
