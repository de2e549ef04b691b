# SPDX-License-Identifier: Apache-2.0
"""Joint errors of the fitted bodies against true ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# A fitted person further than this from every true one is a false positive and not a bad fit.
_SAME_PERSON_M = 0.5


def align_by_similarity(points: Float[np.ndarray, "J 3"], onto: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """``points`` after the similarity that brings them closest to ``onto``, without mirroring (R19)."""
    mean, target = points.mean(axis=0), onto.mean(axis=0)
    centred, wanted = points - mean, onto - target
    left, singular, right = np.linalg.svd(wanted.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    spread = float((centred**2).sum())
    scale = float((singular * signs).sum()) / spread if spread > 0 else 1.0
    return target + scale * centred @ ((left * signs) @ right).T


def joint_errors_mm(fitted: Float[np.ndarray, "T 24 3"], true: Float[np.ndarray, "T 24 3"]) -> dict[str, float]:
    """Mean joint errors in millimetres: W-MPJPE (world), MPJPE (relative to the pelvis), PA-MPJPE (after a
    similarity)."""
    at_pelvis = (fitted - fitted[:, :1]) - (true - true[:, :1])
    aligned = np.stack([align_by_similarity(f, t) for f, t in zip(fitted, true)])
    errors = {"mpjpe_world_mm": fitted - true, "mpjpe_pelvis_mm": at_pelvis, "mpjpe_similarity_mm": aligned - true}
    return {name: float(1000 * np.linalg.norm(error, axis=-1).mean()) for name, error in errors.items()}


def size_error_percent(fitted: Float[np.ndarray, "T 24 3"], true: Float[np.ndarray, "T 24 3"]) -> float | None:
    """Median ratio of the joints' spread about their mean, as an error in percent, positive when too large."""
    spread = [np.linalg.norm(joints - joints.mean(axis=1, keepdims=True), axis=(1, 2)) for joints in (fitted, true)]
    usable = spread[1] > 0
    return 100 * float(np.median(spread[0][usable] / spread[1][usable]) - 1) if usable.any() else None


def inside_sigma_share(
    fitted: Float[np.ndarray, "T 24 3"], true: Float[np.ndarray, "T 24 3"], sigma_m: Float[np.ndarray, "T 24"]
) -> float | None:
    """Share of joints whose error is inside the 95 % ball of its predicted standard deviation; 0.95 is ideal.

    ``sigma_m`` is per axis, so the ball's radius is √χ²₃(0.95) σ = 2.795 σ. Unknown deviations (inf) are left out.
    """
    known = np.isfinite(sigma_m) & (sigma_m > 0)
    if not known.any():
        return None
    radius = np.sqrt(scipy.special.chdtri(3, 0.05)) * sigma_m[known]
    return float((np.linalg.norm((fitted - true)[known], axis=-1) <= radius).mean())


def match_people(
    fitted: Mapping[str, tuple[Float[np.ndarray, "T 24 3"], Bool[np.ndarray, " T"]]],
    true: Mapping[str, Float[np.ndarray, "T 24 3"]],
) -> dict[str, str]:
    """fitted name → true name, by the smallest mean joint distance over valid frames, at most 0.5 m."""
    if not fitted or not true:
        return {}
    fitted_names, true_names = list(fitted), list(true)
    distance = np.full((len(fitted_names), len(true_names)), np.inf)
    for row, name in enumerate(fitted_names):
        joints, valid = fitted[name]
        for column, other in enumerate(true_names):
            use = _comparable(joints, valid, true[other])
            if len(use):
                distance[row, column] = np.linalg.norm(joints[use] - true[other][use], axis=-1).mean()
    # Pairs are gated before the assignment, so that a false positive cannot take a true person from the right fit
    # (A03).
    admissible = distance <= _SAME_PERSON_M
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(admissible, distance, 1e6))
    return {fitted_names[r]: true_names[c] for r, c in zip(rows, columns) if admissible[r, c]}


def compare_bodies(
    fitted: Mapping[str, tuple[Float[np.ndarray, "T 24 3"], Bool[np.ndarray, " T"]]],
    true: Mapping[str, Float[np.ndarray, "T 24 3"]],
    sigma_m: Mapping[str, Float[np.ndarray, "T 24"]] | None = None,
) -> dict[str, Any]:
    """Joint errors per matched person and their mean, size error, calibration of sigma, missed and false people.

    Frames with a non-finite joint count as not measured; ``not_finite`` is their number.
    """
    pairs = match_people(fitted, true)
    people = {}
    for name, other in pairs.items():
        joints, valid = fitted[name]
        use = _comparable(joints, valid, true[other])
        entry: dict[str, Any] = {
            "true_person": other,
            "frames": len(use),
            **joint_errors_mm(joints[use], true[other][use]),
        }
        entry["not_finite"] = int(valid[: len(true[other])].sum()) - len(use)
        entry["size_error_percent"] = size_error_percent(joints[use], true[other][use])
        if sigma_m is not None:
            entry["inside_sigma_share"] = inside_sigma_share(joints[use], true[other][use], sigma_m[name][use])
        people[name] = entry
    names = ("mpjpe_world_mm", "mpjpe_pelvis_mm", "mpjpe_similarity_mm")
    means = {n: float(np.mean([p[n] for p in people.values()])) if people else None for n in names}
    missed, invented = sorted(set(true) - set(pairs.values())), sorted(set(fitted) - set(pairs))
    reason = None if people else "no fitted person is within 0.5 m of a true one"
    return {**means, "people": people, "missed": missed, "invented": invented, "reason": reason}


def _comparable(fitted: np.ndarray, valid: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Indices of the frames that were measured, exist in both, and hold only finite joints."""
    frames = min(len(fitted), len(true))
    finite = np.isfinite(fitted[:frames]).all(axis=(1, 2)) & np.isfinite(true[:frames]).all(axis=(1, 2))
    return np.flatnonzero(valid[:frames] & finite)
