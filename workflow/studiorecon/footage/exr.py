# SPDX-License-Identifier: Apache-2.0
"""Reads and writes OpenEXR depth maps: channel Z in metres (0 = unknown), channel A = confidence 0..1."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.files import atomic_path
from studiorecon.scene.schema import FAR_M, check, metres, real
from studiorecon.scene.step_files import CURE, step_file_context
from studiorecon.scene.user_files import first_line

if TYPE_CHECKING:
    from jaxtyping import Float, Num

_MADE = {"Z": metres("H W", gaps=True), "A": real("H W", low=0, high=1, gaps=True)}
_SYSTEM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)


def write_depth(path: Path, depth_m: Num[np.ndarray, "H W"], confidence: Num[np.ndarray, "H W"]) -> None:
    """Write float32 depth and confidence. Raises ValueError for maps of two sizes."""
    require("confidence", confidence, ("H", "W"), require("depth_m", depth_m, ("H", "W")))
    _write(path, {"Z": np.asarray(depth_m, np.float32), "A": np.asarray(confidence, np.float32)})


def write_channels(path: Path, channels: Mapping[str, Float[np.ndarray, "H W"]]) -> None:
    """Write named float16 or float32 channels, lossless (ZIP). Raises ValueError for other types or two sizes."""
    sizes: dict[str, int] = {}
    for name, channel in channels.items():
        sizes = require(name, channel, ("H", "W"), sizes)
        if channel.dtype not in (np.float16, np.float32):
            raise ValueError(f"channel {name} is {channel.dtype}, expected float16 or float32")
    _write(path, channels)


def _write(path: Path, channels: Mapping[str, np.ndarray]) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with (
        atomic_path(path) as partial,
        OpenEXR.File(header, {n: np.ascontiguousarray(c) for n, c in channels.items()}) as file,
    ):
        try:
            file.write(str(partial))
        except RuntimeError as error:  # the binding keeps the system's message but not its number
            for number in _SYSTEM:
                if os.strerror(number) in str(error):
                    raise OSError(number, os.strerror(number), str(path)) from None
            raise


def read_depth(
    path: Path, wh: tuple[int, int] | None = None
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Float32 depth in metres and confidence (1 where known when the file has no A); invalid depth becomes 0.

    Depths that are negative, not finite or beyond 100 km are unknown, and confidences outside of 0 to 1 are 0; a
    message counts them. Accepts a depth channel named Z, Y, R or depth. A map that a step made has ``wh``, Z and A in
    their ranges. Raises UserError naming the file.
    """
    import OpenEXR

    if not path.is_file():
        raise UserError(f"{path} is missing")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeError and std exceptions
        cure = "write it again with the program that made it" if wh is None else CURE
        raise UserError(f"{path} is not a readable EXR file ({first_line(error)}); {cure}") from None
    if wh is not None:
        with step_file_context(path):
            check(channels, _MADE, sizes={"H": wh[1], "W": wh[0]})
    name = next((n for n in ("Z", "Y", "R", "depth") if n in channels), None)
    if name is None:
        raise UserError(f"{path} has channels {', '.join(channels)}; depth is looked for in Z, Y, R or depth")
    depth_m = np.asarray(channels[name], np.float32)
    usable = (depth_m >= 0) & (depth_m <= FAR_M)
    depth_m = np.where(usable, depth_m, np.float32(0))
    confidence = np.asarray(channels["A"], np.float32) if "A" in channels else (depth_m > 0).astype(np.float32)
    sure = (confidence >= 0) & (confidence <= 1)
    if not (usable.all() and sure.all()):
        say(
            f"{path.name}: {int((~usable).sum())} depths of {usable.size} are negative, not finite or beyond "
            f"{FAR_M / 1000:g} km and count as unknown, {int((~sure).sum())} confidences are not from 0 to 1 and count "
            "as 0"
        )
    return depth_m, np.where(sure, confidence, np.float32(0))
