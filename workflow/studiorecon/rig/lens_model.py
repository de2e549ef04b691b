# SPDX-License-Identifier: Apache-2.0
"""Reads distortion numbers under another lens model, for files with a missing or wrong lens type."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from studiorecon.scene.camera import Lens

LensReading = Literal["as_read", "opencv", "fisheye"]


def as_model(lens: Lens, model: LensReading) -> Lens:
    """The lens with its first four coefficients read as those of ``model``: both models have four numbers."""
    if model in ("as_read", lens.model):
        return lens
    four = np.zeros(4)
    four[: min(4, len(lens.distortion))] = lens.distortion[:4]
    return replace(lens, model=model, distortion=four if model == "fisheye" else np.append(four, np.zeros(4)))


def with_radial(lens: Lens, k1: float) -> Lens:
    """The lens with ``k1`` added to its first coefficient, for a small distortion that remained after removing the
    lens's own."""
    if k1 == 0.0:
        return lens
    more = np.zeros(max(1, len(lens.distortion)))
    more[: len(lens.distortion)] = lens.distortion
    more[0] += k1
    return replace(lens, distortion=more)
