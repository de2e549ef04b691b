# SPDX-License-Identifier: Apache-2.0
"""Opens the user's own network behind BlazePose, of either kind."""

from __future__ import annotations

from pathlib import Path

from studiorecon.detector.one_stage import OneStage, is_one_stage
from studiorecon.detector.top_down import TopDown
from studiorecon.errors import UserError
from studiorecon.machine.onnx_network import open_network

SecondNetwork = TopDown | OneStage


def second_network(files: list[Path], layout: str) -> SecondNetwork | None:
    """The network of a list of one file, or None for an empty list; raises UserError for a file that is no such
    network."""
    if not files:
        return None
    (path,) = files
    session = open_network(path, "set detect.network to a readable file")
    if (kind := session.get_inputs()[0].type) != "tensor(float)":
        raise UserError(f"{path} takes {kind}; detect.network must take float32: export it again")
    return OneStage(session, path, layout) if is_one_stage(session) else TopDown(session, path, layout)
