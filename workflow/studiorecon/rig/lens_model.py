# SPDX-License-Identifier: Apache-2.0
"""Reads distortion numbers under another lens model, for files with a missing or wrong lens type."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from studiorecon.scene.camera import Lens

LensReading = Literal["as_read", "opencv", "fisheye"]


def reinterpret_lens(lens: Lens, model: LensReading) -> Lens:
    """The lens with its first four coefficients read as those of ``model``: both models have four numbers."""
    if model in ("as_read", lens.model):
        return lens
    both = [
        np.pad(own[:4], (0, (4 if model == "fisheye" else 8) - len(own[:4]))) if len(own) else own
        for own in (lens.distortion, lens.keypoint_distortion)
    ]
    return replace(lens, model=model, distortion=both[0], keypoint_distortion=both[1])


def add_radial_term(lens: Lens, k1: float) -> Lens:
    """The lens with ``k1`` added to its first coefficient, for a small distortion that remained after removing the
    lens's own."""
    if k1 == 0.0:
        return lens
    more = np.zeros(max(1, len(lens.distortion)))
    more[: len(lens.distortion)] = lens.distortion
    more[0] += k1
    return replace(lens, distortion=more)
