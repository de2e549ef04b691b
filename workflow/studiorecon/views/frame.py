# SPDX-License-Identifier: Apache-2.0
"""Maps between the network's picture and ours: the working picture fills 1280×704, and its rest is cut off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.sizes import sample_part, sample_part_nearest
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

# 16:9 footage loses 2 % of its rows in 1280×704; footage that loses more than this share needs another crop.
_MAX_CUT = 0.15


@dataclass(frozen=True)
class NetworkFrame:
    """One network pixel is ``step`` working pixels; its upper left corner is at (row, column) ``start`` of ours."""

    working_hw: tuple[int, int]
    network_hw: tuple[int, int]
    step: float
    start: tuple[float, float]

    def camera(self, camera: Camera) -> Camera:
        """The network's camera for a working camera."""
        move = np.array([[1, 0, -self.start[1]], [0, 1, -self.start[0]], [0, 0, self.step]]) / self.step
        return replace(camera, wh=self.network_hw[::-1], intrinsics=move @ camera.intrinsics)

    def colours(self, picture: Num[np.ndarray, "H W 3"]) -> Float[np.ndarray, "704 1280 3"]:
        """Float32 of a working picture."""
        return sample_part(picture, self.network_hw, self.start, self.step)[0]

    def values(self, values: Num[np.ndarray, "H W"]) -> Num[np.ndarray, "704 1280"]:
        """A working map in the network's frame, without averages across edges."""
        return sample_part_nearest(values, self.network_hw, self.start, self.step)

    def back(self, picture: Float[np.ndarray, "h w 3"]) -> tuple[Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
        """Float32 working picture from a network's, and whether all of the pixel is inside it."""
        start = (-self.start[0] / self.step, -self.start[1] / self.step)
        made, share = sample_part(picture, self.working_hw, start, 1 / self.step)
        # A pixel in the frame's corner has 0.875 of its triangle filter inside along either side.
        return made, share > 0.76


def fit_network_frame(working_hw: tuple[int, int], network_hw: tuple[int, int]) -> NetworkFrame:
    """The centred frame for a working picture; raises UserError when too much of it would be cut off."""
    step = min(ours / theirs for ours, theirs in zip(working_hw, network_hw))
    left = tuple(ours - theirs * step for ours, theirs in zip(working_hw, network_hw))
    cut = 1 - (step * network_hw[0]) * (step * network_hw[1]) / (working_hw[0] * working_hw[1])
    if cut > _MAX_CUT:
        raise UserError(
            f"footage of {working_hw[1]}×{working_hw[0]} would lose {cut:.0%} of its "
            f"picture in {network_hw[1]}×{network_hw[0]}; "
            "set views.synthesizer to warp"
        )
    return NetworkFrame(working_hw, network_hw, step, (left[0] / 2, left[1] / 2))
