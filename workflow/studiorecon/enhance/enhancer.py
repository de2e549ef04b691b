# SPDX-License-Identifier: Apache-2.0
"""The enhancer that does nothing, and the check that recursion through an enhancer stays stable."""

from __future__ import annotations

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.models.protocols import Enhancer, Moment

# An enhancer may brighten a flat field by this much before its recursion drifts visibly (numerics E14: 5 % becomes 7 %).
_LARGEST_GAIN = 1.02


class Unchanged:
    """The enhancer ``none``: what comes in goes out; injection around it only steadies the picture."""

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        return image


def loop_gain(enhancer: Enhancer, reference: np.ndarray, moment: Moment) -> float:
    """How much the enhancer amplifies a change of a flat field: the mean response to +0.2, as a multiple of 0.2."""
    flat = np.full((*moment.depth_m.shape, 3), 0.4, np.float32)
    low, high = enhancer.enhance(flat, reference, moment), enhancer.enhance(flat + np.float32(0.2), reference, moment)
    return float((high.astype(np.float64) - low).mean() / 0.2)


def check_gain(gain: float, strength: float) -> None:
    """Raises Refusal when outputs fed back with share ``strength`` would diverge (w·g ≥ 1) or visibly drift (g > 1.02)."""
    if not np.isfinite(gain) or strength * gain >= 1 or (strength > 0 and gain > _LARGEST_GAIN):
        raise Refusal(
            f"the enhancer multiplies a flat field by {gain:.3f}, so feeding its outputs back with share {strength} would brighten "
            "the film frame by frame; set enhance.injection.history to 0 or use another enhancer"
        )
