# SPDX-License-Identifier: Apache-2.0
"""The support video of a synthesised view per pixel: how well photos show it, or that it does not count."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

EXCLUDED = 1
"""The level of a pixel that does not count: a person covers it (M of the paper's Eq. 5), or the network did not draw
it. 0 means not in any photo, 255 well seen.
"""
_MIN = 2


def support_levels(
    support: Num[np.ndarray, "H W"], excluded: Bool[np.ndarray, "H W"] | None = None
) -> Integer[np.ndarray, "H W"]:
    """Uint8 of a support in [0, 1]; a supported pixel never rounds down to a hole, ``excluded`` ones do not count.

    Raises ValueError for another shape.
    """
    require("support", support, ("H", "W"))
    levels = np.where(support > 0, np.maximum(np.rint(support * 255), _MIN), 0).astype(np.uint8)
    return levels if excluded is None else np.where(excluded, np.uint8(EXCLUDED), levels)


def support_weight(levels: Integer[np.ndarray, "H W"], hole_weight: float) -> Float[np.ndarray, "H W"]:
    """Float32 weights of a synthesised view in the training of the room.

    1 where photos support a pixel, ``hole_weight`` where none does, 0 where it does not count (paper, Eq. 5: 1 − M).
    Raises ValueError for another shape.
    """
    require("levels", levels, ("H", "W"))
    share = levels.astype(np.float32) / np.float32(255)
    return np.where(levels == EXCLUDED, np.float32(0), share + (1 - share) * np.float32(hole_weight))
