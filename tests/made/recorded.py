# SPDX-License-Identifier: Apache-2.0
"""Recorded keypoints as ``detect.keypoints`` leaves them, of which no film is there to be compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.scene.recorded_keypoints import write_recorded


def taken_over(keypoints: Path, out: Path, layout: str = "auto", first: int = 0) -> Path:
    """Write the keypoints of a file, whose number ``first`` is the film's first frame, to ``out``, and return that."""
    given = read_keypoints(keypoints)
    chosen, _ = choose_layout(given.keypoints, layout, str(keypoints))
    write_recorded(out, replace(given.renumbered(given.pictures - first, 10**9), layout=chosen))
    return out
