# SPDX-License-Identifier: Apache-2.0
"""What lens, clock and readout have in common: the width that pixels are meant at, and people who move too little."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.rig.residuals import Causes
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Pixels are meant at this width; working frames of another have as much less or more.
AT_WIDTH = 1280.0
_SLOWEST_PX = 5.0


def too_slow(cameras: Sequence[Camera], found: Causes) -> str:
    """Why clocks cannot be told apart, where people move too little; else empty."""
    speed = found.speed_px[0] * AT_WIDTH / max(max(c.wh) for c in cameras)
    if speed >= _SLOWEST_PX:
        return ""
    return (
        f"people move by {speed:.1f} px per frame (at {AT_WIDTH:.0f} wide); below "
        f"{_SLOWEST_PX:.0f} clocks cannot be told apart"
    )


def by_camera(cameras: Sequence[Camera], values: Float[np.ndarray, " V"]) -> dict[str, float]:
    """Camera → its value (V,), rounded; those that are unknown are left out."""
    return {c.name: round(float(v), 4) for c, v in zip(cameras, values) if np.isfinite(v)}
