# SPDX-License-Identifier: Apache-2.0
"""ꟻLIP: the difference a viewer sees when two pictures alternate (Andersson et al., HPG 2020), by its authors' package.

A perceptual distance without weights; not comparable with LPIPS. The package has no wheel for every Python; where it
does not load there is no number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.images.metrics import to_levels

if TYPE_CHECKING:
    from jaxtyping import Num

SMALLEST_PX = 11
"""Side of a picture below which its filters, which reach that far, see mostly what is not there."""


def is_available() -> bool:
    """Whether the package can be loaded."""
    try:
        import flip_evaluator  # noqa: F401
    except (ImportError, OSError):  # no wheel for this Python, or a system without its C++ library
        return False
    return True


def flip(prediction: Num[np.ndarray, "H W 3"], truth: Num[np.ndarray, "H W 3"]) -> float | None:
    """Mean LDR-ꟻLIP of two sRGB pictures, uint8 or float in [0, 1], 0 = the same; None under 11 pixels a side.

    At 67 pixels per degree: a 4K screen at 0.7 m. The mean is computed here, in float64: the package's own depends on
    its threads. 0.2 s at 480×270. Raises ValueError for pictures of two sizes, ImportError where the package does not
    load.
    """
    require("truth", truth, ("H", "W", 3), require("prediction", prediction, ("H", "W", 3)))
    if min(truth.shape[:2]) < SMALLEST_PX:
        return None
    import flip_evaluator

    wanted, shown = (np.ascontiguousarray(to_levels(p), np.float32) / np.float32(255) for p in (truth, prediction))
    seen, _, _ = flip_evaluator.evaluate(wanted, shown, "LDR", applyMagma=False, computeMeanError=False)
    return float(seen.mean(dtype=np.float64))
