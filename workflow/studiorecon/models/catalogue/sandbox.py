# SPDX-License-Identifier: Apache-2.0
"""Prevents upstream code from fetching anything in a run, or from running code in a checkpoint.

Both use environment variables, which hub clients read at import and torch at every load, also in programs that a step
starts. torch's overrules calls with ``weights_only=False``, which two networks' code makes.
"""

from __future__ import annotations

import os

OFFLINE = {"HF_HUB_OFFLINE": "1", "TRANSFORMERS_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
"""Variables that hub clients read when they are imported."""
SILENT = {"ORT_DISABLE_TELEMETRY": "1", "HF_HUB_DISABLE_TELEMETRY": "1", "DO_NOT_TRACK": "1"}
"""Variables that switch off telemetry of libraries; ONNX Runtime 1.32 sends it unless it is switched off."""
ARRAYS_ONLY = {"TORCH_FORCE_WEIGHTS_ONLY_LOAD": "1"}
"""With it ``torch.load`` reads tensors and plain containers from a file, and refuses anything else."""


def confine_process() -> None:
    """Forbid this process, and those it starts, to fetch anything or to unpickle anything but arrays."""
    os.environ.update(OFFLINE | SILENT | ARRAYS_ONLY)


def allow_fetching() -> None:
    """Allow this process to fetch; only ``snakemake weights`` does that."""
    for variable in OFFLINE:
        os.environ.pop(variable, None)
