# SPDX-License-Identifier: Apache-2.0
"""The walls' yaw without line segments: upright planes in all directions, and the pair that matches most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from studiorecon.depth.stereo.planes import rig_centre
from studiorecon.depth.stereo.plates import Picture, best_score
from studiorecon.depth.sweep_settings import Matching
from studiorecon.footage.stills import shrink_plate

# Coarse pictures suffice: a wall 4° off is 20 cm off three metres along, some two pixels at this width.
_WIDTH = 96
_WINDOW = 7
_OFFSET_STEP_M = 0.25
# Score above which a pixel counts as a match; chance matches of a coarse picture reach a little less.
_SPEAKS = 0.7
_COARSE_RAD, _FINE_RAD = np.radians(7.5), np.radians(1.5)


def match_yaw(pictures: Sequence[Picture], floor_m: float, reach_m: float, how: Matching) -> float:
    """Yaw in [0, pi/2) at which walls along it and across it explain most pixels above the floor; 0 when none match.

    First every 7.5°, then every 1.5° around the best. Costs some seconds; ``wall_yaw`` needs none when there are lines.
    """
    if sum(bool(picture.known.any()) for picture in pictures) < 2:
        return 0.0
    small = [_shrink(picture) for picture in pictures]
    floor = np.array([0.0, 0.0, 1.0, floor_m])
    how = replace(how, window=_WINDOW, mean_weight=1.0)
    floor_scores = [best_score(small, i, floor, how) for i in range(len(small))]
    explained: dict[int, list[np.ndarray]] = {}

    def support(yaw_rad: float) -> float:
        total = 0.0
        walls = []
        for turn in (0.0, np.pi / 2):
            key = round(np.degrees((yaw_rad + turn) % np.pi) * 2)
            if key not in explained:
                explained[key] = _best_agreement(small, np.radians(key / 2), reach_m, how)
            walls.append(explained[key])
        for one, across, below in zip(*walls, floor_scores):
            # Only pixels that the floor does not explain as well.
            best = np.maximum(one, across)
            total += float(np.clip(best - np.maximum(below, _SPEAKS), 0, None).sum(dtype=np.float64))
        return total

    coarse = np.arange(0.0, np.pi / 2 - 1e-9, _COARSE_RAD)
    start = max(coarse, key=support)
    near = start + np.arange(-3, 4) * _FINE_RAD
    best = max(near, key=support)
    return float(best % (np.pi / 2)) if support(best) > 0 else 0.0


def _shrink(picture: Picture) -> Picture:
    width, height = picture.camera.wh
    scale = min(1.0, _WIDTH / width)
    wh = (max(round(width * scale), 8), max(round(height * scale), 8))
    rgb, known = shrink_plate(picture.rgb, picture.known, wh)
    return replace(picture, camera=picture.camera.resized(wh), rgb=np.ascontiguousarray(rgb, np.float32), known=known)


def _best_agreement(pictures: Sequence[Picture], yaw_rad: float, reach_m: float, how: Matching) -> list[np.ndarray]:
    """Per picture (H, W) best agreement through any upright plane with this normal outside the cameras."""
    normal = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
    middle = normal @ rig_centre([p.camera for p in pictures])
    along = np.array([normal @ p.camera.centre_m for p in pictures])
    offsets = middle + np.arange(-reach_m, reach_m + 1e-9, _OFFSET_STEP_M)
    # Walls are outside the cameras; planes between them are furniture and would only add chance matches.
    offsets = offsets[(offsets > along.max()) | (offsets < along.min())]
    best = [np.full(p.known.shape, -1, np.float32) for p in pictures]
    for offset in offsets:
        plane = np.array([*normal, offset])
        best = [np.maximum(b, best_score(pictures, i, plane, how)) for i, b in enumerate(best)]
    return best
