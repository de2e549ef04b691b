# SPDX-License-Identifier: Apache-2.0
"""From the pixels a real lens recorded to the pixels of the pinhole camera that the pipeline works with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.scene.camera import Lens

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

_BORDER_SAMPLES = 200
_ASPECT_TOLERANCE = 0.005
# Of a video that shows what was calibrated, padded at most into a square or a portrait frame of it.
_LEAST_COVERED = 0.25


@dataclass(frozen=True)
class WorkingView:
    """The undistorted picture of a camera at working size.

    Attributes:
        wh: working width and height.
        intrinsics: (3, 3) of the undistorted picture, pixel centres at +0.5.
        oversampling: how many samples per working pixel and axis the maps take, so that shrinking does not alias.
        map_x, map_y: (n·H, n·W) float32 positions in the source frame, in cv2.remap's integer-centre pixels.
    """

    wh: tuple[int, int]
    intrinsics: Num[np.ndarray, "3 3"]
    oversampling: int
    map_x: Float[np.ndarray, "nH nW"]
    map_y: Float[np.ndarray, "nH nW"]

    def picture(self, source: Num[np.ndarray, "rows columns ..."]) -> Num[np.ndarray, "H W ..."]:
        """The working picture (H, W[, C]) of a source frame, same dtype: bilinear, then averaged over the
        oversampling."""
        # The maps stay inside the footage; replication only serves the half pixel beyond the outermost centres.
        sampled = cv2.remap(source, self.map_x, self.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return sampled if self.oversampling == 1 else cv2.resize(sampled, self.wh, interpolation=cv2.INTER_AREA)


def working_wh(source_wh: tuple[int, int], width: int) -> tuple[int, int]:
    """Working size of the given width (0 = the source's own) with the source's aspect; both even, for video codecs."""
    width = source_wh[0] if width <= 0 else min(width, source_wh[0])
    height = source_wh[1] * width / source_wh[0]
    return max(2, int(width) // 2 * 2), max(2, round(height / 2) * 2)


def working_view(lens: Lens, source_wh: tuple[int, int], wh: tuple[int, int]) -> WorkingView:
    """Intrinsics and sampling maps of the largest undistorted picture of size ``wh`` without black borders.

    The picture shows the largest axis-aligned rectangle that the lens covers inside both the video frame and the
    calibrated frame, cut to the aspect of ``wh``; a lens without distortion keeps its whole frame and its intrinsics
    are only scaled. Raises UserError for a lens that cannot be undone at its edge, and as
    ``calibration_from_video_pixels``.
    """
    calibration_from_video = calibration_from_video_pixels(lens, source_wh)
    left, top, right, bottom = _covered(lens, source_wh, calibration_from_video)
    # Keep the pixel shape of the calibration and give the rectangle the aspect of the picture.
    aspect = wh[0] / wh[1] * _pixel_aspect(lens, source_wh, wh)
    width, height = right - left, bottom - top
    if width > height * aspect:
        left, right = (left + right) / 2 - height * aspect / 2, (left + right) / 2 + height * aspect / 2
    else:
        top, bottom = (top + bottom) / 2 - width / aspect / 2, (top + bottom) / 2 + width / aspect / 2
    scale = np.array([wh[0] / (right - left), wh[1] / (bottom - top)])
    focal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]])
    principal = lens.intrinsics[:2, 2]
    intrinsics = np.diag([*(focal * scale), 1.0])
    intrinsics[:2, 2] = (principal - [left, top]) * scale
    n = max(1, int(np.floor(min(np.sqrt(abs(np.linalg.det(calibration_from_video[:, :2]))) ** -1 / scale) + 0.5)))
    columns, rows = np.meshgrid((np.arange(n * wh[0]) + 0.5) / n, (np.arange(n * wh[1]) + 0.5) / n)
    video = video_from_working(np.stack([columns, rows], axis=-1), lens, source_wh, intrinsics)
    return WorkingView(
        wh, intrinsics, n, (video[..., 0] - 0.5).astype(np.float32), (video[..., 1] - 0.5).astype(np.float32)
    )


def calibration_from_video_pixels(lens: Lens, source_wh: tuple[int, int]) -> Num[np.ndarray, "2 3"]:
    """(2, 3) map from video pixels to calibration pixels.

    The lens's own map where one was given; else the scaling from the video's size to the calibrated one. Raises
    UserError when the two sizes have different shapes: then the footage was cropped or padded, and only the user knows
    how; and when the given map lays the calibrated pixels beside the video's.
    """
    given = np.asarray(lens.calibration_from_video, dtype=np.float64)
    _check_overlap(lens, given, source_wh)
    if not np.array_equal(given, np.eye(2, 3)) or 0 in lens.wh or tuple(lens.wh) == tuple(source_wh):
        return given
    scale = np.array(lens.wh) / np.array(source_wh)
    if abs(scale[0] / scale[1] - 1) > _ASPECT_TOLERANCE:
        raise UserError(
            f"camera {lens.name}: the calibration is for {lens.wh[0]}×{lens.wh[1]} but the "
            f"footage is {source_wh[0]}×{source_wh[1]}, "
            "another shape; give its place in capture.yaml: pixel_maps: {camera: {scale: …, offset: [x, y]}}"
        )
    return np.array([[scale[0], 0, 0], [0, scale[1], 0]])


def _check_overlap(lens: Lens, calibration_from_video: np.ndarray, source_wh: tuple[int, int]) -> None:
    low, high = calibration_from_video[:, 2], calibration_from_video @ np.array([*source_wh, 1.0])
    shared = np.clip(np.minimum(high, lens.wh) - np.maximum(low, 0), 0, None)
    covered = float(np.prod(shared / (high - low)))
    if 0 not in lens.wh and covered < _LEAST_COVERED:
        raise UserError(
            f"camera {lens.name}: pixel_maps in capture.yaml lays the calibrated {lens.wh[0]}×{lens.wh[1]} pixels over "
            f"{covered:.0%} of the video's {source_wh[0]}×{source_wh[1]}; p_video = scale · p_calibration + offset, in "
            "pixels of the video"
        )


def calibration_from_video(pixel_map: Sequence[float] | None) -> Num[np.ndarray, "2 3"]:
    """(2, 3) inverse of p_video = s · p_calibration + (x, y), given as (s, x, y); the identity when there is no such
    map."""
    if not pixel_map:
        return np.eye(2, 3)
    scale, x, y = (float(v) for v in pixel_map)
    return np.array([[1 / scale, 0, -x / scale], [0, 1 / scale, -y / scale]])


def mapped_lens(lens: Lens, pixel_map: Sequence[float] | None) -> Lens:
    """A lens known in pixels of the video, in pixels of the calibration that ``pixel_map`` (s, x, y) speaks of."""
    if not pixel_map:
        return lens
    affine = calibration_from_video(pixel_map)
    intrinsics = np.vstack([affine, [0.0, 0.0, 1.0]]) @ lens.intrinsics
    corner = affine @ [*lens.wh, 1.0]
    return replace(lens, wh=(round(corner[0]), round(corner[1])), intrinsics=intrinsics, calibration_from_video=affine)


def normalised_from_calibration(
    pixels: Num[np.ndarray, "... 2"], lens: Lens
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Undistorted normalised coordinates and validity of calibration pixels.

    Raises ValueError for another shape.
    """
    require("pixels", pixels, (..., 2))
    focal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]])
    return undistort(
        (np.asarray(pixels, dtype=np.float64) - lens.intrinsics[:2, 2]) / focal, lens.model, lens.distortion
    )


