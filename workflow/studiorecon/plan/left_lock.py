# SPDX-License-Identifier: Apache-2.0
"""The lock of a run that was killed, told from that of one that goes on."""

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


def clear_left_lock(folder: Path) -> str:
    """Takes away the lock that a killed run left in a working ``folder``; says so in a sentence, "" where there is
    none, or whose it is cannot be told from here.

    A run lives when a process of this machine works in that folder, be it only a step whose driver was killed. On
    another machine's runs nothing here can look, so their locks stay (Snakemake's own message says what to do).
    """
    locks = folder / ".snakemake" / "locks"
    since_s = [path.stat().st_mtime for path in locks.iterdir()] if locks.is_dir() else []
    if not since_s:
        return ""
    if _host_of_the_run(folder, min(since_s)) not in (platform.node(), None) or any(_living(folder)):
        return ""
    shutil.rmtree(locks)
    return f"the run before this one in {folder.resolve()} was killed: its lock was taken away"


def _living(folder: Path) -> Iterator[int]:
    """Processes that may be runs or steps in ``folder``: those that can be looked at and work there, and those that
    cannot."""
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
    """The machine that the engine's log of the run names that took the lock: the last that began before it did. Dry
    runs, here or elsewhere, write logs as well and take none."""
    logs = [(_begun_s(path), path) for path in (folder / ".snakemake" / "log").glob("*.log")]
    for _, path in sorted((pair for pair in logs if pair[0] <= since_s + 1), reverse=True):
        with open(path, encoding="utf-8", errors="replace") as file:
            if found := re.search(r"^ *Host: (\S+)", file.read(4000), re.MULTILINE):
                return found.group(1)
    return None


def _begun_s(log: Path) -> float:
    """When a log was begun, which is its name; else when it was last written."""
    try:
        return datetime.strptime(log.name.partition(".snakemake")[0], "%Y-%m-%dT%H%M%S.%f").timestamp()
    except ValueError:
        return log.stat().st_mtime
