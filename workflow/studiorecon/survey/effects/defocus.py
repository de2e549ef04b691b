# SPDX-License-Identifier: Apache-2.0
"""Measures whether a camera is less sharp than the others, which softens its photos; the effect only informs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import NOTHING, SIGMA_OF_MAD, Estimate, median_estimate
from studiorecon.images.channels import channel_sum
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Blur is stated in pixels at this width; working frames of another width have proportionally more or less.
AT_WIDTH = 1280.0
# The second blur; the share of the steepest slopes and the slope below which a pixel is no edge; the number of edges
# needed.
_AGAIN_PX, _STEEP_SHARE, _MIN_SLOPE, _MIN_EDGES = 1.0, 0.01, 0.01, 100
# The sharpest of them show the focus: others are soft in the world.
_SHARPEST = 0.25
# Errors of pixels along one edge are correlated.
_TOGETHER = 8
# Scenes before the cameras differ in sharpness by this share of the blur, one standard deviation: 0.05 to 0.2 in a real
# room and four synthetic ones. With this many cameras the spread is measured instead; a normal distribution's standard
# deviation is 1.4826 median deviations.
_APART, _MANY = 0.1, 6


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The blur of each clean plate's edges beyond that of the median camera, the largest of them.

    Blurs add in squares: ``extra² = blur² - median²``. Plates contain neither noise nor moving people.
    """
    views = evidence.material.views
    found = [edge_blur_px(view.rgb, view.measured) for view in evidence.material.views]
    scale = [AT_WIDTH / max(view.camera.wh) for view in views]
    blur = np.array([np.nan if e.value is None else e.value * s for e, s in zip(found, scale)])
    error = np.array(
        [
            np.nan if e.interval is None or e.value is None else (e.interval[1] - e.value) * s
            for e, s in zip(found, scale)
        ]
    )
    known = np.flatnonzero(np.isfinite(blur)).tolist()
    if len(known) < 2:
        return Measurement(None, None, "fewer than two cameras see enough sharp edges to compare their focus")
    usual = float(np.median(blur[known]))
    worst = max(known, key=lambda k: blur[k] - error[k])
    # Some camera always sees softer things than the others: its blur must exceed that usual spread.
    shown = SIGMA_OF_MAD * float(np.median(np.abs(blur[known] - usual))) if len(known) >= _MANY else 0.0
    spread = max(_APART * usual, shown)
    extra = _excess_blur(blur[worst], error[worst], 2 * spread, usual)
    reason = (
        f"{views[worst].camera.name}'s sharpest edges are {blur[worst]:.1f} px wide (at {AT_WIDTH:.0f}), the median "
        f"camera's {usual:.1f}"
    )
    if extra.value is not None and extra.value > threshold:
        reason += "; focus it or clean its lens before the next take"
    detail = {views[k].camera.name: round(float(blur[k]), 3) for k in known}
    return Measurement(extra.value, extra.interval, reason, {"blur_px": detail})


def _excess_blur(blur: float, error: float, scene_error: float, usual: float) -> Estimate:
    """The blur that, added to ``usual``, gives ``blur``, with an interval; ``scene_error`` may be the scene's."""
    if not np.isfinite(error):
        return NOTHING
    ends = (blur, blur - float(np.hypot(error, scene_error)), blur + error)
    value, low, high = (float(np.sqrt(max(b * abs(b) - usual**2, 0.0))) for b in ends)
    return Estimate(value, (low, high))


def edge_blur_px(rgb: Float[np.ndarray, "H W 3"], measured: Bool[np.ndarray, "H W"]) -> Estimate:
    """Standard deviation, px, of the blur of a picture's sharpest edges: ``rgb`` in [0, 1], where ``measured``.

    A step blurred by s has the slope 1 / s; blurred again by a, 1 / √(s² + a²): their ratio R gives s = a / √(R² - 1)
    (Zhuo and Sim 2011, Defocus map estimation from a single image). Only the steepest pixel across each edge counts; a
    picture with few edges has no estimate.
    """
    require("rgb", rgb, ("H", "W", 3))
    require("measured", measured, rgb.shape[:2])
    grey = channel_sum(rgb.astype(np.float32)) / 3
    again = cv2.GaussianBlur(grey, (0, 0), _AGAIN_PX)
    dx, dy = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    slope = np.hypot(dx, dy)
    softer = np.hypot(*(cv2.Sobel(again, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))))
    inside = cv2.erode(measured.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    across = np.abs(dx) >= np.abs(dy)
    beside = np.where(across, _neighbours(slope, 1), _neighbours(slope, 0))
    edge = inside & (slope >= beside) & (slope > _MIN_SLOPE) & (softer > 0) & (slope > 1.01 * softer)
    if edge.sum() < _MIN_EDGES:
        return NOTHING
    edge &= slope >= np.quantile(slope[inside], 1 - _STEEP_SHARE)
    ratio = (slope[edge] / softer[edge]).astype(np.float64)
    widths = np.sort(_AGAIN_PX / np.sqrt(ratio**2 - 1))
    sharpest = widths[: max(int(_SHARPEST * len(widths)), 1)]
    return median_estimate(sharpest[::_TOGETHER], _MIN_EDGES // (4 * _TOGETHER))


def _neighbours(slope: np.ndarray, axis: int) -> np.ndarray:
    """The steeper of each pixel's two neighbours along ``axis``."""
    return np.maximum(np.roll(slope, 1, axis), np.roll(slope, -1, axis))


EFFECT = SurveyedEffect(
    name="defocus",
    statistic="largest blur (standard deviation) of a camera's sharpest edges beyond the median camera's",
    unit="px at 1280",
    threshold=2.0,
    hidden_by=("moving_cameras",),
    measure=measure,
)
