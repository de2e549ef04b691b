# SPDX-License-Identifier: Apache-2.0
"""Evidence of people in a camera's pictures beside motion: the detector's masks, and differences from the empty
room."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.footage.stills import read_plate
from studiorecon.geometry.lens import video_from_working
from studiorecon.images.channels import channel_max
from studiorecon.people.association.grouping import Group
from studiorecon.people.pictures.change import (
    PICTURES,
    count_changed_places,
    normalise_picture,
    pictures_at,
    sample_frames,
)
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections, read_raw_detections

# Fewer places do not make a share.
_MIN_PLACES = 20


@dataclass(frozen=True)
class CameraEvidence:
    """One camera's evidence other than its film.

    Attributes:
        lens, footage: the map from its working pixels to its footage.
        masks: the detector's file, or None without one.
        plate: the user's clean plate at the working size, or None.
    """

    lens: Lens
    footage: Footage
    masks: Path | None = None
    plate: Path | None = None

    @cached_property
    def raw_detections(self) -> RawDetections | None:
        """The detector's file with its masks, read on first use: hundreds of megabytes for a long take."""
        return read_raw_detections(self.masks, masks=True) if self.masks else None


def mask_coverage(
    group: Group, view: int, found: Detections, camera: Camera, witness: CameraEvidence
) -> tuple[float, float]:
    """(share of positions under the mask, median presence); NaN where the network did not detect them."""
    if witness.raw_detections is None or found.row is None:
        return float("nan"), float("nan")
    tracks = [track for v, track in group.members if v == view]
    mine = np.flatnonzero(np.isin(found.track, tracks) & (found.row >= 0) & group.seen[view, found.frame])
    if not len(mine):
        return float("nan"), float("nan")
    inside: list[np.ndarray] = []
    for d in mine[spread_indices(len(mine), PICTURES)]:
        row = int(found.row[d])
        pixels, depth = camera.project(group.points_m[found.frame[d]])
        known = np.isfinite(pixels).all(-1) & (depth > 0)
        at = video_from_working(
            pixels[known], witness.lens, witness.footage.source_wh, np.array(witness.footage.intrinsics)
        )
        affine, mask = witness.raw_detections.mask_from_picture[row], witness.raw_detections.mask[row]
        columns, rows = np.floor(at @ affine[:, :2].T + affine[:, 2]).astype(int).T
        there = (columns >= 0) & (rows >= 0) & (columns < mask.shape[1]) & (rows < mask.shape[0])
        inside.append(np.where(there, mask[np.where(there, rows, 0), np.where(there, columns, 0)] > 127, False))
    whole = np.concatenate(inside)
    share = float(whole.mean()) if len(whole) else float("nan")
    return share, float(np.median(witness.raw_detections.presence[found.row[mine]]))


def plate_difference_share(group: Group, camera: Camera, video: Path, witness: CameraEvidence) -> float:
    """Share of the positions where the picture differs from the clean plate; NaN without one, or with too few
    positions."""
    if witness.plate is None:
        return float("nan")
    plate, measured = read_plate(witness.plate)
    empty = normalise_picture(np.rint(255 * plate).astype(np.uint8))
    counts = np.zeros(2, dtype=int)
    for t, picture in pictures_at(video, sample_frames(group.frames, PICTURES)).items():
        apart = np.where(measured, channel_max(np.abs(normalise_picture(picture) - empty)), np.nan)
        counts += count_changed_places(apart, group.points_m[t], camera).sum(0)
    return float(counts[0] / counts[1]) if counts[1] >= _MIN_PLACES else float("nan")
