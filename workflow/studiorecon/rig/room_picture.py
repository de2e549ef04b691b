# SPDX-License-Identifier: Apache-2.0
"""The room as one camera sees it, for whatever looks for edges and places in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.stills import read_plate

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer


@dataclass(frozen=True)
class RoomPicture:
    """The room as one camera sees it.

    Attributes:
        grey: (H, W) uint8, in the camera's pixels.
        known: (H, W) whether it shows the room there, and nobody.
    """

    grey: Integer[np.ndarray, "H W"]
    known: Bool[np.ndarray, "H W"]


def room_of(plate: Path) -> RoomPicture:
    """A clean plate in grey, and where people never left it unseen."""
    rgb, measured = read_plate(plate)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return RoomPicture(np.clip(255 * grey + 0.5, 0, 255).astype(np.uint8), measured)
