# SPDX-License-Identifier: Apache-2.0
"""Pose prior: a relaxed standing body, and how far each joint usually bends from it.

Keypoints leave twist and the split along the spine unobserved (M04); these deviations decide there. They are wide where
keypoints measure (hips, shoulders, elbows, knees) and narrow where they do not (collars, spine, hands). Beyond the
limits of bones and ligaments (a knee forwards, a forearm turned twice) a second, steep pull begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES

if TYPE_CHECKING:
    from jaxtyping import Num

# Axis-angle of the relaxed pose from the T-pose for the left side, and deviations about x, y, z; radians. SMPL's axes:
# the arm points along x (x is its twist, elbows bend about y), the leg along y (y is its twist, hips and knees bend
# about x).
_MIDDLE = {"shoulder": (0.0, 0.0, -1.0), "elbow": (0.0, -0.4, 0.0), "hip": (-0.15, 0.0, 0.0), "knee": (0.3, 0.0, 0.0)}
_DEVIATION = {
    "hip": (0.9, 0.5, 0.5),
    "spine1": (0.3, 0.2, 0.2),
    "knee": (1.0, 0.25, 0.2),
    "spine2": (0.2, 0.2, 0.2),
    "ankle": (0.4, 0.3, 0.3),
    "spine3": (0.2, 0.2, 0.2),
    "foot": (0.15, 0.1, 0.1),
    "neck": (0.4, 0.4, 0.3),
    "collar": (0.15, 0.2, 0.2),
    "head": (0.4, 0.4, 0.3),
    "shoulder": (0.7, 0.9, 0.9),
    "elbow": (0.6, 1.1, 0.3),
    "wrist": (0.3, 0.3, 0.4),
    "hand": (0.1, 0.1, 0.1),
}

# Least and most bend from the relaxed pose about x, y, z for the left side, radians; ranges of motion of healthy
# adults, rounded outwards by about 10°. An elbow does not bend backwards nor a knee forwards, and a limb twists about
# itself only so far.
_LIMITS = {
    "hip": ((-2.3, 1.0), (-1.1, 1.1), (-1.1, 1.2)),
    "knee": ((-0.5, 2.4), (-0.8, 0.8), (-0.4, 0.4)),
    "ankle": ((-1.1, 0.9), (-0.9, 0.9), (-0.8, 0.8)),
    "shoulder": ((-1.9, 1.9), (-2.6, 2.2), (-1.2, 2.8)),
    "elbow": ((-1.7, 1.7), (-2.5, 0.6), (-0.6, 0.6)),
    "wrist": ((-0.9, 0.9), (-0.8, 0.8), (-1.5, 1.5)),
    "collar": ((-0.5, 0.5), (-0.7, 0.7), (-0.7, 0.8)),
    "neck": ((-1.1, 1.1), (-1.0, 1.0), (-0.9, 0.9)),
    "head": ((-1.0, 1.0), (-1.0, 1.0), (-0.8, 0.8)),
} | {f"spine{n}": ((-0.8, 1.1), (-0.6, 0.6), (-0.6, 0.6)) for n in (1, 2, 3)}
LIMIT_SIGMA_RAD = 0.1  # one deviation of the excess beyond a limit


@cache
def mean_pose() -> Num[np.ndarray, "24 3 3"]:
    """Local rotations of the relaxed pose, read-only; the right side mirrors the left, so y and z change sign."""
    axis_angle = np.zeros((24, 3))
    for j, name in enumerate(JOINT_NAMES):
        side, _, part = name.rpartition("_")
        axis_angle[j] = np.array(_MIDDLE.get(part, (0, 0, 0))) * (np.array([1, -1, -1]) if side == "right" else 1)
    turns = rotations.exp(axis_angle)
    turns.flags.writeable = False
    return turns


def precision() -> Num[np.ndarray, "24 3"]:
    """Inverse variances about each joint's axes; 0 for the pelvis, which may face anywhere."""
    deviations = np.array([_DEVIATION.get(name.rpartition("_")[2], (np.inf,) * 3) for name in JOINT_NAMES])
    return 1.0 / deviations**2


@cache
def limits() -> tuple[Num[np.ndarray, "24 3"], Num[np.ndarray, "24 3"]]:
    """Least and most bend about each joint's axes, read-only; infinite for the pelvis, hands and feet."""
    low, high = np.full((24, 3), -np.inf), np.full((24, 3), np.inf)
    for j, name in enumerate(JOINT_NAMES):
        side, _, part = name.rpartition("_")
        for axis, (least, most) in enumerate(_LIMITS.get(part, ())):
            mirrored = side == "right" and axis > 0
            low[j, axis], high[j, axis] = (-most, -least) if mirrored else (least, most)
    low.flags.writeable = high.flags.writeable = False
    return low, high


@dataclass(frozen=True)
class PosePrior:
    """Rotations around which joints vary, and how far; ``body_prior`` is the body's.

    Attributes:
        mean: relaxed rotations relative to the parents.
        precision: inverse variances of the bend from them about each joint's axes.
        low, high: least and most bend.
        axes: those axes as columns, where they are not the joint's own.
    """

    mean: Num[np.ndarray, "24 3 3"]
    precision: Num[np.ndarray, "24 3"]
    low: Num[np.ndarray, "24 3"]
    high: Num[np.ndarray, "24 3"]
    axes: Num[np.ndarray, "24 3 3"] | None = None

    def bend(self, local: Num[np.ndarray, "F 24 3 3"]) -> Num[np.ndarray, "F 24 3"]:
        """Bends from the relaxed pose to ``local`` about the joints' axes."""
        bent = rotations.log(np.swapaxes(self.mean, -1, -2) @ local)
        return bent if self.axes is None else np.einsum("jyx,fjy->fjx", self.axes, bent)

    def beyond_limits(self, bent: Num[np.ndarray, "F 24 3"]) -> Num[np.ndarray, "F 24 3"]:
        """How far bends are beyond the limits, with sign; 0 within."""
        return bent - np.clip(bent, self.low, self.high)

    def bend_derivative(self, bent: Num[np.ndarray, "F 24 3"]) -> Num[np.ndarray, "F 24 3 3"]:
        """Derivative of ``bend`` by a small turn about the joint's own axes."""
        if self.axes is None:
            return _inverse_right_jacobian(bent)
        return np.swapaxes(self.axes, -1, -2) @ _inverse_right_jacobian(np.einsum("jxy,fjy->fjx", self.axes, bent))


@cache
def body_prior() -> PosePrior:
    """The prior of the body's 24 joints."""
    return PosePrior(mean_pose(), precision(), *limits())


def _inverse_right_jacobian(bent: np.ndarray) -> np.ndarray:
    """(F, 24, 3, 3) inverse right Jacobian of SO(3) at axis-angles.

    I + [φ]×/2 + (1 − (θ/2) cot(θ/2)) / θ² [φ]×²; the last factor tends to 1/12 at 0.
    """
    cross = rotations.cross_matrix(bent)
    squared = np.einsum("...i,...i", bent, bent)
    small = squared < 1e-6
    safe = np.where(small, 1.0, squared)
    half = 0.5 * np.sqrt(safe)
    factor = np.where(small, 1 / 12 + squared / 720, (1 - half * np.cos(half) / np.sin(half)) / safe)
    return np.eye(3) + 0.5 * cross + factor[..., None, None] * (cross @ cross)
