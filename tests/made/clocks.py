# SPDX-License-Identifier: Apache-2.0
"""Clocks of cameras whose frames are counted."""

from __future__ import annotations

from studiorecon.scene.clocks import Clock, Clocks


def as_counted(camera: str, fps: float, first: int, frames: int) -> Clocks:
    """One camera whose working frames are its frames ``first`` … ``first`` + ``frames`` - 1."""
    return Clocks(fps, first / fps, frames, (Clock(camera, fps, first + frames),))