def working_from_calibration(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, intrinsics: Num[np.ndarray, "3 3"]
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Working pixels and validity of calibration pixels; ``intrinsics`` of the working picture.

    Raises ValueError for another shape.
    """
    require("intrinsics", intrinsics, (3, 3), finite=True)
    normalised, valid = normalised_from_calibration(pixels, lens)
    return normalised * np.array([intrinsics[0, 0], intrinsics[1, 1]]) + intrinsics[:2, 2], valid


def working_from_video(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, source_wh: tuple[int, int], intrinsics: Num[np.ndarray, "3 3"]
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Working pixels and validity of pixels of the video file, centres at +0.5.

    Raises ValueError for another shape.
    """
    require("pixels", pixels, (..., 2))
    affine = calibration_from_video_pixels(lens, source_wh)
    return working_from_calibration(
        np.asarray(pixels, dtype=np.float64) @ affine[:, :2].T + affine[:, 2], lens, intrinsics
    )


def video_from_working(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, source_wh: tuple[int, int], intrinsics: Num[np.ndarray, "3 3"]
) -> Num[np.ndarray, "... 2"]:
    """Pixels of the video file of working pixels, centres at +0.5. Raises ValueError for another shape."""
    require("pixels", pixels, (..., 2))
    require("intrinsics", intrinsics, (3, 3), finite=True)
    normalised = (pixels - intrinsics[:2, 2]) / np.array([intrinsics[0, 0], intrinsics[1, 1]])
    distorted = distort(normalised, lens.model, lens.distortion)
    calibration = distorted * np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]]) + lens.intrinsics[:2, 2]
    affine = calibration_from_video_pixels(lens, source_wh)
    return (calibration - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T


def _pixel_aspect(lens: Lens, source_wh: tuple[int, int], wh: tuple[int, int]) -> float:
    """What makes an uncropped frame fit ``wh`` exactly although both sizes were rounded: 1 up to the rounding."""
    affine = calibration_from_video_pixels(lens, source_wh)
    stretch = affine[0, 0] / affine[1, 1]
    return stretch * (source_wh[0] / source_wh[1]) / (wh[0] / wh[1])


def _covered(
    lens: Lens, source_wh: tuple[int, int], calibration_from_video: np.ndarray
) -> tuple[float, float, float, float]:
    """Left, top, right, bottom (undistorted calibration pixels) of the largest rectangle inside the undistorted
    footage."""
    corners = np.array([[0.0, 0.0], source_wh]) @ calibration_from_video[:, :2].T + calibration_from_video[:, 2]
    low, high = corners.min(0), corners.max(0)
    if 0 not in lens.wh:
        # A letter-boxed video reaches beyond the calibrated frame: that part is a black bar, not footage.
        low, high = np.maximum(low, 0.0), np.minimum(high, np.array(lens.wh, dtype=np.float64))
    along = np.linspace(0.0, 1.0, _BORDER_SAMPLES)
    x, y = low[0] + along * (high[0] - low[0]), low[1] + along * (high[1] - low[1])
    edges = {
        "left": np.stack([np.full_like(y, low[0]), y], -1),
        "right": np.stack([np.full_like(y, high[0]), y], -1),
        "top": np.stack([x, np.full_like(x, low[1])], -1),
        "bottom": np.stack([x, np.full_like(x, high[1])], -1),
    }
    focal, principal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]]), lens.intrinsics[:2, 2]
    flat = {}
    for side, edge in edges.items():
        normalised, valid = normalised_from_calibration(edge, lens)
        if not valid.all():
            raise UserError(
                f"camera {lens.name}: its distortion {np.round(lens.distortion, 4).tolist()} "
                f"({lens.model}) cannot be undone at the "
                f"{side} edge of its frame; the coefficients belong to another lens or another model"
            )
        flat[side] = normalised * focal + principal
    return flat["left"][:, 0].max(), flat["top"][:, 1].max(), flat["right"][:, 0].min(), flat["bottom"][:, 1].min()
