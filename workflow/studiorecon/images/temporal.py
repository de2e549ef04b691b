# SPDX-License-Identifier: Apache-2.0
"""Inner loops of the temporal measures: where two flows agree, and the change against the warped previous picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.images.warp import SLACK_PX

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num


@numba.njit(cache=True, nogil=True)
def forward_backward_consistent(
    flow: Num[np.ndarray, "H W 2"], reverse_flow: Num[np.ndarray, "H W 2"]
) -> Bool[np.ndarray, "H W"]:
    """Whether |f + r(p + f)|² < 0.01 (|f|² + |r|²) + 0.5 with p + f inside the picture (Sundaram et al. 2010).

    r is read bilinearly; a flow that is not finite fails. 12 ms at 1280×704.
    """
    height, width = flow.shape[:2]
    found = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            u, v = np.float64(flow[y, x, 0]), np.float64(flow[y, x, 1])
            at_x, at_y = x + u, y + v
            # Written so that NaN fails the test.
            if not (
                at_x >= -SLACK_PX
                and at_y >= -SLACK_PX
                and at_x <= width - 1 + SLACK_PX
                and at_y <= height - 1 + SLACK_PX
            ):
                continue
            at_x, at_y = min(max(at_x, 0.0), width - 1.0), min(max(at_y, 0.0), height - 1.0)
            # Unsigned, so that no index is checked for being negative.
            left, top = np.uint64(min(int(at_x), width - 2)), np.uint64(min(int(at_y), height - 2))
            wx, wy = at_x - left, at_y - top
            back_u, back_v = 0.0, 0.0
            for dy in range(np.uint64(2)):
                for dx in range(np.uint64(2)):
                    weight = (wx if dx else 1 - wx) * (wy if dy else 1 - wy)
                    if weight > 0:
                        back_u += weight * reverse_flow[top + dy, left + dx, 0]
                        back_v += weight * reverse_flow[top + dy, left + dx, 1]
            gap = (u + back_u) ** 2 + (v + back_v) ** 2
            found[y, x] = gap < 0.01 * (u * u + v * v + back_u * back_u + back_v * back_v) + 0.5
    return found


@numba.njit(cache=True, nogil=True)
def change(
    current: Integer[np.ndarray, "H W 3"],
    previous: Integer[np.ndarray, "H W 3"],
    flow: Num[np.ndarray, "H W 2"],
    valid: Bool[np.ndarray, "H W"],
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Absolute and squared difference, mean over channels, of ``current`` and ``previous`` warped by ``flow``.

    In units of the range (levels / 255), NaN outside ``valid``. The previous picture is read bilinearly at p + flow(p),
    which must be inside where ``valid``.
    """
    height, width, _ = current.shape
    absolute, square = np.empty((height, width)), np.empty((height, width))
    one = np.uint64(1)
    for y in range(height):
        for x in range(width):
            if not valid[y, x]:
                absolute[y, x] = square[y, x] = np.nan
                continue
            at_x, at_y = x + np.float64(flow[y, x, 0]), y + np.float64(flow[y, x, 1])
            left, top = np.uint64(min(max(int(at_x), 0), width - 2)), np.uint64(min(max(int(at_y), 0), height - 2))
            wx, wy = at_x - left, at_y - top
            sum_absolute, sum_square = 0.0, 0.0
            for c in range(3):
                above = (1 - wx) * previous[top, left, c] + wx * previous[top, left + one, c]
                below = (1 - wx) * previous[top + one, left, c] + wx * previous[top + one, left + one, c]
                gap = (current[y, x, c] - (1 - wy) * above - wy * below) * (1 / 255)
                sum_absolute += abs(gap)
                sum_square += gap * gap
            absolute[y, x], square[y, x] = sum_absolute * (1 / 3), sum_square * (1 / 3)
    return absolute, square
