# SPDX-License-Identifier: Apache-2.0
"""The targets of shots: the people, one moving person, the middle of the scene, or a point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

# ``people`` (the middle of the positions of people among the cameras), ``scene`` (the common centre of the cameras'
# views), a person's id, or a point in metres.
Target = str | tuple[float, float, float]


@dataclass(frozen=True)
class LookAtTargets:
    """Possible targets of a camera.

    Attributes:
        aim_m: person → where a camera aims at them in every frame: the pelvis, if cameras saw it.
        facing: person → horizontal unit vectors in which the pelvis faces.
        present: person → frames in which they are present.
        scene_m: common centre of the training cameras' views.
        reach_m: horizontal distance of the training cameras from ``scene_m``: people beyond it are bystanders.
    """

    aim_m: Mapping[str, Float[np.ndarray, "T 3"]]
    facing: Mapping[str, Float[np.ndarray, "T 2"]]
    present: Mapping[str, Bool[np.ndarray, " T"]]
    scene_m: Float[np.ndarray, " 3"]
    frames: int
    fps: float
    reach_m: float = np.inf

    def still(self, target: Target, shot: str) -> Float[np.ndarray, " 3"]:
        """One point for a whole film: of people the median over the frames in which they are present.

        Bystanders behind the cameras count only where nobody is among them. Without people ``people`` means ``scene``.
        Raises UserError for an unknown person.
        """
        if not isinstance(target, str):
            return np.asarray(target, np.float64)
        if target == "scene" or (target == "people" and not self.aim_m):
            return np.asarray(self.scene_m, np.float64)
        if target == "people":
            there = [track[self.present[person]] for person, track in self.aim_m.items()]
            away_m = [np.linalg.norm(np.median(track, axis=0)[:2] - self.scene_m[:2]) for track in there]
            among = [track for track, far in zip(there, away_m) if far < self.reach_m]
            return np.median(np.concatenate(among or there), axis=0)
        return np.median(self._of(self.aim_m, target, shot)[self.present[target]], axis=0)

    def at(
        self, target: Target, times: Num[np.ndarray, " P"], shot: str, smooth_s: float = 0.5
    ) -> Float[np.ndarray, "P 3"]:
        """Positions of the target at capture frames ``times``; those of a moving person smoothed over ``smooth_s``.

        Unsmoothed, a camera that keeps a walking person's pelvis in the middle would nod with every step.
        """
        if not isinstance(target, str) or target in ("scene", "people"):
            return np.tile(self.still(target, shot), (len(times), 1))
        return _sample_track(_smooth(self._of(self.aim_m, target, shot), smooth_s * self.fps), times)

    def facing_at(
        self, person: str, times: Num[np.ndarray, " P"], shot: str, smooth_s: float
    ) -> Float[np.ndarray, " P"]:
        """Azimuth in radians that a person faces at capture frames ``times``; directions are averaged, not angles."""
        smooth = _sample_track(_smooth(self._of(self.facing, person, shot), smooth_s * self.fps), times)
        return np.arctan2(smooth[:, 1], smooth[:, 0])

    def _of(self, tracks: Mapping[str, np.ndarray], person: str, shot: str) -> np.ndarray:
        if person not in tracks:
            known = ", ".join(tracks) or "nobody"
            raise UserError(
                f"shot {shot} is aimed at {person!r}; known targets are people, scene, a point [x, y, z] and {known}"
            )
        return tracks[person]


def _smooth(track: np.ndarray, sigma_frames: float) -> np.ndarray:
    if sigma_frames <= 0 or len(track) < 3:
        return track
    return scipy.ndimage.gaussian_filter1d(track, sigma_frames, axis=0, mode="nearest")


def _sample_track(track: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, np.arange(len(track)), column) for column in track.T], axis=1)
