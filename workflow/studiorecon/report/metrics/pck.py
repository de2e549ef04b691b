# SPDX-License-Identifier: Apache-2.0
"""PCK and detection rate of 2D keypoints against true ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

ALPHAS = (0.05, 0.1)
# The paper does not define the scale; the same 8 px of noise score 100, 96, 69 or 28 % by its choice (evaluation 1.2,
# U58).
SIDE = "longer side of the true person's box"
SMALLEST_SIDE_PX = 16.0
DETECTED_OKS = 0.3
# Object keypoint similarity with one constant for all points, as the scored joints need not be COCO's: k = 2 σ with σ
# 0.08, the mean of COCO's σ over its body points.
_OKS_K = 0.16


@dataclass(frozen=True)
class TruePerson:
    """One true person in one picture: pixels of points, which of them count, and the size of the person's box."""

    points: Float[np.ndarray, "K 2"]
    visible: Bool[np.ndarray, " K"]
    box_wh: tuple[float, float]


def keypoint_similarity(found: Float[np.ndarray, "K 2"], person: TruePerson) -> float:
    """Object keypoint similarity in [0, 1]: mean over visible points of exp(−d² / (2 s² k²)), s² the box's area.

    A missing point (NaN) has similarity 0. It is also 0 when no point of the person is visible or the box is empty.
    """
    area = person.box_wh[0] * person.box_wh[1]
    if not person.visible.any() or not area > 0:
        return 0.0
    squared = ((found[person.visible] - person.points[person.visible]) ** 2).sum(axis=-1)
    return float(
        np.where(
            np.isfinite(squared), np.exp(-np.where(np.isfinite(squared), squared, 0) / (2 * area * _OKS_K**2)), 0
        ).mean()
    )


def match_predictions(found: Sequence[Float[np.ndarray, "K 2"]], people: Sequence[TruePerson]) -> dict[int, int]:
    """{index of a true person: index of its prediction}, one to one, similarity at least 0.3, with the largest sum."""
    if not len(found) or not len(people):
        return {}
    table = np.array([[keypoint_similarity(points, person) for points in found] for person in people])
    admissible = table >= DETECTED_OKS
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(admissible, -table, 1.0))
    return {int(r): int(c) for r, c in zip(rows, columns) if admissible[r, c]}


def count_correct(found: Float[np.ndarray, "K 2"] | None, person: TruePerson, alpha: float) -> tuple[int, int] | None:
    """(right, counted) visible keypoints within ``alpha`` × the box's longer side; None below 16 pixels (V03).

    A missing or NaN prediction is wrong; for an undetected person (``found`` None) all are wrong.
    """
    side = max(person.box_wh)
    if not side >= SMALLEST_SIDE_PX:
        return None
    counted = int(person.visible.sum())
    if found is None:
        return 0, counted
    distance = np.linalg.norm(found[person.visible] - person.points[person.visible], axis=-1)
    # Comparisons with NaN are false, so a missing point counts as wrong.
    return int((distance <= alpha * side).sum()), counted


def score_keypoints(
    pictures: Sequence[tuple[Sequence[Float[np.ndarray, "K 2"]], Sequence[TruePerson]]],
) -> dict[str, Any]:
    """PCK@0.05, PCK@0.1 and detection rate over pictures of (predictions, true people); None when nothing counted.

    PCK pools keypoints; people whose box is under 16 pixels or who show no keypoint are skipped and counted.
    """
    right, counted = dict.fromkeys(ALPHAS, 0), 0
    detected = total = skipped = missing = 0
    for found, people in pictures:
        usable = [p for p in people if max(p.box_wh) >= SMALLEST_SIDE_PX and p.visible.any()]
        skipped += len(people) - len(usable)
        pairs = match_predictions(found, usable)
        detected, total = detected + len(pairs), total + len(usable)
        for index, person in enumerate(usable):
            points = found[pairs[index]] if index in pairs else None
            counted += int(person.visible.sum())
            missing += (
                int(person.visible.sum())
                if points is None
                else int((~np.isfinite(points[person.visible]).all(axis=-1)).sum())
            )
            for alpha in ALPHAS:
                hits = count_correct(points, person, alpha)
                assert hits is not None, "people who are too small were left out above"
                right[alpha] += hits[0]
    result: dict[str, Any] = {f"pck_{alpha:g}": right[alpha] / counted if counted else None for alpha in ALPHAS}
    return result | {
        "detection_rate": detected / total if total else None,
        "side": SIDE,
        "keypoints": counted,
        "missing": missing,
        "people": total,
        "skipped": skipped,
    }
