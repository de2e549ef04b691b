# SPDX-License-Identifier: Apache-2.0
"""Draws an overview of a scene: the training photos of one moment above synthesised views.

``python -m studiorecon report.picture --videos results/demo/capture/cam*.mkv --film results/demo/enhance/orbit.mkv
--frame 30
--picture overview.jpg``
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.video import read_frame, read_frames
from studiorecon.images.encoded import jpeg
from studiorecon.progress import say
from studiorecon.scene.files import atomic_path

if TYPE_CHECKING:
    from jaxtyping import Integer


def overview(
    photos: list[Integer[np.ndarray, "h w 3"]], views: list[Integer[np.ndarray, "h w 3"]], gap_px: int = 6
) -> Integer[np.ndarray, "H W 3"]:
    """``photos`` in a row, scaled to the width of the row of larger ``views`` below them."""
    below = _row(views, gap_px)
    above = _row(photos, gap_px)
    scale = below.shape[1] / above.shape[1]
    above = cv2.resize(above, (below.shape[1], round(above.shape[0] * scale)), interpolation=cv2.INTER_AREA)
    return np.concatenate([above, np.full((gap_px, below.shape[1], 3), 255, np.uint8), below])


def _row(pictures: list[np.ndarray], gap_px: int) -> np.ndarray:
    height = min(p.shape[0] for p in pictures)
    gap = np.full((height, gap_px, 3), 255, np.uint8)
    parts = [part for p in pictures for part in (p[:height], gap)]
    return np.concatenate(parts[:-1], axis=1)


def run(videos: list[Path], film: Path, picture: Path, frame: int = 0, views: int = 3) -> None:
    """Write a JPEG with ``frame`` of every video above ``views`` pictures spread over the film."""
    count = sum(1 for _ in read_frames(film))
    chosen = [read_frame(film, int(i)) for i in (np.arange(views) * count) // views + count // (2 * views)]
    made = overview([read_frame(video, frame) for video in videos], chosen)
    with atomic_path(picture) as partial:
        partial.write_bytes(jpeg(made, 85))
    say(f"{len(videos)} photos and {len(chosen)} views are in {picture}")
