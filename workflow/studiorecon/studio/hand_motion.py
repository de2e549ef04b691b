# SPDX-License-Identifier: Apache-2.0
"""Fingers of the studio's people: every finger curls and spreads on its own, smoothly and within its limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.hands import THUMB, finger_axes
from studiorecon.body.model import BodyModel

if TYPE_CHECKING:
    from jaxtyping import Float

# Flexion of a finger's three joints when stretched and when curled, radians; the thumb's own.
_STRETCHED, _CURLED = np.array([-0.2, -0.1, -0.1]), np.array([1.1, 1.3, 0.7])
_THUMB_STRETCHED, _THUMB_CURLED = np.array([-0.25, -0.15, -0.2]), np.array([0.45, 0.5, 0.7])
# Most spread from the middle finger: index, middle, little, ring finger, thumb.
_SPREAD_RAD = np.array([0.2, 0.05, -0.25, -0.12, 0.3])
_SLOWEST_HZ, _FASTEST_HZ = 0.15, 0.6


def finger_poses(body: BodyModel, seed: int, times_s: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 90"]:
    """Axis-angles of the 30 finger joints at the given moments; the same seed gives the same motion."""
    rng = np.random.default_rng([seed, 41])
    hertz, phase = rng.uniform(_SLOWEST_HZ, _FASTEST_HZ, (2, 2, 5)), rng.uniform(0, 2 * np.pi, (2, 2, 5))
    waves = 0.5 + 0.5 * np.sin(2 * np.pi * hertz * times_s[:, None, None, None] + phase)
    curl, spread = waves[:, 0, :, :, None], waves[:, 1]  # (T, 2, 5, 1), (T, 2, 5)
    flexion = _STRETCHED + curl * (_CURLED - _STRETCHED)
    flexion[:, :, THUMB] = _THUMB_STRETCHED + curl[:, :, THUMB] * (_THUMB_CURLED - _THUMB_STRETCHED)
    angles = np.zeros((len(times_s), 2, 5, 3, 3))
    angles[..., 2] = flexion
    angles[..., 0, 1] = _SPREAD_RAD * spread
    return np.einsum("hfab,thfjb->thfja", finger_axes(body), angles).reshape(len(times_s), 90)
