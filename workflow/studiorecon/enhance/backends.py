# SPDX-License-Identifier: Apache-2.0
"""The enhancers of the setting ``enhancer``: the embedded one, or an upstream network.

The embedded enhancer transfers to a new view the difference between photos and renders of the training cameras
(``images.transfer``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.images.transfer import ResidualSource, Transfer, transfer_residual
from studiorecon.models.choices import EnhancerName
from studiorecon.models.loading import load
from studiorecon.models.protocols import Enhancer, Moment

if TYPE_CHECKING:
    from jaxtyping import Float, Num


class Unchanged:
    """The enhancer ``none``: returns its input; injection around it only makes the picture steadier."""

    def enhance(
        self, image: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "h w 3"], moment: Moment
    ) -> Float[np.ndarray, "H W 3"]:
        return image


class ResidualTransfer:
    """The enhancer ``residual``: adds ``strength`` × cover × the transferred residual of the moment."""

    def __init__(
        self, sources_at: Callable[[float], Sequence[ResidualSource]], strength: float, transfer: Transfer
    ) -> None:
        self._sources_at, self._strength, self._transfer = sources_at, strength, transfer

    def enhance(
        self, image: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "h w 3"], moment: Moment
    ) -> Float[np.ndarray, "H W 3"]:
        """The corrected picture; injected history is already corrected, so only the fresh share is corrected.

        Without that factor the fixed point of the recursion would be 1 / (1 - w) times the residual.
        """
        if self._strength == 0:
            return image
        residual, cover = transfer_residual(
            moment.camera, moment.depth_m, self._sources_at(moment.frame), self._transfer
        )
        share = self._strength * cover * (1 - moment.injected)
        return np.clip(image + share[..., None] * residual, 0, 1).astype(np.float32)


def load_enhancer(name: EnhancerName, weights: Path, device: str, seed: int) -> Enhancer:
    """The enhancer of that name that needs only a picture and a photo; ``none`` leaves pictures as they are.

    Raises UserError when a network's weights, package or memory are missing.
    """
    if name == "none":
        return Unchanged()
    return load("picture enhancer", name, weights, device, seed=seed)
