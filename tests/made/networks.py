# SPDX-License-Identifier: Apache-2.0
"""Planted cameras, depths and pictures for adapters; where upstream sources and weights lie, when somebody has them."""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from studiorecon.scene.camera import Camera

from tests.made.room import made_room, photograph, ring


@cache
def room_views(wh: tuple[int, int], count: int = 4) -> tuple[tuple[Camera, np.ndarray, np.ndarray], ...]:
    """Camera, (H, W, 3) float32 picture and (H, W) exact z-depth of a made room from a ring of cameras."""
    room = made_room()
    return tuple((camera, *photograph(room, camera, 1)) for camera in ring(count, wh=wh))


def upstream_sources(repository: str, inner: str = "") -> Path:
    """The checkout ``repository`` (owner+name) below STUDIORECON_UPSTREAM, put on the import path; skips when it is not
    there."""
    given = os.environ.get("STUDIORECON_UPSTREAM", "")
    folder = Path(given) / repository / inner
    if not given or not folder.is_dir():
        pytest.skip(f"no upstream sources: set STUDIORECON_UPSTREAM to a folder that holds {repository}")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return folder
