# SPDX-License-Identifier: Apache-2.0
"""Other readings of a calibration, as starts that people compare: under the right one their rays meet.

Every start has one score, whatever it changes: the log-likelihood of people's joints against chance, as a share of the
most that they could have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import stable_detections
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.from_tracks import scale_camera
from studiorecon.rig.human_size import UNITS_PER_METRE, is_adult, is_possible, median_stature_m, size_refusal
from studiorecon.rig.lens_model import LensReading
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

NOISE_SHARE = 0.003
"""Error of detectors, as a share of the longer side (6 of 1920 px)."""
FRAMES = 24
"""Frames on which people judge a calibration, spread over those that show them."""
LIMITS = Limits(outlier_units=9.0)
"""Wide, since a calibration may be slightly off and still be the right one."""
_GATE_SHARE = LIMITS.huber_share * LIMITS.outlier_units
# By so much its score must be better for a start to be chosen: 0.8 nats of 5.4 a joint, so that without it people's
# errors are 1.5 times as large.
_MARGIN = 0.15
# Standard errors by which one must be better in every frame on average: 1 in 700 by chance.
_SURE = 3.0
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Change = Callable[[np.ndarray], np.ndarray]
# Reading of all poses → the change, and the setting that makes it.
CONVENTIONS: dict[str, tuple[Change, str]] = {
    "poses are world-from-camera": (np.linalg.inv, "world_from_camera"),
    "axes are OpenGL's": (lambda pose: _FLIP @ pose, "opengl"),
    "world-from-camera with OpenGL axes": (lambda pose: _FLIP @ np.linalg.inv(pose), "world_from_camera_opengl"),
}
# Reading of all lenses → the model, and so the value of ``calibration.lens``.
LENS_READINGS: dict[str, LensReading] = {"the lenses are fisheyes": "fisheye", "the lenses are not fisheyes": "opencv"}
_UNITS = {"millimetres": "set calibration.unit: mm", "centimetres": "set calibration.unit: cm"}


@dataclass(frozen=True, eq=False)
class Start:
    """One reading of a capture.

    Attributes:
        words: what it supposes, after "people fit if"; ``remedy``: what the user does then.
        cameras, detections: by this reading.
        per_metre: number of the supposed unit of all lengths in a metre.
        is_swap: whether two cameras are exchanged.
    """

    words: str
    remedy: str
    cameras: Sequence[Camera]
    detections: Sequence[Detections]
    per_metre: float = 1.0
    is_swap: bool = False


@dataclass(frozen=True)
class Comparison:
    """Starts, the first as read, with their log-likelihoods in F frames and scores from 0 to 1; ``held``: the score of
    the cameras that will be used, or as read where that is better."""

    starts: Sequence[Start]
    nats: Float[np.ndarray, "S F"]
    scores: Sequence[float]
    held: float

    @property
    def chosen(self) -> list[Start]:
        """The starts that people require; several where they cannot tell them apart, as on a regular ring."""
        best = int(np.argmax(self.scores))
        if self.scores[best] <= self.held + _MARGIN:
            return []
        return [
            s
            for k, s in enumerate(self.starts)
            if self.scores[k] and not is_clearly_better(self.nats[best], self.nats[k])
        ]

    @property
    def margin(self) -> float:
        """By how much the cameras that will be used are better than the best other start."""
        return self.held - max(self.scores[1:], default=0.0)

    def rows(self) -> list[dict[str, Any]]:
        """The starts for a report, of exchanges of cameras the best one; ``close``: as good as the first by chance."""
        chosen, best_swap = self.chosen, max([s for start, s in zip(self.starts, self.scores) if start.is_swap] + [0.0])
        return [
            {
                "hypothesis": start.words,
                "score": score,
                "close": score > 0 and not is_clearly_better(self.nats[0], self.nats[k]),
                "remedy": start.remedy,
            }
            for k, (start, score) in enumerate(zip(self.starts, self.scores, strict=True))
            if not start.is_swap or score == best_swap > 0 or start in chosen
        ]

    def refuse_others(self, frames: Integer[np.ndarray, " F"], gate_m: float) -> None:
        """Raise UserError where people require another start than the first."""
        for start in self.chosen:
            if start.per_metre != 1.0:
                seen = make_observations(start.detections, start.cameras, frames, gate_m)[0]
                stature_m = median_stature_m(start.cameras, seen, LIMITS)
                assert stature_m is not None
                raise size_refusal(stature_m * start.per_metre)
        if self.chosen:
            words = " or ".join(start.words for start in self.chosen)
            raise UserError(
                f"the calibration fits the people only if {words} (agreement {max(self.scores):.2f}, "
                f"{self.scores[0]:.2f} as read): {self.chosen[0].remedy}, or export it again"
            )


def compare(
    starts: Iterable[Start], frames: Integer[np.ndarray, " F"], gate_m: float, used: Start | None = None
) -> Comparison:
    """The starts, the first as read, by people in ``frames``; none after it where none could be clearly better.

    ``used``: the cameras that will be used, where they are others than read.
    """
    held = 0.0
    if used is not None:
        nats, most = people_nats(used, frames, gate_m)
        held = float(nats.sum() / most)
    tried: list[Start] = []
    likelihoods, scores = [], []
    for start in starts:
        nats, most = people_nats(start, frames, gate_m)
        tried.append(start)
        likelihoods.append(nats)
        scores.append(float(nats.sum() / most))
        held = max(held, scores[0])
        if held + _MARGIN >= 1:
            break
    return Comparison(tried, np.stack(likelihoods), scores, held)


def is_clearly_better(first: Num[np.ndarray, " F"], second: Num[np.ndarray, " F"]) -> bool:
    """Whether one reading has more log-likelihood than another by more than chance would."""
    gain = first - second
    return bool(gain.sum() > 0 and gain.mean() > _SURE * gain.std() / np.sqrt(max(len(gain), 1)))


def calibration_starts(cameras: Sequence[Camera], detections: Sequence[Detections]) -> Iterator[Start]:
    """The cameras as read; all poses or lengths read otherwise; two of three cameras or more exchanged."""
    yield Start("as read", "", cameras, detections)
    for words, (change, setting) in CONVENTIONS.items():
        yield Start(words, f"set calibration.poses: {setting}", [posed(c, change) for c in cameras], detections)
    for unit, per_metre in UNITS_PER_METRE.items():
        smaller = [scale_camera(c, 1 / per_metre) for c in cameras]
        scale = f"multiply calibration.scale by {1 / per_metre:.4g}"
        yield Start(f"lengths are {unit}", _UNITS.get(unit, scale), smaller, detections, per_metre)
    larger = [scale_camera(c, 1000.0) for c in cameras]
    yield Start("lengths were divided by 1000", "set calibration.unit: m", larger, detections, 0.001)
    for i, j in combinations(range(len(cameras)), 2) if len(cameras) > 2 else ():
        swapped = list(cameras)
        swapped[i] = replace(cameras[i], camera_from_world=cameras[j].camera_from_world)
        swapped[j] = replace(cameras[j], camera_from_world=cameras[i].camera_from_world)
        remedy = "exchange their names in the calibration, or their videos and keypoints"
        yield Start(
            f"cameras {cameras[i].name} and {cameras[j].name} are swapped", remedy, swapped, detections, is_swap=True
        )


def lens_start(name: str, cameras: Sequence[Camera], detections: Sequence[Detections]) -> Start:
    """The start of ``cameras`` whose lenses are read as ``name`` of ``LENS_READINGS`` says."""
    return Start(name, f"set calibration.lens: {LENS_READINGS[name]}", cameras, detections)


def people_nats(
    start: Start, frames: Integer[np.ndarray, " F"], gate_m: float
) -> tuple[Float[np.ndarray, " F"], float]:
    """Log-likelihood ratio of people's joints in every frame, a start against chance, and the most there could be.

    0 where no rays meet, where people are too large or small, and where they are no adults by lengths in another unit.
    """
    total = np.zeros(len(frames))
    cameras, joints = start.cameras, stable_detections(start.detections, frames)
    most = sum(int((d.keypoints[..., 2] > LIMITS.min_confidence).sum()) for d in joints)
    most_nats = max(most * float(error_nats(np.zeros(1), _GATE_SHARE)[0]), 1.0)
    seen, _ = make_observations(start.detections, cameras, frames, gate_m)
    stature_m = median_stature_m(cameras, seen, LIMITS)
    if not len(seen.frame) or not (is_adult(stature_m) if start.per_metre != 1.0 else is_possible(stature_m)):
        return total, most_nats
    found = triangulate(seen.pixels, seen.confidence, cameras, LIMITS)
    # Two rays of three cameras or more nearly meet by chance.
    counted = found.inliers & (found.verified if len(cameras) > 2 else found.valid)
    off = np.where(counted, found.error_px, np.inf) / np.array([[max(c.wh)] for c in cameras])
    np.add.at(total, np.searchsorted(frames, seen.frame), error_nats(off, _GATE_SHARE).sum(0))
    return total, most_nats


def error_nats(
    off: Num[np.ndarray, " *shape"], gate: Num[np.ndarray, " *gates"] | float
) -> Float[np.ndarray, " *shape"]:
    """Log-likelihood ratio of errors against one of ``gate``, both as shares of the longer side.

    By Cauchy's distribution: a calibration that is somewhat off is still far better than a wrong one.
    """
    with np.errstate(divide="ignore", over="ignore"):
        found: np.ndarray = np.maximum(np.log((gate**2 + NOISE_SHARE**2) / (off**2 + NOISE_SHARE**2)), 0.0)
    return found


def posed(camera: Camera, change: Change) -> Camera:
    """The camera with a changed pose."""
    return replace(camera, camera_from_world=change(camera.camera_from_world))
