# SPDX-License-Identifier: Apache-2.0
"""The walls' yaw without line segments: upright planes in all directions, and the pair that matches most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from studiorecon.depth.stereo.likelihood import CONFIDENT
from studiorecon.depth.stereo.plates import Picture, nats_of_plane
from studiorecon.depth.sweep_settings import Matching
from studiorecon.footage.stills import shrink_plate

# Coarse pictures suffice: a wall 4° off is 20 cm off three metres along, some two pixels at this width.
_WIDTH = 96
_WINDOW = 7
_OFFSET_STEP_M = 0.25
_COARSE_RAD, _FINE_RAD = np.radians(7.5), np.radians(1.5)


def match_yaw(pictures: Sequence[Picture], floor_m: float, reach_m: float, how: Matching) -> float:
    """Yaw in [0, pi/2) at which walls along it and across it explain most pixels above the floor; 0 when none match.

    First every 7.5°, then every 1.5° around the best. Costs some seconds; ``wall_yaw`` needs none when there are lines.
    """
    if sum(bool(picture.known.any()) for picture in pictures) < 2:
        return 0.0
    small = [_shrink(picture) for picture in pictures]
    how = replace(how, window=_WINDOW, mean_weight=1.0)
    floor = [nats_of_plane(small, i, np.array([0.0, 0.0, 1.0, floor_m]), how) for i in range(len(small))]

    @cache
    def walls(half_degrees: int) -> list[np.ndarray]:
        return _nats_of_walls(small, np.radians(half_degrees / 2), reach_m, how)

    def support(yaw_rad: float) -> float:
        along, across = (walls(round(np.degrees((yaw_rad + turn) % np.pi) * 2)) for turn in (0.0, np.pi / 2))
        # Only pixels that the floor does not explain as well.
        gains = (np.minimum(f, CONFIDENT) - np.minimum(one, other) for f, one, other in zip(floor, along, across))
        return sum(float(np.maximum(gain, 0).sum(dtype=np.float64)) for gain in gains)

    start = max(np.arange(0.0, np.pi / 2 - 1e-9, _COARSE_RAD), key=support)
    best = max(start + np.arange(-3, 4) * _FINE_RAD, key=support)
    return float(best % (np.pi / 2)) if support(best) > 0 else 0.0


def _shrink(picture: Picture) -> Picture:
    width, height = picture.camera.wh
    scale = min(1.0, _WIDTH / width)
    wh = (max(round(width * scale), 8), max(round(height * scale), 8))
    rgb, known = shrink_plate(picture.rgb, picture.known, wh)
    return replace(picture, camera=picture.camera.resized(wh), rgb=np.ascontiguousarray(rgb, np.float32), known=known)


def _nats_of_walls(pictures: Sequence[Picture], yaw_rad: float, reach_m: float, how: Matching) -> list[np.ndarray]:
    """Per picture (H, W) least nats of any upright plane with this normal outside the cameras."""
    normal = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
    along = np.array([normal @ p.camera.centre_m for p in pictures])
    offsets = along.mean() + np.arange(-reach_m, reach_m + 1e-9, _OFFSET_STEP_M)
    # Walls are outside the cameras; planes between them are furniture and would only add chance matches.
    best = [np.zeros(p.known.shape, np.float32) for p in pictures]
    for offset in offsets[(offsets > along.max()) | (offsets < along.min())]:
        plane = np.array([*normal, offset])
        best = [np.minimum(b, nats_of_plane(pictures, i, plane, how)) for i, b in enumerate(best)]
    return best
