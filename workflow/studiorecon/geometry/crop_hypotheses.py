# SPDX-License-Identifier: Apache-2.0
"""Possible positions of a film's pixels in the calibrated picture, when the two have different shapes.

Codecs store whole blocks of 16 pixels: 1080 lines are calibrated as 1088 by a program that shows the padding, or the
other way round, and some exports centre or scale the rest. A turned film has its sides exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.lens import calibration_from_video, calibration_from_video_pixels, same_shape
from studiorecon.scene.camera import Lens

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Pixels of a block: no codec pads by more than one less.
_BLOCK = 16
# Films are scaled by ratios of small integers.
_LARGEST_RATIO = 8
# Levels (0 to 255) of a bar: black plus a codec's noise.
_MAX_BLACK = 32
# Pixels by which the part between bars may miss the calibrated shape: their edges are blurred.
_BAR_TOLERANCE_PX = 2.0


@dataclass(frozen=True)
class CropHypothesis:
    """One reading: the lens under it, and the film's position in words; "" without an assumption."""

    lens: Lens
    how: str


def crop_hypotheses(lens: Lens, source_wh: tuple[int, int]) -> list[CropHypothesis]:
    """Every possible position, the usual one first.

    Raises UserError, as ``calibration_from_video_pixels``, for shapes that neither padding nor a turn explains.
    """
    if lens.has_place or 0 in lens.wh or same_shape(lens.wh, source_wh):
        return [CropHypothesis(lens, "")]
    found = list(_padding_hypotheses(lens, source_wh))
    if not found and same_shape(lens.wh[::-1], source_wh):
        clockwise = rotate_lens_90(lens)
        # Cameras are seldom upside down, so the picture's up points up.
        both = [(clockwise, "clockwise"), (rotate_lens_90(rotate_lens_90(clockwise)), "counter-clockwise")]
        both.sort(key=lambda turn: turn[0].camera_from_world[1, 2])
        found = [CropHypothesis(turn, f"the calibrated picture turned {way} by 90°") for turn, way in both]
    if not found:
        calibration_from_video_pixels(lens, source_wh)  # raises the error
    return found


def area_inside_bars(pictures: Sequence[Integer[np.ndarray, "H W 3"]]) -> Float[np.ndarray, " 4"]:
    """(left, top, right, bottom) in pixels of the part of ``pictures`` inside black bars, or of all of them."""
    brightest = np.stack([picture.max(-1) for picture in pictures])
    area = []
    for axis, side in ((1, brightest.shape[2]), (2, brightest.shape[1])):
        lit = np.flatnonzero(np.median(brightest, axis=(0, axis)) > _MAX_BLACK)
        area.append((lit[0], lit[-1] + 1) if len(lit) else (0, side))
    (left, right), (top, bottom) = area
    return np.array([left, top, right, bottom], dtype=np.float64)


def place_inside_bars(lens: Lens, area: Num[np.ndarray, " 4"], source_wh: tuple[int, int]) -> CropHypothesis | None:
    """The calibrated picture in the part ``area`` of a film with black bars; None without bars or of other shape."""
    low, size = area[:2], area[2:] - area[:2]
    whole = size == source_wh
    if whole.all() or lens.has_place or 0 in lens.wh:
        return None
    ratios = size / lens.wh
    # A side without bars has no blurred edges.
    scale = float(ratios[whole].mean() if whole.any() else ratios.mean())
    if np.abs(scale * np.array(lens.wh) - size).max() > _BAR_TOLERANCE_PX:
        return None
    offset = low + size / 2 - scale * np.array(lens.wh) / 2
    bars = f"{np.max([low, source_wh - area[2:]]):.0f}"
    how = f"the calibration's {lens.wh[0]}×{lens.wh[1]} picture inside of the film's black bars of {bars} pixels"
    how += "" if abs(scale - 1) < 1e-9 else f", scaled by {scale:.4g}"
    affine = calibration_from_video((scale, *offset))
    return CropHypothesis(replace(lens, calibration_from_video=affine, placed=how), how)


def for_square_pixels(lens: Lens, stored_wh: tuple[int, int], shown_wh: tuple[int, int]) -> tuple[Lens, str]:
    """The lens for the shown picture of a film of ``stored_wh`` non-square pixels, and a sentence on the choice.

    The calibration's size decides whether it is for stored or for shown pixels, or without one the ratio of its focal
    lengths. Unchanged, with "", for square pixels.
    """
    if stored_wh == shown_wh or lens.has_place:
        return lens, ""
    stretch = np.array(shown_wh) / np.array(stored_wh)
    if 0 in lens.wh:
        ratio = np.log(lens.intrinsics[0, 0] / lens.intrinsics[1, 1])
        is_shown = abs(ratio) <= abs(ratio + np.log(stretch[0] / stretch[1]))
    else:
        is_shown = same_shape(lens.wh, shown_wh) or not same_shape(lens.wh, stored_wh)
    stored, shown = (f"{width}×{height}" for width, height in (stored_wh, shown_wh))
    named = f"camera {lens.name}: its calibration is for the picture as"
    if is_shown:
        return lens, f"{named} shown, {shown}, not as stored, {stored}"
    width, height = (round(side) for side in np.array(lens.wh) * stretch)
    square = replace(lens, wh=(width, height), intrinsics=np.diag([*stretch, 1.0]) @ lens.intrinsics)
    return square, f"{named} stored, {stored}, not as shown, {shown}"


def _padding_hypotheses(lens: Lens, source_wh: tuple[int, int]) -> Iterator[CropHypothesis]:
    calibrated, film = np.array(lens.wh, float), np.array(source_wh, float)
    ratios = film / calibrated
    # The side without padding was scaled by a ratio of small integers.
    off = [abs(r - float(Fraction(r).limit_denominator(_LARGEST_RATIO))) for r in ratios]
    places_found = []
    for scale in ratios[np.argsort(off, kind="stable")]:
        over = film / scale - calibrated
        if np.abs(over).max() >= _BLOCK:
            return
        by = "" if scale == 1.0 else f", scaled by {scale:.4g}"
        for offset, where in ((np.zeros(2), "at its left and top edges"), (-over / 2, "in its middle")):
            places_found.append((np.array([[1 / scale, 0, offset[0]], [0, 1 / scale, offset[1]]]), f"{where}{by}"))
    places_found.append((np.array([[1 / ratios[0], 0, 0], [0, 1 / ratios[1], 0]]), "stretched to its size"))
    for affine, where in places_found:
        how = f"its {source_wh[0]}×{source_wh[1]} pixels in the calibration's {lens.wh[0]}×{lens.wh[1]} {where}"
        yield CropHypothesis(replace(lens, calibration_from_video=affine, placed=how), how)


def rotate_lens_90(lens: Lens) -> Lens:
    """The lens of the same camera whose pictures were turned clockwise by 90°."""
    width, height = lens.wh
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    fx, fy, cx, cy = (lens.intrinsics[i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    distortion = lens.distortion.copy()
    if lens.model == "opencv" and len(distortion) > 3:
        distortion[2], distortion[3] = lens.distortion[3], -lens.distortion[2]
    pose = np.eye(4)
    pose[:3] = turn @ lens.camera_from_world[:3]
    return replace(
        lens,
        wh=(height, width),
        intrinsics=np.array([[fy, 0.0, height - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]]),
        distortion=distortion,
        camera_from_world=pose,
    )
