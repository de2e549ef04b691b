# SPDX-License-Identifier: Apache-2.0
"""What a configuration's ``enhancer`` and ``flow`` stand for: the embedded ones, or an upstream network.

The embedded enhancer carries over to the new view what the renders miss at the training cameras (``images.transfer``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.images.flow import dis_flow, grey_levels
from studiorecon.images.transfer import ResidualSource, Transfer, carried_over
from studiorecon.models.choices import EnhancerName, FlowName
from studiorecon.models.loading import load
from studiorecon.models.protocols import Enhancer, Flow, Moment

Preset = Literal["ultrafast", "fast", "medium"]


class Unchanged:
    """The enhancer ``none``: what comes in goes out; injection around it only steadies the picture."""

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        return image


class ResidualTransfer:
    """The enhancer ``residual``: adds ``strength`` × cover × the carried-over residual of the moment."""

    def __init__(
        self, sources_at: Callable[[float], Sequence[ResidualSource]], strength: float, transfer: Transfer
    ) -> None:
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


@dataclass(frozen=True)
class DisFlow:
    """Dense inverse search on luminance; the same everywhere inside ``images.flow.one_thread``."""

    preset: Preset

    def flow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """See ``models.protocols.Flow``."""
        return dis_flow(grey_levels(first), grey_levels(second), self.preset)


def flow_of(name: FlowName, preset: Preset, weights: Path, device: str) -> Flow:
    """The flow of that name; ``weights``: folder of upstream weights, ``device``: auto, cpu or cuda.

    Raises UserError when a network's weights, package or memory are missing.
    """
    if name == "dis":
        return DisFlow(preset)
    return load("flow", name, weights, device)


def network(name: EnhancerName, weights: Path, device: str, seed: int) -> Enhancer:
    """The enhancer of that name that needs nothing but a picture and a photo; ``none`` leaves pictures as they are.

    Raises UserError when a network's weights, package or memory are missing.
    """
    if name == "none":
        return Unchanged()
    return load("picture enhancer", name, weights, device, seed=seed)
