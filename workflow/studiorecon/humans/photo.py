# SPDX-License-Identifier: Apache-2.0
"""``humans.photo``: cuts out the capture's best photo of a person. On request only, for ``canonical``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.video import read_frame, read_frames
from studiorecon.images.encoded import write_png
from studiorecon.progress import say
from studiorecon.scene.people import read_people
from studiorecon.signature import Written


def best_photo(masks: Sequence[Path], label: int) -> tuple[int, int]:
    """(camera index, frame) in which the person covers most pixels and touches neither border nor other masks.

    Raises UserError when there is no such frame.
    """
    best, found = 0, None
    for index, path in enumerate(masks):
        for frame, labels in enumerate(read_frames(path)):
            # Every so many frames one photo is compared.
            if frame % 5:
                continue
            own = labels == label
            size = int(own.sum())
            if size <= best:
                continue
            border = own[0].any() or own[-1].any() or own[:, 0].any() or own[:, -1].any()
            around = cv2.dilate(own.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            if border or ((labels > 0) & ~own & around).any():
                continue
            best, found = size, (index, frame)
    if found is None:
        raise UserError("no frame shows this person whole and alone; give LHM a photo of your own")
    return found


def run(person: str, people: Path, videos: list[Path], masks: list[Path], photo: Written) -> None:
    """Write the best photo of ``person`` as a PNG whose alpha is their mask."""
    names = read_people(people)
    if person not in names:
        raise UserError(f"{people} has no {person}; it holds {', '.join(names)}")
    label = names.index(person) + 1
    index, frame = best_photo(masks, label)
    picture, own = read_frame(videos[index], frame), read_frame(masks[index], frame) == label
    say(f"{person}: the best photo is frame {frame} of {videos[index].stem}")
    write_png(photo, np.dstack([picture, np.where(own, np.uint8(255), np.uint8(0))]))
