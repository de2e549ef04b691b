# SPDX-License-Identifier: Apache-2.0
"""The room in one camera's picture, for all modules that use its edges and points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.stills import read_plate
from studiorecon.rig.room_turns import straight_edges

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num


@dataclass(frozen=True)
class RoomPicture:
    """The room as one camera sees it.

    Attributes:
        grey: (H, W) uint8, in the camera's pixels.
        known: (H, W) bool: shows the room without people.
    """

    grey: Integer[np.ndarray, "H W"]
    known: Bool[np.ndarray, "H W"]

    @cached_property
    def edges_px(self) -> Num[np.ndarray, "N 4"]:
        """Ends of its straight edges (``room_turns.straight_edges``), cached because every trial of cameras uses
        them."""
        return straight_edges(self.grey, self.known)


def make_room_picture(plate: Path) -> RoomPicture:
    """A clean plate in grey, with the pixels that people did not always cover as known."""
    rgb, measured = read_plate(plate)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return RoomPicture(np.clip(255 * grey + 0.5, 0, 255).astype(np.uint8), measured)
