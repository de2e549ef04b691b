# SPDX-License-Identifier: Apache-2.0
"""Gait: foot plants along a path, the pelvis above them, and legs that reach them (two-bone inverse kinematics).

A planted foot does not move, so nothing slides; the heel rises about the ball of the foot, the toes stay flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

STANCE = 0.62  # share of a stride during which a foot is down
_MIDDLE = STANCE / 2
_TOE_OFF_RAD = np.radians(34)
_HEEL_STRIKE_RAD = np.radians(14)


@dataclass(frozen=True)
class Path:
    """A walk on the floor, by distance walked: a circle around ``centre_m``, or a straight line (radius 0).

    Attributes:
        centre_m: centre of the circle, or distance 0 on a line.
        radius_m: 0 = straight; positive = the centre is on the walker's left.
        heading_rad: direction of walking at distance 0.
        first_m, last_m: the walk begins and ends here (±inf = it continues before and after the clip).
    """

    centre_m: tuple[float, float]
    radius_m: float
    heading_rad: float
    first_m: float
    last_m: float

    def at(
        self, distance_m: Float[np.ndarray, " T"], left_m: float | Float[np.ndarray, " T"] = 0.0
    ) -> tuple[Float[np.ndarray, "T 2"], Float[np.ndarray, " T"]]:
        """Points, ``left_m`` to the left of the path, and headings at distances walked."""
        heading = self.heading_rad + (distance_m / self.radius_m if self.radius_m else 0 * distance_m)
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
        if self.radius_m:
            points = np.asarray(self.centre_m) - self.radius_m * left
        else:
            points = np.asarray(self.centre_m) + distance_m[:, None] * forward
        return points + np.asarray(left_m).reshape(-1, 1) * left, heading


@dataclass(frozen=True)
class FootTrack:
    """One foot over time: the position of its flat print, and its pitch and lift.

    Attributes:
        distance_m: along the path.
        pitch_rad: positive = heel up about the ball, negative = toes up about the heel.
        lift_m: extra height of the whole foot.
        amplitude: length of the current stride over the full stride, 0 = standing.
    """

    distance_m: Float[np.ndarray, " T"]
    pitch_rad: Float[np.ndarray, " T"]
    lift_m: Float[np.ndarray, " T"]
    amplitude: Float[np.ndarray, " T"]


def foot_track(clock: Float[np.ndarray, " T"], phase: float, stride_m: float, path: Path) -> FootTrack:
    """The foot whose strides begin ``phase`` (0 or 0.5) before the clock, counted in strides."""
    local = clock + phase
    stride = np.floor(local)
    within = local - stride

    def plant(n: np.ndarray) -> np.ndarray:
        return np.clip((n + _MIDDLE - phase) * stride_m, path.first_m, path.last_m)

    before, here, after = plant(stride - 1), plant(stride), plant(stride + 1)
    landed, coming = (here - before) / stride_m, (after - here) / stride_m
    swing = np.clip((within - STANCE) / (1 - STANCE), 0, 1)
    strike = -_HEEL_STRIKE_RAD * landed * (1 - _ease(within / 0.12))
    push = _TOE_OFF_RAD * coming * _ease((within - 0.36) / (STANCE - 0.36)) * (1 - _ease(swing / 0.55))
    reach = -_HEEL_STRIKE_RAD * coming * _ease((swing - 0.55) / 0.45)
    return FootTrack(
        distance_m=here + (after - here) * _ease(swing),
        pitch_rad=strike + push + reach,
        lift_m=0.045 * coming * np.sin(np.pi * swing) ** 2,
        amplitude=np.where(within < STANCE / 2, landed, coming),
    )


def pelvis_distance(clock: Float[np.ndarray, " T"], stride_m: float, path: Path) -> Float[np.ndarray, " T"]:
    """The pelvis's distance along the path: midway between the feet, smoothed over a third of a stride."""
    shifts = np.linspace(-0.4, 0.4, 17)
    weights = np.exp(-0.5 * (shifts / 0.17) ** 2)
    total = sum(
        w
        * (
            foot_track(clock + s, 0.0, stride_m, path).distance_m
            + foot_track(clock + s, 0.5, stride_m, path).distance_m
        )
        / 2
        for s, w in zip(shifts, weights)
    )
    return total / weights.sum()


def reach_knee(
    hip_m: Float[np.ndarray, "T 3"],
    ankle_m: Float[np.ndarray, "T 3"],
    thigh_m: float,
    shin_m: float,
    forward: Float[np.ndarray, "T 3"],
) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3"]]:
    """Knee positions and hinge axes (to the body's left) for hips and ankles; the knee bends ``forward``.

    Law of cosines; a target out of reach stretches the leg towards it. ``forward`` need not be a right angle off.
    """
    span = ankle_m - hip_m
    distance = np.linalg.norm(span, axis=1)
    along = span / distance[:, None]
    distance = np.minimum(distance, (thigh_m + shin_m) * 0.9999)
    cosine = np.clip((thigh_m**2 + distance**2 - shin_m**2) / (2 * thigh_m * distance), -1, 1)
    bend = forward - along * np.einsum("ij,ij->i", forward, along)[:, None]
    bend = bend / np.linalg.norm(bend, axis=1, keepdims=True)
    knee = hip_m + thigh_m * (cosine[:, None] * along + np.sqrt(1 - cosine**2)[:, None] * bend)
    # Down the leg × the knee's forward points to the walker's left: (0, 0, -1) × (1, 0, 0) = (0, -1, 0) is right, so
    # negated.
    return knee, -np.cross(along, bend)


def bone_frame(down: Float[np.ndarray, "... 3"], left: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3 3"]:
    """Rotations whose columns are: left made orthogonal, along the bone, and their cross product."""
    down = down / np.linalg.norm(down, axis=-1, keepdims=True)
    left = left - down * np.sum(left * down, axis=-1, keepdims=True)
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    return np.stack([left, down, np.cross(left, down)], axis=-1)


def _ease(x: np.ndarray) -> np.ndarray:
    """Smoothstep of x clamped to [0, 1]."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)
