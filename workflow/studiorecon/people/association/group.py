# SPDX-License-Identifier: Apache-2.0
"""A group of per-camera tracks that may be one person, and the points that its cameras agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class Group:
    """Tracks that show one person.

    Attributes:
        members: (view, track) pairs, sorted.
        points_m: stable keypoints, NaN where undetermined.
        agreement: share of each view's keypoints that agree with the points, NaN where it has none.
        seen: (V, T) bool: the view has at least three agreeing keypoints in that frame.
        detected: the view has a detection in that frame.
    """

    members: tuple[tuple[int, int], ...]
    points_m: Float[np.ndarray, "T K 3"]
    agreement: Float[np.ndarray, " V"]
    seen: Bool[np.ndarray, "V T"]
    detected: Bool[np.ndarray, "V T"]

    @property
    def frames(self) -> Integer[np.ndarray, " F"]:
        """Frames in which at least two cameras agree."""
        return np.flatnonzero(self.seen.sum(0) >= 2)

    def seen_by(self, cameras: Sequence[Camera]) -> list[str]:
        """Names of the cameras that see the group."""
        return [camera.name for camera, seen in zip(cameras, self.seen) if seen.any()]

    @cached_property
    def centres_m(self) -> Float[np.ndarray, "T 3"]:
        """Median of the determined keypoints, NaN where there are none."""
        known = np.isfinite(self.points_m).all(-1)
        centres = np.full((len(self.points_m), 3), np.nan)
        for t in np.flatnonzero(known.any(-1)):
            centres[t] = np.median(self.points_m[t, known[t]], axis=0)
        return centres
