# SPDX-License-Identifier: Apache-2.0
"""A temporal network's residuals at any time of a film: evaluated once per frame and interpolated between frames.

The network was trained at whole frames. Between two frames its residuals are interpolated linearly, as body positions
are. Films that show a frame several times, or from several cameras, evaluate it once.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.avatar.temporal import TemporalNetwork

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Size of the cache in bytes: a thousand frames of some hundred points, or a hundred of ten thousand Gaussians.
_KEPT = 1 << 26


class Drift:
    """A network at the Gaussians that it was made for."""

    def __init__(self, network: TemporalNetwork, means_m: Num[np.ndarray, "N 3"]) -> None:
        """Cache the network's residuals for Gaussians at ``means_m`` in the rest pose."""
        self._network, self._means_m = network, means_m
        rows = len(means_m) if network.control is None else len(network.control.points_m)
        self._answers = lru_cache(max(2, _KEPT // max(16 * rows, 1)))(self._evaluate)

    def residuals(self, frame: float) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
        """Residuals of the constant harmonic and of the logit opacity, float32, at a frame, clamped to the clip."""
        at = float(np.clip(frame, 0, self._network.frames - 1))
        low = int(at)
        found, share = self._answers(low), np.float32(at - low)
        if share:
            found = (1 - share) * found + share * self._answers(low + 1)
        if self._network.control is not None:
            found = self._network.control.spread(found)
        return found[:, :3], found[:, 3]

    def _evaluate(self, frame: int) -> np.ndarray:
        if self._network.control is not None:
            return self._network.at_points(frame)
        colour, logit = self._network.residuals(self._means_m, frame)
        return np.concatenate([colour, logit[:, None]], axis=1)
