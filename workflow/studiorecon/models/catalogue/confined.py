# SPDX-License-Identifier: Apache-2.0
"""What upstream code may not do in a run, however it is written: fetch anything, or run code that lies in a checkpoint.

Both are told by variables, which hub clients read when they are imported and torch at every load, also in programs
that a step starts. torch's overrules a call that says ``weights_only=False``, as two networks' code does.
"""

from __future__ import annotations

import os

OFFLINE = {"HF_HUB_OFFLINE": "1", "TRANSFORMERS_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
"""Variables that hub clients read when they are imported."""
SILENT = {"ORT_DISABLE_TELEMETRY": "1", "HF_HUB_DISABLE_TELEMETRY": "1", "DO_NOT_TRACK": "1"}
"""With them libraries tell nobody that they are used; ONNX Runtime 1.32 does unless it is told not to."""
ARRAYS_ONLY = {"TORCH_FORCE_WEIGHTS_ONLY_LOAD": "1"}
"""With it ``torch.load`` makes tensors and plain containers of a file, and refuses whatever else it asks for."""


def confine() -> None:
    """Tell this process, and those it starts, to fetch nothing and to unpickle nothing but arrays."""
    os.environ.update(OFFLINE | SILENT | ARRAYS_ONLY)


def may_fetch() -> None:
    """Lift the first for this process; only ``snakemake weights`` does."""
    for variable in OFFLINE:
        os.environ.pop(variable, None)
