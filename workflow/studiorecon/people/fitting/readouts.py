# SPDX-License-Identifier: Apache-2.0
"""Rolling shutters, measured on moving people; bodies are fitted to corrected keypoints, pictures stay unchanged.

A rolling shutter shows feet later than heads: a person who walks past leans, the more the nearer the camera. A readout
is accepted only if the whole clip and each half agree, if sensors have such a readout, and if it moves a person by a
pixel: a false one bends bodies that were straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.residuals import Readouts, readouts_from_residuals
from studiorecon.scene.camera import Camera
from studiorecon.scene.readouts import Readout

if TYPE_CHECKING:
    from jaxtyping import Num

# Limits of agreement of rays (U34).
_LIMITS = Limits(min_confidence=0.0, huber_share=0.005, outlier_units=3.0, min_angle_deg=2.0, near_m=0.05)
_MOMENTS = 60
# Standard errors by which the whole clip, and each half, must differ from 0.
_CLEAR, _HALF_CLEAR = 3.0, 1.5
# Rows of video sensors take 5 to 33 ms; no frame is shorter than its readout.
_LONGEST_S, _LONGEST_FRAMES = 0.04, 1.05
# A smaller shift, pixels at 1280 wide, is not worth correcting; slower motion than this per second is no evidence.
_SHIFT_PX, _SLOWEST_PX_S, _AT_WIDTH = 1.0, 60.0, 1280.0


def estimate_readouts(pixels: Num[np.ndarray, "V P T J 2"], cameras: Sequence[Camera], fps: float) -> list[Readout]:
    """The readout of every camera, from people's keypoints on the common clock, NaN where not seen."""
    whole = _readouts(pixels, cameras)
    middle = pixels.shape[2] // 2
    halves = [_readouts(part, cameras) for part in (pixels[:, :, :middle], pixels[:, :, middle:])]
    found = []
    for v, camera in enumerate(cameras):
        reason = whole.reason or _doubt(v, camera, fps, whole, halves)
        used_s = 0.0 if reason else float(whole.readout[v]) / fps
        readout_s, sigma_s = (_known(x[v] / fps) for x in (whole.readout, whole.readout_sigma))
        found.append(Readout(camera.name, readout_s, sigma_s, used_s, reason))
    return found


def _known(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None


def _readouts(pixels: np.ndarray, cameras: Sequence[Camera]) -> Readouts:
    return readouts_from_residuals(pixels, cameras, _MOMENTS, _LIMITS)


def _doubt(view: int, camera: Camera, fps: float, whole: Readouts, halves: Sequence[Readouts]) -> str:
    """Why the readout of a camera is not used; "" where it is."""
    to_width = _AT_WIDTH / max(camera.wh)
    speed_px_s = whole.speed_px[0] * to_width * fps
    if not speed_px_s >= _SLOWEST_PX_S:
        return (
            f"people move by {speed_px_s:.0f} px per second (at {_AT_WIDTH:.0f} wide), which is too slow to measure it"
        )
    value, sigma = float(whole.readout[view]), float(whole.readout_sigma[view])
    if not abs(value) > _CLEAR * sigma:
        return "people's motion needs no readout time"
    if abs(value) * whole.speed_px[1] * whole.rows * to_width < _SHIFT_PX:
        return "it would move no keypoint by a pixel"
    if abs(value) > min(_LONGEST_FRAMES, _LONGEST_S * fps):
        return "no sensor takes that long: the lens or the pose is more likely wrong"
    for half in halves:
        if half.reason or not half.readout[view] * np.sign(value) > _HALF_CLEAR * half.readout_sigma[view]:
            return "the two halves of the clip do not both show it"
    return ""
