# SPDX-License-Identifier: Apache-2.0
"""A first lens of a camera from the corners of a board: focal length and k1, before all cameras are estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.board.corners import Corners
from studiorecon.board.pattern import Board
from studiorecon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import Num

# Views of the board for a lens: more take long and add little.
_VIEWS = 40
# A focal length needs the board tilted in a few ways.
_MIN_VIEWS = 6
_FIXED = (
    cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)


@dataclass(frozen=True)
class FirstLens:
    """Square pixels, and a principal point in the middle.

    Attributes:
        intrinsics: pixel centres at +0.5.
        radial: k1.
        sigma_px: reprojection error of a corner along an axis, root mean square.
    """

    intrinsics: Num[np.ndarray, "3 3"]
    radial: float
    sigma_px: float

    def undistorted(self, pixels: Num[np.ndarray, "... 2"]) -> Num[np.ndarray, "... 2"]:
        """Ideal image coordinates x / z, y / z of pixels; NaN for NaN."""
        flat = np.asarray(pixels, np.float64).reshape(-1, 2)
        there = np.isfinite(flat[:, 0])
        found = np.full(flat.shape, np.nan)
        if there.any():
            bent = np.array([self.radial, 0.0, 0.0, 0.0])
            found[there] = cv2.undistortPoints(flat[there, None], self.intrinsics, bent).reshape(-1, 2)
        return found.reshape(np.shape(pixels))


def first_lens(camera: str, seen: Corners, board: Board, wh: tuple[int, int]) -> FirstLens:
    """The lens of ``camera``; raises UserError naming the camera when it sees the board too rarely."""
    if len(seen.times_s) < _MIN_VIEWS:
        raise UserError(
            f"camera {camera} shows the board ({board.in_words}) in {len(seen.times_s)} pictures, and a lens needs "
            f"{_MIN_VIEWS}; show it larger, sharper, in better light, or correct the board's description: columns and "
            "rows count squares, not corners; without the description cameras come from people"
        )
    chosen = _spread(seen.pixels, wh)
    there = [np.isfinite(view[:, 0]) for view in seen.pixels[chosen]]
    world = [board.corners_m[t].astype(np.float32) for t in there]
    pixels = [view[t].astype(np.float32) for view, t in zip(seen.pixels[chosen], there, strict=True)]
    rms, matrix, bent, _, _ = cv2.calibrateCamera(world, pixels, wh, np.eye(3), np.zeros(5), flags=_FIXED)
    matrix[:2, 2] = np.array(wh) / 2
    # OpenCV's error is of a point, both axes together.
    return FirstLens(matrix, float(np.ravel(bent)[0]), float(rms / np.sqrt(2)))


def _spread(pixels: Num[np.ndarray, "T N 2"], wh: tuple[int, int]) -> list[int]:
    """Indices of views that differ most in place, size and slant of the board: each is the farthest from those
    before."""
    shape = (pixels - np.nanmean(pixels, axis=1, keepdims=True)) / wh[0]
    spans = np.sqrt(np.nanmean(shape**2, axis=1))
    slant = np.nanmean(shape[..., 0] * shape[..., 1], axis=1) / np.maximum(spans.prod(1), 1e-9)
    about = np.concatenate([np.nanmean(pixels, axis=1) / wh[0], 2 * spans, slant[:, None] / 4], axis=1)
    # More corners first: a view with few is hardly worth anything.
    chosen = [int(np.isfinite(pixels[..., 0]).sum(1).argmax())]
    distance = np.linalg.norm(about - about[chosen[0]], axis=1)
    while len(chosen) < min(_VIEWS, len(pixels)) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(about - about[chosen[-1]], axis=1))
    return sorted(chosen)
