# SPDX-License-Identifier: Apache-2.0
"""Evidence from the detector's own masks: the only source that depends neither on the plate nor on the fitted body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.geometry.lens import video_from_working
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections

if TYPE_CHECKING:
    from jaxtyping import Float

# Largest log-odds of a network's pixel: its outline is as coarse as its mask, and it is overconfident.
_MAX = 1.5


@dataclass(frozen=True)
class DetectorMasks:
    """The detector's masks of one camera's people, on the working picture.

    Attributes:
        detections: the detector's file, with masks.
        rows: (frame, person) → row of the file.
        in_footage: pixels of the footage at the working pixels' centres.
    """

    detections: RawDetections
    rows: Mapping[tuple[int, str], int]
    in_footage: Float[np.ndarray, "H W 2"]

    def evidence(self, frame: int, names: Sequence[str]) -> Float[np.ndarray, "H W"]:
        """Float32 log-odds that one of ``names`` is at a pixel: the most confident mask; 0 where no mask reaches."""
        total = np.zeros(self.in_footage.shape[:2], np.float32)
        covered = np.zeros(total.shape, bool)
        for row in (self.rows[frame, name] for name in names if (frame, name) in self.rows):
            affine = self.detections.mask_from_picture[row]
            place = (self.in_footage @ affine[:, :2].T + affine[:, 2] - 0.5).astype(np.float32)
            mask = self.detections.mask[row].astype(np.float32) / 255
            sure = cv2.remap(
                mask, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0
            )
            inside = sure >= 0
            log_odds = np.clip(np.log(np.maximum(sure, 1e-3) / np.maximum(1 - sure, 1e-3)), -_MAX, _MAX)
            total = np.where(inside, np.where(covered, np.maximum(total, log_odds), log_odds), total)
            covered |= inside
        return total


def masks_by_frame(
    found: RawDetections, detections: Detections, who: Mapping[tuple[str, int], str], lens: Lens, footage: Footage
) -> DetectorMasks:
    """The detector's masks by frame and person; where tracks of one person overlap, the more confident detection's."""
    rows: dict[tuple[int, str], int] = {}
    best: dict[tuple[int, str], float] = {}
    given = np.full(len(detections.frame), -1) if detections.row is None else detections.row
    for frame, track, row, keypoints in zip(detections.frame, detections.track, given, detections.keypoints):
        key = int(frame), who.get((detections.camera, int(track)), "")
        if key[1] and row >= 0 and keypoints[:, 2].sum() > best.get(key, 0.0):
            rows[key], best[key] = int(row), float(keypoints[:, 2].sum())
    width, height = footage.wh
    columns, lines = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return DetectorMasks(
        found,
        rows,
        video_from_working(np.stack([columns, lines], -1), lens, footage.source_wh, np.array(footage.intrinsics)),
    )
