# SPDX-License-Identifier: Apache-2.0
"""Reads still pictures: clean plates with an alpha that marks the measured pixels."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.scene.step_files import CURE, require_size
from studiorecon.scene.user_files import read_bytes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num, Shaped

_PNG = b"\x89PNG\r\n\x1a\n"


def read_image(path: Path, flags: int, cure: str = "") -> Shaped[np.ndarray, "H W ..."]:
    """The picture of a file as decoded by OpenCV (BGR); raises UserError, which ends in ``cure``, if unreadable."""
    data = read_bytes(path, remedy=cure)
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if _whole(data) else None
    except cv2.error:  # more pixels than it allocates
        picture = None
    if picture is None:
        raise UserError(f"{path} is not a readable picture; {cure or 'replace it'}")
    return picture


def _whole(data: bytes) -> bool:
    """Whether the file is not empty, and a PNG has every chunk that it announces.

    For a damaged PNG the decoder allocates the announced size first, which may be gigabytes.
    """
    if not data.startswith(_PNG):
        return len(data) > 0
    at = len(_PNG)
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if kind == b"IEND":
            break
    return at <= len(data)


def read_plate(
    path: Path, wh: tuple[int, int] | None = None
) -> tuple[Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Float32 RGB in [0, 1] of an 8- or 16-bit picture file, and where it is measured (alpha above one half, or none).

    ``wh``: the size of a plate that a step made. Raises UserError naming the file.
    """
    stored = read_image(path, cv2.IMREAD_UNCHANGED, "" if wh is None else CURE)
    if stored.dtype not in (np.uint8, np.uint16):
        raise UserError(f"{path} holds {stored.dtype} numbers; save it as an 8- or 16-bit picture")
    if stored.ndim == 2:
        stored = np.repeat(stored[..., None], 3, axis=-1)
    if wh is not None:
        require_size(path, stored, wh)
    largest = 255 if stored.dtype == np.uint8 else 65535
    scaled = np.asarray(stored, np.float32) / np.float32(largest)
    measured = scaled[..., 3] > 0.5 if scaled.shape[-1] == 4 else np.ones(scaled.shape[:2], bool)
    return np.ascontiguousarray(scaled[..., 2::-1]), measured


def shrink_plate(
    rgb: Num[np.ndarray, "H W 3"], measured: Bool[np.ndarray, "H W"], wh: tuple[int, int]
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """A plate at another size, averaged over its measured pixels only; measured where more than half of the area was.

    Raises ValueError for a mask of another size.
    """
    require("measured", measured, ("H", "W"), require("rgb", rgb, ("H", "W", 3)))
    if (rgb.shape[1], rgb.shape[0]) == tuple(wh):
        return rgb, measured
    how = cv2.INTER_AREA if wh[0] < rgb.shape[1] else cv2.INTER_LINEAR
    share = cv2.resize(measured.astype(np.float32), wh, interpolation=how)
    colour = cv2.resize(rgb * measured[..., None].astype(np.float32), wh, interpolation=how)
    return colour / np.maximum(share, 1e-6)[..., None], share > 0.5
