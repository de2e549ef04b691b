# SPDX-License-Identifier: Apache-2.0
"""Joint errors of the fitted bodies against true ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

# A fitted person further than this from every true one is nobody: a ghost, not a bad fit.
_SAME_PERSON_M = 0.5


def similarity_aligned(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """``points`` (J, 3) under the similarity that brings them closest to ``onto``, never mirrored (numerics R19)."""
    mean, target = points.mean(axis=0), onto.mean(axis=0)
    centred, wanted = points - mean, onto - target
    left, singular, right = np.linalg.svd(wanted.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    spread = float((centred**2).sum())
    scale = float((singular * signs).sum()) / spread if spread > 0 else 1.0
    return target + scale * centred @ ((left * signs) @ right).T


def joint_errors_mm(fitted: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Mean joint errors in millimetres of (T, 24, 3) against (T, 24, 3): in the world, pelvis on pelvis, and after a similarity."""
    at_pelvis = (fitted - fitted[:, :1]) - (true - true[:, :1])
    aligned = np.stack([similarity_aligned(f, t) for f, t in zip(fitted, true)])
    errors = {"mpjpe_world_mm": fitted - true, "mpjpe_pelvis_mm": at_pelvis, "mpjpe_similarity_mm": aligned - true}
    return {name: float(1000 * np.linalg.norm(error, axis=-1).mean()) for name, error in errors.items()}


def match(fitted: Mapping[str, tuple[np.ndarray, np.ndarray]], true: Mapping[str, np.ndarray]) -> dict[str, str]:
    """fitted name → true name, by the smallest mean joint distance over measured frames; pairs more than 0.5 m apart are dropped.

    ``fitted`` holds joints (T, 24, 3) and valid (T,).
    """
    if not fitted or not true:
        return {}
    fitted_names, true_names = list(fitted), list(true)
    distance = np.full((len(fitted_names), len(true_names)), np.inf)
    for row, name in enumerate(fitted_names):
        joints, valid = fitted[name]
        for column, other in enumerate(true_names):
            frames = min(len(joints), len(true[other]))
            use = np.flatnonzero(valid[:frames])
            if len(use):
                distance[row, column] = np.linalg.norm(joints[use] - true[other][use], axis=-1).mean()
    # Gate before the assignment: a pair that is nobody must not take a true person away from its own fit (numerics A03).
    admissible = distance <= _SAME_PERSON_M
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(admissible, distance, 1e6))
    return {fitted_names[r]: true_names[c] for r, c in zip(rows, columns) if admissible[r, c]}


def compare_bodies(fitted: Mapping[str, tuple[np.ndarray, np.ndarray]], true: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Joint errors per matched person and their mean, and who was missed or invented."""
    pairs = match(fitted, true)
    people = {}
    for name, other in pairs.items():
        joints, valid = fitted[name]
        use = np.flatnonzero(valid[: len(true[other])])
        people[name] = {"true_person": other, "frames": len(use), **joint_errors_mm(joints[use], true[other][use])}
    names = ("mpjpe_world_mm", "mpjpe_pelvis_mm", "mpjpe_similarity_mm")
    means = {n: float(np.mean([p[n] for p in people.values()])) if people else None for n in names}
    missed, invented = sorted(set(true) - set(pairs.values())), sorted(set(fitted) - set(pairs))
    reason = None if people else "no fitted person lies within 0.5 m of a true one"
    return {**means, "people": people, "missed": missed, "invented": invented, "reason": reason}
