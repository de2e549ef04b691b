# SPDX-License-Identifier: Apache-2.0
"""Reserves one GPU per job on a machine with several.

Snakemake counts GPUs (``--resources gpu=4``) but does not assign them. A cluster's scheduler does, and its choice is
kept.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from studiorecon.progress import say, warn

_VISIBLE = "CUDA_VISIBLE_DEVICES"
# Open as long as the process lives; the system releases the lock when it ends in any way.
_HELD: list[TextIO] = []


def claim_gpu() -> None:
    """Make one of several GPUs the only visible one for this process; call it before CUDA is initialised.

    If the environment names one GPU, or none, the choice is already made.
    """
    devices = visible_gpus()
    if len(devices) < 2 or _HELD:
        return
    folder = Path(tempfile.gettempdir()) / f"studiorecon-gpus-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    device, held = first_free(devices, folder)
    if held is None:
        device = devices[os.getpid() % len(devices)]
        warn(
            f"GPU {device} is shared with another job: more jobs than GPUs run here; use --resources gpu={len(devices)}"
        )
    else:
        _HELD.append(held)
        say(f"this job has GPU {device} of {', '.join(devices)}")
    os.environ[_VISIBLE] = device


def visible_gpus() -> list[str]:
    """Names of the GPUs that this process may use, as in CUDA_VISIBLE_DEVICES: indices or UUIDs."""
    given = os.environ.get(_VISIBLE)
    if given is not None:
        return [name.strip() for name in given.split(",") if name.strip()]
    if shutil.which("nvidia-smi") is None:
        return []
    answer = subprocess.run(
        ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"], text=True, stdout=subprocess.PIPE
    )
    return answer.stdout.split() if answer.returncode == 0 else []


def first_free(devices: Sequence[str], folder: Path) -> tuple[str, TextIO | None]:
    """The first of ``devices`` whose lock in ``folder`` is free, with the lock; ("", None) when all are taken."""
    for device in devices:
        lock = open(folder / f"{device.replace('/', '_')}.lock", "w")  # noqa: SIM115
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
        else:
            return device, lock
    return "", None
