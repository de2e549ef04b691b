# SPDX-License-Identifier: Apache-2.0
"""The straight edges of the empty room in every camera's footage: what stays where it is while people pass.

By the line segment detector (Grompone von Gioi et al. 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.footage.source import open_source, stills
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Num

# Pictures whose median is the room, spread over the footage.
_PICTURES = 9
# Shorter edges, as a share of the longer side, say little about directions.
_LEAST_SHARE = 0.02
# Pictures are read by their number: the rate of a folder of them does not matter.
_ANY_FPS = 30.0


def edges_of(
    cameras: Sequence[str], sources: Sequence[Path], size: Mapping[str, tuple[int, int]]
) -> dict[str, np.ndarray]:
    """camera → (N, 4) ends of straight edges, pixels of its footage of ``size``; without the cameras whose footage
    cannot be read, which is said."""
    found = {}
    for camera, path in zip(cameras, sources):
        try:
            source = open_source(path, _ANY_FPS)
            total = source.declared_frames or 1
            wanted = sorted({round(k * (total - 1) / (_PICTURES - 1)) for k in range(_PICTURES)})
            seen = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in stills(source, wanted)]
        except UserError as refusal:
            warn(f"the room's edges are not looked for in camera {camera}: {refusal}")
            continue
        if camera in size and seen and seen[0].shape[::-1] == tuple(size[camera]):
            room = np.median(np.stack(seen), axis=0).astype(np.uint8)
            found[camera] = straight_edges(room, _LEAST_SHARE * max(room.shape))
    return found


def straight_edges(grey: Num[np.ndarray, "H W"], least_px: float) -> Num[np.ndarray, "N 4"]:
    """(N, 4) ends x0, y0, x1, y1 of the straight edges of ``grey`` (H, W, uint8) that are at least ``least_px`` long,
    centres of pixels at +0.5. Raises ValueError for another shape."""
    require("grey", grey, ("H", "W"))
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(np.ascontiguousarray(grey))[0]
    if found is None:
        return np.zeros((0, 4))
    ends = found.reshape(-1, 4).astype(np.float64) + 0.5
    return ends[np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) >= least_px]
