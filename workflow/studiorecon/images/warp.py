# SPDX-License-Identifier: Apache-2.0
"""Reads an image at fractional pixels: the one place for the pixel-centre convention; an identity warp is exact.

Pixel coordinates have their centres at +0.5; OpenCV's ``remap`` puts them at whole numbers, and this is the only module
that subtracts the half pixel. Values interpolated across the border or across invalid pixels are marked in ``valid``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import cv2
import numba
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num, Shaped

_FILTERS = {"nearest": cv2.INTER_NEAREST, "linear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC}
_LONGEST_SIDE, _FOLD = 32767, 4096
# A coordinate on the outermost centre up to rounding counts as inside.
SLACK_PX = 1e-6


def sample(
    image: Shaped[np.ndarray, "H W ..."],
    pixels: Num[np.ndarray, "h w 2"],
    how: Literal["nearest", "linear", "cubic"] = "linear",
) -> tuple[Shaped[np.ndarray, "h w ..."], Bool[np.ndarray, "h w"]]:
    """Values of an image at pixel coordinates, and which of them are valid.

    Valid are finite coordinates within the outermost pixel centres (``nearest``: within the image). Others have the
    value of the nearest border pixel, or of the corner if not finite (E06, E13: zero padding or an unmasked NaN would
    enter every later mean). Raises ValueError for other shapes.
    """
    require("image", image, ("H", "W", ...))
    require("pixels", pixels, ("h", "w", 2))
    if how == "nearest":
        rows, columns, inside = nearest_pixels(pixels, image.shape[:2])
        return image[rows, columns], inside
    column, row, inside = _clamp_inside(pixels, image.shape[:2], 0.5)
    as_float = image if image.dtype in (np.float32, np.float64) else image.astype(np.float32)
    x, y = (column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32)
    return _remap(as_float, x, y, _FILTERS[how]), inside


def nearest_pixels(
    pixels: Num[np.ndarray, "h w 2"], hw: tuple[int, ...]
) -> tuple[Integer[np.ndarray, "h w"], Integer[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Rows and columns that ``sample(…, "nearest")`` reads in a picture of size ``hw``, and which are valid."""
    height, width = hw
    column, row, inside = _clamp_inside(pixels, hw, 0.0)
    columns = np.minimum(np.floor(column).astype(np.intp), width - 1)
    rows = np.minimum(np.floor(row).astype(np.intp), height - 1)
    return rows, columns, inside


def _clamp_inside(
    pixels: np.ndarray, hw: tuple[int, ...], margin_px: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns and rows, and where they are finite and at least ``margin_px`` within the picture's edge.

    Coordinates beyond the image are clamped to its edge before float32: 1e30 would overflow remap's fixed point.
    """
    height, width = hw
    x, y = pixels[..., 0], pixels[..., 1]
    finite = np.isfinite(x) & np.isfinite(y)
    least = margin_px - SLACK_PX
    inside = finite & (x >= least) & (x <= width - least) & (y >= least) & (y <= height - least)
    return np.clip(np.where(finite, x, 0.0), 0.0, width), np.clip(np.where(finite, y, 0.0), 0.0, height), inside


def _remap(image: np.ndarray, x: np.ndarray, y: np.ndarray, filter_: int) -> np.ndarray:
    if max(x.shape) < _LONGEST_SIDE:
        return cv2.remap(image, x, y, filter_, borderMode=cv2.BORDER_REPLICATE)
    # OpenCV counts rows and columns in 16 bits; a long list of points is folded into rows and unfolded again.
    folded = [np.resize(v.ravel(), (-(-v.size // _FOLD), _FOLD)) for v in (x, y)]
    values = cv2.remap(image, folded[0], folded[1], filter_, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1, *image.shape[2:])[: x.size].reshape(*x.shape, *image.shape[2:])


def warp(
    image: Num[np.ndarray, "H W ..."],
    flow: Num[np.ndarray, "H W 2"],
    how: Literal["nearest", "linear", "cubic"] = "linear",
) -> tuple[Num[np.ndarray, "H W ..."], Bool[np.ndarray, "H W"]]:
    """The image warped backward, at p + flow(p) for pixel p, and where that is inside the image.

    ``flow`` is in pixels, from the output to the image (E09: a forward flow moves things the wrong way). A zero flow
    returns the image itself, bit for bit (E07). Raises ValueError for other shapes.
    """
    require("flow", flow, ("H", "W", 2))
    if how == "nearest" or image.shape[:2] != flow.shape[:2] or max(flow.shape[:2]) >= _LONGEST_SIDE:
        columns, rows = np.meshgrid(np.arange(flow.shape[1]) + 0.5, np.arange(flow.shape[0]) + 0.5)
        return sample(image, np.stack([columns, rows], axis=-1) + flow, how)
    require("image", image, ("H", "W", ...))
    as_float = image if image.dtype in (np.float32, np.float64) else image.astype(np.float32)
    x, y, inside = _displacement_maps(np.ascontiguousarray(flow))
    return cv2.remap(as_float, x, y, _FILTERS[how], borderMode=cv2.BORDER_REPLICATE), inside


@numba.njit(cache=True, nogil=True)
def _displacement_maps(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column and row, float32, that ``remap`` reads for p + flow(p), and where they are inside as in ``sample``."""
    height, width = flow.shape[:2]
    x, y = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    inside = np.empty((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            u, v = j + np.float64(flow[i, j, 0]), i + np.float64(flow[i, j, 1])
            if not (np.isfinite(u) and np.isfinite(v)):
                x[i, j], y[i, j], inside[i, j] = -0.5, -0.5, False
                continue
            inside[i, j] = (
                u >= -SLACK_PX and v >= -SLACK_PX and u <= width - 1 + SLACK_PX and v <= height - 1 + SLACK_PX
            )
            x[i, j], y[i, j] = min(max(u, -0.5), width - 0.5), min(max(v, -0.5), height - 0.5)
    return x, y, inside
