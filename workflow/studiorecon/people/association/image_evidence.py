# SPDX-License-Identifier: Apache-2.0
"""Who is in the pictures though nothing moves: what the detector's masks and the user's clean plates say of somebody.

Somebody who stands or sits still changes no picture, and keypoints that tremble over them look like those of nobody.
Whom one camera confirms in another way is not doubted: its network covers the places where the cameras' rays meet, and
is sure that somebody is there; or the picture differs at these places from the room without anybody.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames
from studiorecon.geometry.lens import video_from_working
from studiorecon.images.channels import channel_max
from studiorecon.people.association.grouping import Group
from studiorecon.people.association.picture_change import (
    EvidenceLimits,
    even,
    places_changed,
    sampled_frames,
    view_shares,
)
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections, read_raw_detections


@dataclass(frozen=True)
class CameraEvidence:
    """What one camera has beside its film.

    Attributes:
        lens, footage: how its working pixels lie in its footage.
        masks: the detector's file, or None where it did not look.
        plate: the user's clean plate at the working size, or None.
    """

    lens: Lens
    footage: Footage
    masks: Path | None = None
    plate: Path | None = None

    @cached_property
    def found(self) -> RawDetections | None:
        """The detector's file with its masks, read when it is first asked for: hundreds of megabytes of a long take."""
        return read_raw_detections(self.masks, masks=True) if self.masks else None


@dataclass(frozen=True)
class ImageEvidence:
    """What one camera says of somebody beside motion; NaN where it has nothing to say.

    Attributes:
        covered: share of the places where rays meet that its network's mask covers.
        presence: how sure that network is that somebody is there, in the median.
        differs: share of these places where the picture differs from the clean plate.
    """

    covered: float
    presence: float
    differs: float

    def confirms(self, limits: EvidenceLimits) -> bool:
        """Whether that is enough for a person."""
        by_mask = self.covered >= limits.covered_share and self.presence >= limits.presence
        return by_mask or self.differs >= limits.present_share


def evidence_in_camera(
    group: Group,
    view: int,
    found: Detections,
    camera: Camera,
    video: Path,
    witness: CameraEvidence,
    limits: EvidenceLimits,
) -> ImageEvidence:
    """What the camera of number ``view``, whose detections are ``found``, says of somebody."""
    covered, presence = _by_mask(group, view, found, camera, witness, limits)
    return ImageEvidence(covered, presence, _by_plate(group, camera, video, witness, limits))


def _by_mask(
    group: Group, view: int, found: Detections, camera: Camera, witness: CameraEvidence, limits: EvidenceLimits
) -> tuple[float, float]:
    """(share of places under the mask, median presence); NaN where the network did not see them."""
    if witness.found is None or found.row is None:
        return float("nan"), float("nan")
    tracks = [track for v, track in group.members if v == view]
    mine = np.flatnonzero(np.isin(found.track, tracks) & (found.row >= 0) & group.seen[view, found.frame])
    if not len(mine):
        return float("nan"), float("nan")
    inside: list[np.ndarray] = []
    for d in mine[evenly_spread(len(mine), limits.frames)]:
        row = int(found.row[d])
        pixels, depth = camera.project(group.points_m[found.frame[d]])
        known = np.isfinite(pixels).all(-1) & (depth > 0)
        at = video_from_working(
            pixels[known], witness.lens, witness.footage.source_wh, np.array(witness.footage.intrinsics)
        )
        affine, mask = witness.found.mask_from_picture[row], witness.found.mask[row]
        columns, rows = np.floor(at @ affine[:, :2].T + affine[:, 2]).astype(int).T
        there = (columns >= 0) & (rows >= 0) & (columns < mask.shape[1]) & (rows < mask.shape[0])
        inside.append(np.where(there, mask[np.where(there, rows, 0), np.where(there, columns, 0)] > 127, False))
    whole = np.concatenate(inside)
    share = float(whole.mean()) if len(whole) else float("nan")
    return share, float(np.median(witness.found.presence[found.row[mine]]))


def _by_plate(group: Group, camera: Camera, video: Path, witness: CameraEvidence, limits: EvidenceLimits) -> float:
    """Share of the places where the picture differs from the clean plate; NaN without one, or with too few places."""
    if witness.plate is None:
        return float("nan")
    plate, measured = read_plate(witness.plate)
    empty = even(np.rint(255 * plate).astype(np.uint8))
    chosen = set(sampled_frames(group.frames, limits.frames).tolist())
    counts = np.zeros(2, dtype=int)
    for t, picture in enumerate(read_frames(video, 0, max(chosen, default=-1) + 1)):
        if t in chosen:
            apart = np.where(measured, channel_max(np.abs(even(picture) - empty)), np.nan)
            counts += places_changed(apart, group.points_m[t], camera, limits).sum(0)
    return float(view_shares(counts))


def evidence_in_cameras(
    group: Group,
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    videos: Sequence[Path],
    witnesses: Sequence[CameraEvidence | None],
    limits: EvidenceLimits,
) -> list[ImageEvidence | None]:
    """What every camera says of somebody; None of a camera that has nothing beside its film."""
    return [
        evidence_in_camera(group, v, detections[v], cameras[v], videos[v], witness, limits) if witness else None
        for v, witness in enumerate(witnesses)
    ]
