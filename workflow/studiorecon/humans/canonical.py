# SPDX-License-Identifier: Apache-2.0
"""``humans.canonical``: a person of the capture in a rest pose by a network, from the best photo there is of them. On
request only.

Writes a canonical ``.ply`` (3DGS layout, SMPL's body axes), for replacing somebody, and the photo it was made from.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.video import read_frame, read_frames
from studiorecon.images.encoded import write_png
from studiorecon.models.catalogue.selection import CANONICAL
from studiorecon.models.loading import load
from studiorecon.progress import say
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.scene.people import read_people
from studiorecon.signature import Place, Written

# Photos are compared at every so many frames.
_STEP = 5


def best_photo(masks: Sequence[Path], label: int) -> tuple[int, int]:
    """(camera index, frame) in which the person covers most pixels without touching the border or somebody else's mask.

    Raises UserError when there is no such frame.
    """
    best, found = 0, None
    for index, path in enumerate(masks):
        for frame, labels in enumerate(read_frames(path)):
            if frame % _STEP:
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
        raise UserError(
            "there is no frame in which this person is whole and alone in the picture; bring a photo of your own to LHM"
        )
    return found


def run(
    person: str, people: Path, videos: list[Path], masks: list[Path], weights: Place, gaussians: Written, photo: Written
) -> None:
    """Write the canonical Gaussians of ``person`` and the photo they come from."""
    names = read_people(people)
    if person not in names:
        raise UserError(f"{people} has no {person}; it holds {', '.join(names)}")
    label = names.index(person) + 1
    network = load("canonical avatar", CANONICAL, weights, "cuda")
    index, frame = best_photo(masks, label)
    picture, mask = read_frame(videos[index], frame), read_frame(masks[index], frame) == label
    say(f"{person}: the best photo is frame {frame} of {videos[index].stem}")
    made = network.avatar(picture, mask)
    say(f"{person}: {made.count} Gaussians in the rest pose, {np.ptp(made.means_m[:, 1]):.2f} m high")
    write_png(photo, np.where(mask[..., None], picture, np.uint8(255)))
    write_ply(gaussians, made)
