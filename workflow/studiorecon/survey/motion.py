# SPDX-License-Identifier: Apache-2.0
"""Lens, clock and readout: what keeps the rays of one body point from meeting, and whether it matters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision, decide
from studiorecon.scene.intervals import largest
from studiorecon.survey.rays import Causes

# Pixels are meant at this width; working frames of another have as much less or more.
_AT_WIDTH = 1280.0
_SLOWEST_PX = 5.0


def decide_lens(cameras: Sequence[Camera], found: Causes, threshold: float, was_on: bool = False) -> Decision:
    """Is there radial distortion left in the frames (after the calibration's was removed)?"""
    corners = np.array([_corner_shift(c) for c in cameras])
    estimate = largest(found.radial * corners, found.radial_sigma * corners)
    name = cameras[estimate.which].name if estimate.value is not None else ""
    reason = found.reason or (
        f"{name}: k1 = {found.radial[estimate.which]:+.4f} ± {found.radial_sigma[estimate.which]:.4f} remains in its frames; "
        "a lens is corrected by the calibration: give one with distortion if this is on"
    )
    return decide(
        "lens_distortion", "largest radial shift in a corner, fitted jointly with body points", estimate.value, estimate.interval,
        threshold, reason, unit=f"px at {_AT_WIDTH:.0f}", was_on=was_on, detail={"radial": _told(cameras, found.radial)},
    )  # fmt: skip


def decide_sync(cameras: Sequence[Camera], found: Causes, threshold: float, was_on: bool = False) -> Decision:
    """Does a camera's clock run beside the others' (numerics V07: nobody who stands still can tell)?"""
    estimate = largest(found.lag_frames, found.lag_sigma)
    value, interval, reason = estimate.value, estimate.interval, found.reason
    if value is not None:
        name, at = cameras[estimate.which].name, estimate.which
        reason = (
            f"{name} looks {found.lag_frames[at]:+.2f} ± {found.lag_sigma[at]:.2f} frames later than the others; lags lower "
            f"the squared residual by {max(found.fall, 0):.0%}"
        )
        if too_slow := _too_slow(cameras, found):
            value, interval, reason = None, None, too_slow
    return decide(
        "sync_offset", "largest lag of a camera behind the mean of the others", value, interval, threshold, reason,
        unit="frames", was_on=was_on, detail={"lag_frames": _told(cameras, found.lag_frames)},
    )  # fmt: skip


def decide_readout(cameras: Sequence[Camera], found: Causes, threshold: float, was_on: bool = False) -> Decision:
    """Do rows look one after the other, slowly enough to bend who moves?"""
    scale = found.speed_px[1] * found.rows * _AT_WIDTH / max(max(c.wh) for c in cameras)
    estimate = largest(found.readout * scale, found.readout_sigma * scale)
    value, interval, reason = estimate.value, estimate.interval, found.reason
    if value is not None:
        at = estimate.which
        reason = f"{cameras[at].name} reads its rows in {found.readout[at]:+.2f} ± {found.readout_sigma[at]:.2f} frame intervals"
        if too_slow := _too_slow(cameras, found):
            value, interval, reason = None, None, too_slow
    return decide(
        "rolling_shutter", "shift over the rows that people cover, at the 95 % speed", value, interval, threshold, reason,
        unit=f"px at {_AT_WIDTH:.0f}", was_on=was_on, detail={"readout": _told(cameras, found.readout)},
    )  # fmt: skip


def _too_slow(cameras: Sequence[Camera], found: Causes) -> str:
    speed = found.speed_px[0] * _AT_WIDTH / max(max(c.wh) for c in cameras)
    if speed >= _SLOWEST_PX:
        return ""
    return f"people move by {speed:.1f} px per frame (at {_AT_WIDTH:.0f} wide); below {_SLOWEST_PX:.0f} clocks cannot be told apart"


def _corner_shift(camera: Camera) -> float:
    """Shift of the furthest corner for k1 = 1, in pixels at 1280 wide."""
    corners = np.array([[0, 0], [camera.wh[0], 0], [0, camera.wh[1]], camera.wh], dtype=np.float64)
    radius = np.linalg.norm((corners - camera.principal_px) / camera.focal_px, axis=1).max()
    return float(radius**3 * np.mean(camera.focal_px) * _AT_WIDTH / max(camera.wh))


def _told(cameras: Sequence[Camera], values: np.ndarray) -> dict[str, float]:
    return {c.name: round(float(v), 4) for c, v in zip(cameras, values) if np.isfinite(v)}
