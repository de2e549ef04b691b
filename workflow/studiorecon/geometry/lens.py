# SPDX-License-Identifier: Apache-2.0
"""Maps the pixels of a real lens to those of the pinhole camera that the pipeline works with."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort, fold_radius, undistort
from studiorecon.scene.camera import Lens

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

_BORDER_SAMPLES = 200
_ASPECT_TOLERANCE = 0.005
# Least share of a video that shows the calibrated picture: at most padded into a square or a portrait frame.
_MIN_COVERED = 0.25
# A pinhole picture spends 33 times as many pixels per degree here as in its middle, without limit beyond.
_STEEPEST = np.radians(80.0)
# A calibration board covers at least the middle half of the picture: a lens model that folds within it belongs to
# another lens.
_MAX_UNSEEN = 0.5
# Pincushion: zoom lenses have a tenth of this.
_MAX_STRETCH = 2.0
# Smallest usable picture, in calibration pixels.
_MIN_SIDE_PX = 2.0
# Points along a side of the picture at which the unseen share is counted: to 0.1 %.
_GRID = 64


@dataclass(frozen=True)
class WorkingView:
    """The undistorted picture of a camera at working size.

    Attributes:
        wh: working width and height.
        intrinsics: of the undistorted picture, pixel centres at +0.5.
        oversampling: number of samples per working pixel and axis in the maps, so that shrinking does not alias.
        map_x, map_y: (n·H, n·W) float32 positions in the source frame, in cv2.remap's integer-centre pixels.
    """

    wh: tuple[int, int]
    intrinsics: Num[np.ndarray, "3 3"]
    oversampling: int
    map_x: Float[np.ndarray, "nH nW"]
    map_y: Float[np.ndarray, "nH nW"]

    def picture(self, source: Num[np.ndarray, "rows columns ..."]) -> Num[np.ndarray, "H W ..."]:
        """The working picture of a source frame, same dtype: bilinear, then averaged over the oversampling."""
        # The maps stay inside the footage; replication only affects the half pixel beyond the outermost centres.
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
    calibrated frame, cut to the aspect of ``wh``. A lens without distortion keeps its whole frame. Pixels that cannot
    be undistorted are outside of it. Raises UserError as ``rayless_share``.
    """
    rayless_share(lens, source_wh)
    calibration_from_video = calibration_from_video_pixels(lens, source_wh)
    left, top, right, bottom = _inner_rectangle(lens, source_wh, calibration_from_video)
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
    """Map from video pixels to calibration pixels: the lens's own if given, else the scaling between the two sizes.

    Raises UserError when the two sizes have different shapes (the footage was cropped or padded, and only the user
    knows how), and when the given map puts the calibrated pixels outside the video.
    """
    given = np.asarray(lens.calibration_from_video, dtype=np.float64)
    if lens.has_place:
        _check_overlap(lens, given, source_wh)
        return given
    if 0 in lens.wh or tuple(lens.wh) == tuple(source_wh):
        return given
    scale = np.array(lens.wh) / np.array(source_wh)
    if not same_shape(lens.wh, source_wh):
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
    if 0 not in lens.wh and covered < _MIN_COVERED:
        raise UserError(
            f"camera {lens.name}: pixel_maps in capture.yaml lays the calibrated {lens.wh[0]}×{lens.wh[1]} pixels over "
            f"{covered:.0%} of the video's {source_wh[0]}×{source_wh[1]}; p_video = scale · p_calibration + offset, in "
            "pixels of the video"
        )


def same_shape(one: tuple[int, int], two: tuple[int, int]) -> bool:
    """Whether two sizes of pictures differ only by scaling, up to rounding."""
    return abs(one[0] * two[1] / (one[1] * two[0]) - 1) <= _ASPECT_TOLERANCE


def calibration_from_video(pixel_map: Sequence[float] | None) -> Num[np.ndarray, "2 3"]:
    """Inverse of p_video = s · p_calibration + (x, y), given as (s, x, y); the identity when there is no such map."""
    if not pixel_map:
        return np.eye(2, 3)
    scale, x, y = (float(v) for v in pixel_map)
    return np.array([[1 / scale, 0, -x / scale], [0, 1 / scale, -y / scale]])


def apply_pixel_map(lens: Lens, pixel_map: Sequence[float] | None) -> Lens:
    """The lens with its video's position from capture.yaml, which may be the identity; unchanged without one."""
    if not pixel_map:
        return lens
    placed = replace(lens, calibration_from_video=calibration_from_video(pixel_map))
    return placed if placed.has_place else replace(placed, placed="as pixel_maps in capture.yaml says")


