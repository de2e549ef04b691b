# SPDX-License-Identifier: Apache-2.0
"""The light's course: how bright every frame of a film is against its clean plate, from the room's own pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from studiorecon.footage.stills import shrink
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections
from studiorecon.survey.clips import read_pictures
from studiorecon.survey.exposures import ExposureView
from studiorecon.survey.stillness import light

# Frames that are held at a time.
_TOGETHER = 64
# Seconds of one core for a frame, and for a million pixels of it on top: comparing it, decoding and shrinking it
# (measured at 240×136 and 1280×704).
_FRAME_S, _MEGAPIXEL_S = 0.008, 0.013


def cost_s(cameras: Sequence[Camera], frames: int) -> float:
    """Seconds of one core that following the light of all cameras takes, about."""
    return round(frames * sum(_FRAME_S + _MEGAPIXEL_S * c.wh[0] * c.wh[1] / 1e6 for c in cameras), 2)


def course_of(
    path: Path, camera: Camera, frames: int, found: Detections | None, view: ExposureView, longest_px: int
) -> np.ndarray | None:
    """(frames, 3) factors of a film's brightness against its plate, red, green and blue alike; None when no frame can
    be told.

    Frames in which too little of the room is seen take what lies between those before and after. A lamp that changes
    its colour keeps it.
    """
    level = np.concatenate(list(_levels(path, camera, frames, found, view, longest_px)))
    known = np.flatnonzero(np.isfinite(level))
    if not len(known):
        return None
    return np.exp(np.interp(np.arange(frames), known, level[known]))[:, None].repeat(3, axis=1)


def _levels(
    path: Path, camera: Camera, frames: int, found: Detections | None, view: ExposureView, longest_px: int
) -> Iterator[np.ndarray]:
    for first in range(0, frames, _TOGETHER):
        wanted = np.arange(first, min(first + _TOGETHER, frames))
        # Light is larger than a few pixels: half of the survey's size.
        pictures, free, _ = read_pictures(path, camera, wanted, found, longest_px // 2)
        wh = (pictures.shape[2], pictures.shape[1])
        rgb, measured = shrink(view.rgb, view.measured, wh)
        plate = np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
        yield light(np.concatenate([plate[None], pictures]), np.concatenate([measured[None], free]))[0][1:]
