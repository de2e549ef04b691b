# SPDX-License-Identifier: Apache-2.0
"""On what and with what a sweep ran: seconds mean nothing without the machine, metrics little without versions and
seeds."""

from __future__ import annotations

import os
import platform
import resource
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil

from studiorecon.machine import kernel_cache

_PACKAGES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "av", "snakemake")


def machine() -> dict[str, Any]:
    """Processor, cores, memory and system. Which GPU drew is in the logs; the CPU is what benchmark files time."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 2**30, 1),
        "system": f"{platform.system()} {platform.machine()}",
    }


def versions() -> dict[str, str]:
    """Python and the packages that make numbers."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def seeds(configuration: Mapping[str, Any], above: str = "") -> dict[str, int]:
    """dotted key → value of every seed in a configuration."""
    found: dict[str, int] = {}
    for key, value in configuration.items():
        if isinstance(value, Mapping):
            found |= seeds(value, f"{above}{key}.")
        elif key == "seed":
            found[f"{above}{key}"] = value
    return found


def busy_s() -> tuple[float, float]:
    """Processor seconds so far: of everything on the machine, and of the processes that this one started and that have
    ended."""
    times, own = psutil.cpu_times(), resource.getrusage(resource.RUSAGE_CHILDREN)
    return times.user + times.system + times.nice, own.ru_utime + own.ru_stime


def compiled_since(moment_s: float) -> bool:
    """Whether numba has compiled kernels since then (seconds of the epoch): whoever did paid for all who use them
    later."""
    return any(path.stat().st_mtime >= moment_s for path in kernel_cache.folder().rglob("*.nbc"))


def _processor() -> str:
    told = Path("/proc/cpuinfo")
    names = (
        [line.partition(":")[2].strip() for line in told.read_text().splitlines() if line.startswith("model name")]
        if told.is_file()
        else []
    )
    return names[0] if names else platform.processor() or platform.machine()
