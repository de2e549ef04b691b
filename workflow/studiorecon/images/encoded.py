# SPDX-License-Identifier: Apache-2.0
"""Pictures as PNG and JPEG: in memory, or in a file that is complete or absent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.files import atomic_path

if TYPE_CHECKING:
    from jaxtyping import Shaped


def png(picture: Shaped[np.ndarray, "H W ..."]) -> bytes:
    """Grey, RGB or RGBA picture, uint8 or uint16, as a PNG file. Raises ValueError for other arrays."""
    return _encode(".png", picture, [])


def jpeg(picture: Shaped[np.ndarray, "H W ..."], quality: int) -> bytes:
    """Grey or RGB picture as a JPEG file of ``quality`` 0 to 100. Raises ValueError for other arrays."""
    return _encode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])


def write_png(path: Path, picture: Shaped[np.ndarray, "H W ..."]) -> None:
    """Write a picture as ``png`` encodes it, completely or not at all.

    On a full disk OpenCV's own writer returns False and leaves an incomplete file.
    """
    with atomic_path(path) as partial:
        partial.write_bytes(png(picture))


def _encode(suffix: str, picture: np.ndarray, options: list[int]) -> bytes:
    require("picture", picture, ("H", "W", ...))
    colour = np.concatenate([picture[..., 2::-1], picture[..., 3:]], axis=-1) if picture.ndim == 3 else picture
    done, data = cv2.imencode(suffix, np.ascontiguousarray(colour), options)
    if not done:
        raise ValueError(f"a picture of {picture.shape} {picture.dtype} cannot be written as {suffix}")
    return data.tobytes()
