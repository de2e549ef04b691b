# SPDX-License-Identifier: Apache-2.0
"""Targets of the background: clean plates and synthesized views, with weights for their reliability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float


def angle_between_axes(first: Camera, second: Camera) -> float:
    """Radians between two optical axes; atan2, because arccos of a rounded 1 is NaN (I13)."""
    a, b = first.forward, second.forward
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def cutoff_angle(cameras: Sequence[Camera]) -> float:
    """d_max of the view weight: half the median gap between azimuth neighbours' optical axes, radians (U14).

    Neighbours are taken around the ring; with fewer than two cameras the cut-off is 0.
    """
    if len(cameras) < 2:
        return 0.0
    middle = np.mean([c.centre_m for c in cameras], axis=0)
    azimuth = [np.arctan2(*(c.centre_m - middle)[1::-1]) for c in cameras]
    ring = [cameras[i] for i in np.argsort(azimuth)]
    gaps = [angle_between_axes(a, b) for a, b in zip(ring, ring[1:] + ring[:1])]
    return float(np.median(gaps)) / 2


def view_weight(angle: float, cutoff: float, boost: float) -> float:
    """w = 1 + boost · ½(1 + cos(π d / d_max)): 1 + boost at a real camera, 1 from the cut-off on (paper, appendix C).

    The angle is clamped to the cut-off, or the cosine would rise again (I12); with cut-off 0 only d = 0 is boosted
    (I11).
    """
    if cutoff <= 0:
        return 1.0 + boost * (angle == 0)
    return 1.0 + boost * 0.5 * (1 + float(np.cos(np.pi * min(angle, cutoff) / cutoff)))


def draw_shares(plates: int, views: int, views_share: float) -> Float[np.ndarray, " D"]:
    """Probability of drawing each plate, then each synthesized view; all views together have ``views_share``."""
    if views == 0:
        return np.full(plates, 1 / plates)
    return np.concatenate([np.full(plates, (1 - views_share) / plates), np.full(views, views_share / views)])
