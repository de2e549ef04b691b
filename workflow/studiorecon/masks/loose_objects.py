# SPDX-License-Identifier: Apache-2.0
"""Removes the pixels of loose and carried objects from the masks, so that they train no person."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.images.palette import UNASSIGNED
from studiorecon.scene.camera import Camera
from studiorecon.splatting.rigid_object import RigidObject

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


def subtract_objects(
    labels: Integer[np.ndarray, "H W"],
    things: Sequence[RigidObject],
    depths_m: Float[np.ndarray, "K H W"],
    camera: Camera,
    frame: int,
) -> Integer[np.ndarray, "H W"]:
    """Labels of one frame with the objects' pixels unassigned.

    An object in front of a body (z-depth, 0 = absent) hides it, whatever the label. Outside of all bodies it takes
    pixels labelled as a person; a body in front of the object keeps its pixels.
    """
    labels = labels.copy()
    front = np.where(depths_m > 0, depths_m, np.inf).min(axis=0, initial=np.inf)
    for thing in things:
        # Objects extend this much beyond their sphere, because they are rarely round.
        depth_m = thing.outline(camera, frame, 1.15)
        shown = (depth_m > 0) & (depth_m < front)
        labels[shown & ((labels > 0) | np.isfinite(front))] = UNASSIGNED
    return labels
