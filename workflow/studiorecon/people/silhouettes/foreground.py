# SPDX-License-Identifier: Apache-2.0
"""Which pixels show somebody who has no keypoints: the difference to a given clean plate, less the people already
known.

Pixels are foreground, background or unknown. Unknown are those where the plate is, and those of a person who was fitted
to keypoints: somebody else may stand behind, so they speak neither for nor against anybody.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.stills import read_plate, shrink
from studiorecon.footage.video import read_frames, to_float
from studiorecon.images.difference import plate_difference
from studiorecon.images.regions import without_holes
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

BACKGROUND, FOREGROUND, UNKNOWN = 0, 1, 2
# Gaps in an outline that are closed, as a share of the longer side; enclosed gaps that are filled, as a share of the
# picture.
_GAP_SHARE, _HOLE_SHARE = 0.009, 0.0025


@dataclass(frozen=True)
class ForegroundSettings:
    """When a pixel shows somebody. Differences are in CIELAB units (1 = just visible).

    Attributes:
        pixels: longer side of the pictures that are compared; larger ones are shrunk.
        difference: a pixel that differs more is foreground.
        chroma_weight: colour differences count this much more than lightness.
        shadow: darkest shadow, as a share of the unshadowed light; a darkening down to it is none.
        margin_m: people known by their keypoints are this much thicker than their bodies: clothes, hair and what the
            fit is off.
    """

    pixels: int = 480
    difference: float = 10.0
    chroma_weight: float = 1.5
    shadow: float = 0.85
    margin_m: float = 0.06


@dataclass(frozen=True)
class SilhouetteView:
    """One training camera with a given plate, at the size that is compared: ``rgb`` (H, W, 3) in [0, 1], ``measured``
    (H, W)."""

    camera: Camera
    video: Path
    rgb: Float[np.ndarray, "H W 3"]
    measured: Bool[np.ndarray, "H W"]


def open_view(camera: Camera, video: Path, plate: Path, settings: ForegroundSettings) -> SilhouetteView:
    rgb, measured = read_plate(plate)
    share = min(1.0, settings.pixels / max(camera.wh))
    small = camera.resized((round(camera.wh[0] * share), round(camera.wh[1] * share)))
    return SilhouetteView(small, video, *shrink(rgb, measured, small.wh))


def pictures(views: Sequence[SilhouetteView], step: int) -> Iterator[tuple[int, list[Float[np.ndarray, "H W 3"]]]]:
    """Every ``step``-th frame: its number and the pictures (H, W, 3) float32 of all views, decoded side by side."""
    for t, frames in enumerate(zip(*(read_frames(v.video) for v in views), strict=True)):
        if t % step == 0:
            yield (
                t,
                [
                    cv2.resize(to_float(f), v.camera.wh, interpolation=cv2.INTER_AREA)
                    if f.shape[:2] != v.camera.hw
                    else to_float(f)
                    for f, v in zip(frames, views)
                ],
            )


def labels(
    rgb: Float[np.ndarray, "H W 3"], view: SilhouetteView, known: Bool[np.ndarray, "H W"], settings: ForegroundSettings
) -> Integer[np.ndarray, "H W"]:
    """(H, W) uint8 labels of a picture (H, W, 3) in [0, 1]; ``known`` (H, W) bool: where people with keypoints
    stand."""
    picture, plate = cv2.GaussianBlur(rgb, (3, 3), 0), cv2.GaussianBlur(view.rgb, (3, 3), 0)
    squared, _ = plate_difference(picture, plate, chroma_weight=settings.chroma_weight, shadow=settings.shadow)
    difference = np.sqrt(squared)
    foreground = cv2.medianBlur((difference > settings.difference).astype(np.uint8), 3)
    # Clothes of the wall's colour leave gaps inside an outline that otherwise stands out: closed, and filled where
    # enclosed.
    size = 2 * round(_GAP_SHARE * max(foreground.shape)) + 1
    foreground = cv2.morphologyEx(
        foreground, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    )
    filled = without_holes((foreground > 0) | known, _HOLE_SHARE * foreground.size)
    return np.where(known | ~view.measured, np.uint8(UNKNOWN), filled.astype(np.uint8))