def lens_with_pixel_map(lens: Lens, pixel_map: Sequence[float] | None) -> Lens:
    """A lens known in pixels of the video, converted to calibration pixels by ``pixel_map`` (s, x, y)."""
    if not pixel_map:
        return lens
    affine = calibration_from_video(pixel_map)
    intrinsics = np.vstack([affine, [0.0, 0.0, 1.0]]) @ lens.intrinsics
    corner = affine @ [*lens.wh, 1.0]
    return replace(lens, wh=(round(corner[0]), round(corner[1])), intrinsics=intrinsics, calibration_from_video=affine)


def normalised_from_calibration(
    pixels: Num[np.ndarray, "... 2"], lens: Lens
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Undistorted normalised coordinates and validity of calibration pixels. Raises ValueError for another shape."""
    require("pixels", pixels, (..., 2))
    focal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]])
    return undistort(
        (np.asarray(pixels, dtype=np.float64) - lens.intrinsics[:2, 2]) / focal, lens.model, lens.distortion
    )


def working_from_calibration(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, intrinsics: Num[np.ndarray, "3 3"]
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Working pixels and validity of calibration pixels. Raises ValueError for another shape."""
    require("intrinsics", intrinsics, (3, 3), finite=True)
    normalised, valid = normalised_from_calibration(pixels, lens)
    return normalised * np.array([intrinsics[0, 0], intrinsics[1, 1]]) + intrinsics[:2, 2], valid


def working_from_video(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, source_wh: tuple[int, int], intrinsics: Num[np.ndarray, "3 3"]
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Working pixels and validity of pixels of the video file, centres at +0.5. Raises ValueError for another shape."""
    require("pixels", pixels, (..., 2))
    affine = calibration_from_video_pixels(lens, source_wh)
    return working_from_calibration(
        np.asarray(pixels, dtype=np.float64) @ affine[:, :2].T + affine[:, 2], lens, intrinsics
    )


def video_from_working(
    pixels: Num[np.ndarray, "... 2"], lens: Lens, source_wh: tuple[int, int], intrinsics: Num[np.ndarray, "3 3"]
) -> Num[np.ndarray, "... 2"]:
    """Pixels of the video file, centres at +0.5, of working pixels; far outside where the lens has no such ray.

    Raises ValueError for another shape.
    """
    require("pixels", pixels, (..., 2))
    require("intrinsics", intrinsics, (3, 3), finite=True)
    normalised = (pixels - intrinsics[:2, 2]) / np.array([intrinsics[0, 0], intrinsics[1, 1]])
    distorted = distort(normalised, lens.model, lens.distortion)
    fold = np.inf if lens.model == "fisheye" else fold_radius(lens.model, lens.distortion)
    if np.isfinite(fold):
        beyond = np.linalg.norm(normalised, axis=-1) > fold
        # Normalised: no picture reaches so far, and its pixels still fit into 16 bits, as cv2.remap needs.
        distorted = np.where(beyond[..., None], -6.0, distorted)
    calibration = distorted * np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]]) + lens.intrinsics[:2, 2]
    affine = calibration_from_video_pixels(lens, source_wh)
    return (calibration - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T


def _pixel_aspect(lens: Lens, source_wh: tuple[int, int], wh: tuple[int, int]) -> float:
    """The pixel aspect, 1 up to rounding, that makes an uncropped frame fit ``wh`` exactly."""
    affine = calibration_from_video_pixels(lens, source_wh)
    stretch = affine[0, 0] / affine[1, 1]
    return stretch * (source_wh[0] / source_wh[1]) / (wh[0] / wh[1])


def _inner_rectangle(
    lens: Lens, source_wh: tuple[int, int], calibration_from_video: np.ndarray
) -> tuple[float, float, float, float]:
    """Left, top, right, bottom (undistorted calibration px) of the largest rectangle inside the undistorted footage."""
    corners = np.array([[0.0, 0.0], source_wh]) @ calibration_from_video[:, :2].T + calibration_from_video[:, 2]
    low, high = corners.min(0), corners.max(0)
    if 0 not in lens.wh:
        # A letter-boxed video extends beyond the calibrated frame: that part is a black bar, not footage.
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
    found = {side: normalised_from_calibration(edge, lens) for side, edge in edges.items()}
    if all(valid.all() for _, valid in found.values()):
        (left, _), (right, _), (top, _), (bottom, _) = found.values()
        rectangle = np.array([left[:, 0].max(), top[:, 1].max(), right[:, 0].min(), bottom[:, 1].min()])
    else:
        rectangle = _undoable(found, lens, low, high)
    left_px, top_px, right_px, bottom_px = rectangle * np.tile(focal, 2) + np.tile(principal, 2)
    return left_px, top_px, right_px, bottom_px


def _undoable(
    edges: Mapping[str, tuple[np.ndarray, np.ndarray]], lens: Lens, low: np.ndarray, high: np.ndarray
) -> Float[np.ndarray, " 4"]:
    """Left, top, right, bottom (normalised) of a rectangle that is seen entirely between pixels ``low`` and ``high``.

    For a lens that cannot be undistorted everywhere on the undistorted ``edges`` (points, validity).
    """
    reach = _reach(lens)

    def bound(side: str, axis: int, sign: float) -> float:
        points, valid = edges[side]
        return sign * min(np.append(sign * points[valid, axis], reach))

    whole = np.array([bound("left", 0, -1.0), bound("top", 1, -1.0), bound("right", 0, 1.0), bound("bottom", 1, 1.0)])
    anchor = np.tile(np.clip(0.0, whole[:2], whole[2:]), 2)
    focal, principal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]]), lens.intrinsics[:2, 2]
    along = np.linspace(0.0, 1.0, _BORDER_SAMPLES)[:, None]

    def seen(share: float) -> bool:
        x0, y0, x1, y1 = anchor + share * (whole - anchor)
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        border = np.concatenate([a + along * (b - a) for a, b in itertools.pairwise(corners)])
        pixels = distort(border, lens.model, lens.distortion) * focal + principal
        return bool(
            (np.linalg.norm(border, axis=-1) <= reach).all() and (pixels >= low).all() and (pixels <= high).all()
        )

    least, most = 0.0, 1.0
    # Tolerance of a rectangle's size, as a share: a thousandth of a pixel of a large picture.
    while most - least > 1e-7:
        middle = (least + most) / 2
        least, most = (middle, most) if seen(middle) else (least, middle)
    return anchor + least * (whole - anchor)


def _reach(lens: Lens) -> float:
    """The largest undistorted radius (normalised) in use: below the fold, and no steeper than a pinhole can show."""
    fold = fold_radius(lens.model, lens.distortion)
    return min(float(np.tan(fold)) if lens.model == "fisheye" else fold, float(np.tan(_STEEPEST)))


def rayless_share(lens: Lens, source_wh: tuple[int, int]) -> float:
    """Share of a video's picture beyond the fold of the lens's polynomial, which is not used.

    Raises UserError where it is most of the picture, and as ``calibration_from_video_pixels``: every step that rejects
    a lens does so here.
    """
    affine = calibration_from_video_pixels(lens, source_wh)
    left, top, right, bottom = _inner_rectangle(lens, source_wh, affine)
    if not (right - left > _MIN_SIDE_PX and bottom - top > _MIN_SIDE_PX):
        raise UserError(
            f"camera {lens.name}: its film of {source_wh[0]}×{source_wh[1]} pixels shows nothing of the calibrated "
            f"picture of {lens.wh[0]}×{lens.wh[1]}; check pixel_maps in capture.yaml, and its principal point"
        )
    x, y = np.meshgrid(*((np.arange(_GRID) + 0.5) / _GRID * side for side in source_wh))
    pixels = np.stack([x, y], -1).reshape(-1, 2) @ affine[:, :2].T + affine[:, 2]
    rays, seen = normalised_from_calibration(pixels, lens)
    filmed = np.linalg.norm((pixels - lens.intrinsics[:2, 2]) / lens.intrinsics[[0, 1], [0, 1]], axis=-1)
    if (filmed > _MAX_STRETCH * np.linalg.norm(rays, axis=-1))[seen].any():
        raise UserError(
            f"camera {lens.name}: its distortion {np.round(lens.distortion, 4).tolist()} ({lens.model}) moves pixels "
            f"more than {_MAX_STRETCH:g} times as far from the middle, which no lens does; calibrate it again"
        )
    share = 1.0 - float(seen.mean())
    if share > _MAX_UNSEEN:
        raise UserError(
            f"camera {lens.name}: its distortion {np.round(lens.distortion, 4).tolist()} ({lens.model}) cannot be "
            f"undone in {share:.0%} of its picture; the coefficients belong to another lens or another model"
        )
    return share
