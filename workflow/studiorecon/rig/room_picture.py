# SPDX-License-Identifier: Apache-2.0
"""The room as one camera sees it, for whatever looks for edges and places in it."""

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
        known: (H, W) whether it shows the room there, and nobody.
    """

    grey: Integer[np.ndarray, "H W"]
    known: Bool[np.ndarray, "H W"]

    @cached_property
    def edges_px(self) -> Num[np.ndarray, "N 4"]:
        """(N, 4) ends of its straight edges (``room_turns.straight_edges``), found once: whoever tries cameras asks
        again for each."""
        return straight_edges(self.grey, self.known)


def make_room_picture(plate: Path) -> RoomPicture:
    """A clean plate in grey, and where people never left it unseen."""
    rgb, measured = read_plate(plate)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return RoomPicture(np.clip(255 * grey + 0.5, 0, 255).astype(np.uint8), measured)
