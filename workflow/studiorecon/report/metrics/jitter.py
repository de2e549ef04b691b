# SPDX-License-Identifier: Apache-2.0
"""Jitter of bodies: second differences of positions, and of rotations on SO(3), within runs of measured frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def runs_of_three(valid: Bool[np.ndarray, " T"]) -> Bool[np.ndarray, " T-2"]:
    """Frames t whose neighbours t - 1 and t + 1 were measured too (V04: a gap is no motion)."""
    return valid[:-2] & valid[1:-1] & valid[2:] if len(valid) >= 3 else np.zeros(0, bool)


def translation_jitter(
    positions_m: Float[np.ndarray, "T ... 3"], valid: Bool[np.ndarray, " T"]
) -> Float[np.ndarray, "n ..."]:
    """Mm/frame²: ‖x(t+1) − 2 x(t) + x(t−1)‖ of positions in metres at the n frames inside measured runs."""
    inside = runs_of_three(valid)
    before, now, after = positions_m[:-2][inside], positions_m[1:-1][inside], positions_m[2:][inside]
    return 1000 * np.linalg.norm(after - 2 * now + before, axis=-1)


def rotation_jitter(
    world_or_local: Float[np.ndarray, "T ... 3 3"], valid: Bool[np.ndarray, " T"]
) -> Float[np.ndarray, "n ..."]:
    """°/frame²: ‖log(R(t)ᵀ R(t+1)) − log(R(t−1)ᵀ R(t))‖ of rotations at the n frames inside measured runs.

    Differences of axis-angles would jump by a full turn when a joint passes 180° (V05, U43).
    """
    inside = runs_of_three(valid)
    before, now, after = world_or_local[:-2][inside], world_or_local[1:-1][inside], world_or_local[2:][inside]
    first = rotations.log(np.swapaxes(before, -1, -2) @ now)
    second = rotations.log(np.swapaxes(now, -1, -2) @ after)
    return np.degrees(np.linalg.norm(second - first, axis=-1))


def jitter(
    joints_m: Float[np.ndarray, "T 24 3"], poses: Float[np.ndarray, "T 72"], valid: Bool[np.ndarray, " T"], fps: float
) -> dict[str, Any]:
    """Mean jitter of one person: root and joints in mm/f² and m/s², pose in °/f² and °/s², and frames used.

    Frames with a non-finite value count as not measured, and ``not_finite`` is their number. All values are None unless
    three consecutive frames were measured.
    """
    finite = np.isfinite(joints_m).all(axis=(1, 2)) & np.isfinite(poses).all(axis=1)
    use = valid & finite
    moved = translation_jitter(np.where(use[:, None, None], joints_m, 0.0), use)
    turned = rotation_jitter(rotations.exp(np.where(use[:, None], poses, 0.0).reshape(-1, 24, 3)), use)
    used = len(moved)
    root, joints, pose = (float(v.mean()) if used else None for v in (moved[:, 0], moved, turned))
    return {
        "root_mm_f2": root,
        "joints_mm_f2": joints,
        "pose_deg_f2": pose,
        # Per second, so that captures of different rates can be compared.
        "root_m_s2": None if root is None else root / 1000 * fps**2,
        "joints_m_s2": None if joints is None else joints / 1000 * fps**2,
        "pose_deg_s2": None if pose is None else pose * fps**2,
        "used": used,
        "skipped": max(len(valid) - 2, 0) - used,
        "not_finite": int((valid & ~finite).sum()),
    }
