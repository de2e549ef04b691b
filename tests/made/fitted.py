# SPDX-License-Identifier: Apache-2.0
"""A fitted person of whom a test says what it needs."""

from __future__ import annotations

import numpy as np
from studiorecon.scene.people import Person


def fitted_person(name: str, body: str, fps: float, frames: int, **messages: np.ndarray) -> Person:
    """What is not ``said`` is 0, and every frame is valid."""
    usual = {
        "poses": np.zeros((frames, 72)),
        "trans": np.zeros((frames, 3)),
        "betas": np.zeros(10),
        "joints": np.zeros((frames, 24, 3)),
        "valid": np.ones(frames, bool),
        "sigma": np.zeros((frames, 24)),
    }
    return Person(name, body, fps, **usual | messages, metric=True)
