# SPDX-License-Identifier: Apache-2.0
"""The embedded enhancer: what the renders miss at the training cameras is carried over to the new view (``images.transfer``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from studiorecon.images.transfer import Source, Transfer, carried_over
from studiorecon.models.protocols import Moment


class ResidualTransfer:
    """The enhancer ``residual``: adds ``strength`` × cover × the carried-over residual of the moment."""

    def __init__(self, sources_at: Callable[[float], Sequence[Source]], strength: float, transfer: Transfer) -> None:
        self._sources_at, self._strength, self._transfer = sources_at, strength, transfer

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        """The corrected picture; history in it already carries corrections, so only the fresh share is corrected again.

        Without that factor the fixed point of the recursion would be 1 / (1 - w) times the residual.
        """
        if self._strength == 0:
            return image
        residual, cover = carried_over(moment.camera, moment.depth_m, self._sources_at(moment.frame), self._transfer)
        share = self._strength * cover * (1 - moment.injected)
        return np.clip(image + share[..., None] * residual, 0, 1).astype(np.float32)
