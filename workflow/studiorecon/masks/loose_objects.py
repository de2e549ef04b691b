# SPDX-License-Identifier: Apache-2.0
"""Loose and held things are nobody: their pixels teach no person."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.masks.tracks import UNASSIGNED
from studiorecon.scene.camera import Camera
from studiorecon.splatting.rigid_object import RigidObject

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Things reach this much beyond their sphere: they are rarely round.
_GROWN = 1.15


def subtract_objects(
    labels: Integer[np.ndarray, "H W"],
    things: Sequence[RigidObject],
    depths_m: Float[np.ndarray, "K H W"],
    camera: Camera,
    frame: int,
) -> Integer[np.ndarray, "H W"]:
    """(H, W) uint8 labels of one frame with the things' pixels unassigned.

    ``depths_m`` (K, H, W) are the bodies' z-depths, 0 = absent. Before a body a thing hides it, whatever the label;
    beside all bodies it takes what was labelled as somebody; a body before the thing keeps its pixels.
    """
    labels = labels.copy()
    front = np.where(depths_m > 0, depths_m, np.inf).min(axis=0, initial=np.inf)
    for thing in things:
        depth_m = thing.outline(camera, frame, _GROWN)
        shown = (depth_m > 0) & (depth_m < front)
        labels[shown & ((labels > 0) | np.isfinite(front))] = UNASSIGNED
    return labels
