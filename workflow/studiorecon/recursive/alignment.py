# SPDX-License-Identifier: Apache-2.0
"""Flow from the current picture to earlier ones, between the raw renders: direct to each, or chained over those between
(U06).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.flow import chain_flow, consistent
from studiorecon.models.protocols import Flow
from studiorecon.recursive.injection import Injection

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class Past:
    """An earlier picture of the film.

    Attributes:
        output: (H, W, 3) float32 output of the enhancer.
        render: (H, W, 3) uint8 its raw render.
        flow, valid: (H, W, 2) flow to the picture before it and (H, W) where it is valid; None for the first of a
            segment.
    """

    output: Float[np.ndarray, "H W 3"]
    render: Integer[np.ndarray, "H W 3"]
    flow: Float[np.ndarray, "H W 2"] | None
    valid: Bool[np.ndarray, "H W"] | None


def backward_flow(
    picture: Integer[np.ndarray, "H W 3"], past: Integer[np.ndarray, "H W 3"], search: Flow, check: bool
) -> tuple[Float[np.ndarray, "H W 2"], Bool[np.ndarray, "H W"]]:
    """Flow (H, W, 2) from a picture to an earlier one, and (H, W) bool where the forward flow agrees; everywhere
    without ``check``.
    """
    if picture.shape != past.shape:
        raise UserError(f"optical flow needs pictures of one size, not {picture.shape[1::-1]} and {past.shape[1::-1]}")
    backward = search.flow(picture, past)
    if not check:
        return backward, np.isfinite(backward[..., 0]) & np.isfinite(backward[..., 1])
    return backward, consistent(backward, search.flow(past, picture))


def flows_back(
    picture: Integer[np.ndarray, "H W 3"], history: Sequence[Past], injection: Injection, search: Flow, pool: Executor
) -> list[tuple[Float[np.ndarray, "H W 2"], Bool[np.ndarray, "H W"]]]:
    """Flow and validity from the current picture to every earlier one, latest first.

    ``chain_flow`` costs one search per picture whatever the history, and accumulates the errors of its links;
    ``direct`` searches once per earlier picture. In both cases every stored output is warped once (E08).
    """
    if injection.flow == "direct":
        return list(pool.map(lambda past: backward_flow(picture, past.render, search, injection.check), history))
    found = [backward_flow(picture, past.render, search, injection.check) for past in list(history)[:1]]
    for past in list(history)[:-1]:
        if past.flow is None or past.valid is None:
            raise ValueError("history holds a picture without its flow to the picture before it")
        found.append(chain_flow(*found[-1], past.flow, past.valid))
    return found
