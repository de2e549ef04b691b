# SPDX-License-Identifier: Apache-2.0
"""The empty room in every camera's footage and its straight edges, from the static content while people pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.geometry.lens import video_from_working
from studiorecon.progress import warn
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera, Lens

if TYPE_CHECKING:
    from jaxtyping import Integer

# Pictures whose median is the room, spread over the footage; a pixel moves where half of them differ from it by so many
# grey levels.
_PICTURES = 9
_STILL_LEVELS = 12
_STRIP_ROWS = 256
# Pictures are read by their number: the rate of a folder of them does not matter.
_ANY_FPS = 30.0


def read_room_pictures(
    cameras: Sequence[str],
    sources: Sequence[Path],
    size: Mapping[str, tuple[int, int]],
    moments: Mapping[str, Integer[np.ndarray, " T"]] | None = None,
) -> dict[str, RoomPicture]:
    """camera → the room in the pixels of its footage of ``size``; unreadable footage is skipped with a message.

    ``moments``: camera → frames of its footage to use; else all of it.
    """
    found = {}
    for camera, path in zip(cameras, sources):
        try:
            source = open_source(path, _ANY_FPS)
            among = np.arange(source.frames) if moments is None else moments[camera]
            wanted = among[spread_indices(len(among), _PICTURES)].tolist()
            seen = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in seek_frames(source, wanted)]
        except UserError as refusal:
            warn(f"the room's edges in camera {camera} are not used: {refusal}")
            continue
        if camera in size and seen and seen[0].shape[::-1] == tuple(size[camera]):
            room = (_double_median(seen) // 2).astype(np.uint8)
            difference = _double_median([cv2.absdiff(picture, room) for picture in seen])
            found[camera] = RoomPicture(room, difference < 2 * _STILL_LEVELS)
    return found


def _double_median(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """(H, W) uint16 twice the median of a few (H, W) uint8 pictures at every pixel.

    Whole pictures are exchanged until they are in order, in a tenth of the time that numpy takes to sort each pixel's
    few values.
    """
    ordered = [picture.copy() for picture in pictures]
    for turn in range(len(ordered)):
        for k in range(turn % 2, len(ordered) - 1, 2):
            lower, upper = ordered[k], ordered[k + 1]
            ordered[k], ordered[k + 1] = np.minimum(lower, upper), np.maximum(lower, upper)
    middle: np.ndarray = ordered[(len(ordered) - 1) // 2].astype(np.uint16) + ordered[len(ordered) // 2]
    return middle


def without_distortion(room: RoomPicture, lens: Lens, camera: Camera) -> RoomPicture:
    """The room filmed through ``lens``, as seen by the pinhole ``camera`` of the same size; unknown outside of the
    footage."""
    grey, known = np.zeros(camera.wh[::-1], np.uint8), np.zeros(camera.wh[::-1], bool)
    filmed = room.known.astype(np.uint8)
    # In strips: the map of every pixel of a large picture would take half a gigabyte.
    for first in range(0, camera.wh[1], _STRIP_ROWS):
        rows, columns = np.mgrid[first : min(first + _STRIP_ROWS, camera.wh[1]), : camera.wh[0]] + 0.5
        at = video_from_working(np.stack([columns, rows], axis=-1), lens, camera.wh, camera.intrinsics) - 0.5
        x, y = np.moveaxis(at.astype(np.float32), -1, 0)
        strip = slice(first, first + _STRIP_ROWS)
        grey[strip] = cv2.remap(room.grey, x, y, cv2.INTER_LINEAR)
        known[strip] = cv2.remap(filmed, x, y, cv2.INTER_NEAREST) > 0
    return RoomPicture(grey, known)
