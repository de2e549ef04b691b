# SPDX-License-Identifier: Apache-2.0
"""The empty room in every camera's footage, and its straight edges: what stays where it is while people pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.source import open_source, stills
from studiorecon.progress import warn
from studiorecon.rig.floor_marks import RoomPicture
from studiorecon.rig.room_turns import straight_edges

if TYPE_CHECKING:
    from jaxtyping import Float

# Pictures whose median is the room, spread over the footage; where half of them are so many grey levels beside it,
# something moves.
_PICTURES = 9
_STILL_LEVELS = 12
# Pictures are read by their number: the rate of a folder of them does not matter.
_ANY_FPS = 30.0


def rooms_of(
    cameras: Sequence[str], sources: Sequence[Path], size: Mapping[str, tuple[int, int]]
) -> dict[str, RoomPicture]:
    """camera → the room in the pixels of its footage of ``size``; without the cameras whose footage cannot be read,
    which is said."""
    found = {}
    for camera, path in zip(cameras, sources):
        try:
            source = open_source(path, _ANY_FPS)
            total = source.declared_frames or 1
            wanted = sorted({round(k * (total - 1) / (_PICTURES - 1)) for k in range(_PICTURES)})
            seen = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in stills(source, wanted)]
        except UserError as refusal:
            warn(f"the room is not looked at in camera {camera}: {refusal}")
            continue
        if camera in size and seen and seen[0].shape[::-1] == tuple(size[camera]):
            stack = np.stack(seen)
            room = np.median(stack, axis=0).astype(np.uint8)
            beside = np.abs(stack.astype(np.int16) - room)
            found[camera] = RoomPicture(room, np.median(beside, axis=0) < _STILL_LEVELS)
    return found


def edges_of(rooms: Mapping[str, RoomPicture]) -> dict[str, Float[np.ndarray, "N 4"]]:
    """camera → (N, 4) ends of the straight edges of its room, pixels."""
    return {name: straight_edges(room.grey) for name, room in rooms.items()}
