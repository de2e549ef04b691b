# SPDX-License-Identifier: Apache-2.0
"""Flow from the current picture to earlier ones between the raw renders, direct or chained over those between (U06)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.flow import is_flow_consistent
from studiorecon.models.protocols import Flow

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class Past:
    """An earlier picture of the film: the enhancer's float32 output, and its raw render."""

    output: Float[np.ndarray, "H W 3"]
    render: Integer[np.ndarray, "H W 3"]


def backward_flow(
    picture: Integer[np.ndarray, "H W 3"], past: Integer[np.ndarray, "H W 3"], search: Flow, check: bool
) -> tuple[Float[np.ndarray, "H W 2"], Bool[np.ndarray, "H W"]]:
    """Flow from a picture to an earlier one, and where the forward flow agrees; everywhere without ``check``."""
    if picture.shape != past.shape:
        raise UserError(f"optical flow needs pictures of one size, not {picture.shape[1::-1]} and {past.shape[1::-1]}")
    backward = search.flow(picture, past)
    if not check:
        return backward, np.isfinite(backward[..., 0]) & np.isfinite(backward[..., 1])
    return backward, is_flow_consistent(backward, search.flow(past, picture))
