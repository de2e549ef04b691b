# SPDX-License-Identifier: Apache-2.0
"""Opens networks in ONNX, for the CPU. All modules open theirs here, so that none reports its use."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from studiorecon.errors import UserError
from studiorecon.machine.resource_errors import is_memory_error

if TYPE_CHECKING:
    import onnxruntime


def open_network(path: Path, remedy: str, threads: int = 1) -> onnxruntime.InferenceSession:
    """A network on so many cores (0: all); raises UserError with ``remedy`` where a file is missing or no network."""
    # From 1.32 on ONNX Runtime reports its use to Microsoft, and keeps a file in the user's cache, unless this is set
    # before it is loaded. Nothing here leaves the machine.
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    if not path.is_file():
        raise UserError(f"network {path} is missing; {remedy}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen types of its own, without a common base
        if is_memory_error(error):
            raise
        raise UserError(f"{path} cannot be read as an ONNX network ({str(error).splitlines()[0]}); {remedy}") from None
