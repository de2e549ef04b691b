# SPDX-License-Identifier: Apache-2.0
"""The lag of one person's tracks between two calibrated cameras: at one moment, rays to the same joint meet.

Without a calibration every lag has an epipolar geometry of its own, which a person who walks evenly fits at many lags.
A calibration removes this freedom. But a slightly wrong one makes rays miss by a constant, which for an evenly walking
person equals a lag. That error is included in the sigma, and a calibration that is far off gives no result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.clocks.people_lag import PeopleLag, track_lag
from studiorecon.geometry.lens import calibration_from_video_pixels, normalised_from_calibration
from studiorecon.geometry.rotations import cross_matrix
from studiorecon.scene.camera import Lens
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# Least error of a calibration where people are (1 σ), metres; a larger constant miss of joints raises it, and with it
# the sigma of a lag. Where rays at the best lag miss by more than the second (median), the calibration is of other
# cameras, or these are two people.
_CALIBRATION_M, _MAX_M = 0.03, 0.10
_HIDDEN = 2.0
# Sine of the angle of two rays below which their distance hardly depends on the lag.
_MIN_SINE = 0.1
_MIN_ROWS = 8


@dataclass(frozen=True)
class CalibratedPair:
    """``second_from_first`` (4, 4) of two calibrated cameras, metres."""

    second_from_first: Float[np.ndarray, "4 4"]

    @staticmethod
    def of(first: Lens, second: Lens) -> CalibratedPair:
        return CalibratedPair(second.camera_from_world @ np.linalg.inv(first.camera_from_world))

    @property
    def essential(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) E with x_second' E x_first = 0."""
        return cross_matrix(self.second_from_first[:3, 3]) @ self.second_from_first[:3, :3]

    def gaps_m(
        self, first: Float[np.ndarray, "T J 3"], second: Float[np.ndarray, "t J 3"], lag: int
    ) -> Float[np.ndarray, "T J"]:
        """(len(first), J) signed gaps between the rays first[t] and second[t + lag], NaN where one is missing or they
        are nearly parallel."""
        other = np.full_like(first, np.nan)
        rows = np.arange(len(first))
        inside = (rows + lag >= 0) & (rows + lag < len(second))
        other[inside] = second[rows[inside] + lag]
        turned = first @ self.second_from_first[:3, :3].T
        across = np.cross(turned, other)
        length = np.linalg.norm(across, axis=-1)
        sine = length / (np.linalg.norm(turned, axis=-1) * np.linalg.norm(other, axis=-1))
        gap = across @ self.second_from_first[:3, 3] / np.where(length > 0, length, 1.0)
        return np.where(sine > _MIN_SINE, gap, np.nan)


def normalise_detections(seen: Detections, lens: Lens, wh: tuple[int, int]) -> Detections:
    """The detections in normalised coordinates of the lens, from pixels of footage of size ``wh``; points outside its
    field are missing."""
    affine = calibration_from_video_pixels(lens, wh)
    there = (seen.keypoints[..., 2] > 0) & np.isfinite(seen.keypoints[..., :2]).all(-1)
    pixels = np.where(there[..., None], seen.keypoints[..., :2], 1.0) @ affine[:, :2].T + affine[:, 2]
    rays, valid = normalised_from_calibration(pixels, lens)
    there &= valid
    keypoints = np.concatenate(
        [np.where(there[..., None], rays, np.nan), np.where(there, seen.keypoints[..., 2], 0.0)[..., None]], axis=-1
    )
    return replace(seen, keypoints=keypoints)


def calibrated_lag(
    first: Float[np.ndarray, "T J 3"], second: Float[np.ndarray, "t J 3"], rate: float, pair: CalibratedPair
) -> PeopleLag | None:
    """The lag of two tracks (T, J, 3) and (T', J, 3) of rays, NaN where missing, as from ``people_lag.track_lag``.

    None where no lag is clearly best, or rays miss each other at the best one too. Its sigma includes the effect of a
    calibration error of 3 cm, or of joints' constant miss; this is 0 where people go to and fro.
    """
    found = track_lag(first, second, rate, pair.essential)
    if found is None:
        return None
    at = round(found.rows)
    gaps = pair.gaps_m(first, second, at)
    per_row = (pair.gaps_m(first, second, at + 1) - pair.gaps_m(first, second, at - 1)) / 2
    known, moving = np.isfinite(gaps), np.isfinite(per_row)
    if not known.any() or not moving.any() or np.median(np.abs(gaps[known])) > _MAX_M:
        return None
    known &= known.sum(0) >= _MIN_ROWS
    constant = [float(np.median(column[there])) for column, there in zip(gaps.T, known.T) if there.any()]
    off_m = float(np.hypot(_CALIBRATION_M, _HIDDEN * np.sqrt(np.mean(np.square(constant))))) if constant else np.inf
    mistaken = off_m * abs(per_row[moving].mean()) / max(float((per_row[moving] ** 2).mean()), 1e-12)
    return replace(found, sigma_rows=float(np.hypot(found.sigma_rows, mistaken)))
