# SPDX-License-Identifier: Apache-2.0
"""Lengths of a person's bones: the paper's s*, and the check of measured against fitted limbs."""

from __future__ import annotations

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.geometry.scale import scene_scale
from studiorecon.people.fitting.points import Points
from studiorecon.progress import say
from studiorecon.scene.people import Person


def _pairs(*limbs: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    """Ends of ``limbs`` on both sides, by their names as keypoints on the surface and as joints inside."""
    return tuple((f"{s}_{a}{k}", f"{s}_{b}{k}") for k in ("", "_joint") for s in ("left", "right") for a, b in limbs)


_LIMBS = _pairs(("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"))
# Between neighbouring joints: their length is constant in any pose (Eq. 3, "reliable bone pairs").
_BONES = (*_LIMBS, *_pairs(("elbow", "wrist")))

# A toddler and the tallest person on record, over a mean adult.
_SIZES = 0.4, 1.6


def body_scale(person: str, points: Points, body: BodyModel) -> float:
    """s* of one person: triangulated over template bones (paper, Eq. 3); 1, with a message, where too few bones are
    seen.

    Raises UserError for an impossible size.
    """
    known = [name for name in points.names if name in body.keypoint_names]
    rows = [points.names.index(name) for name in known]
    bones = [(known.index(a), known.index(b)) for a, b in _BONES if a in known and b in known]
    template_m = body.keypoints(known, np.zeros((1, 72)), np.zeros(body.shapes), np.zeros((1, 3)))
    seen_m, sigma_m = points.points_m[None, :, rows], points.sigma_m[None, :, rows]
    found = scene_scale(
        seen_m, template_m, np.array(bones, dtype=np.int64).reshape(-1, 2), np.isfinite(seen_m).all(-1), sigma_m
    )
    if not found.determined:
        say(f"{person}: the body model keeps its own size, because {found.reason}")
        return 1.0
    if not _SIZES[0] <= found.world_per_metre <= _SIZES[1]:
        raise UserError(
            f"person {person}: the bones are {found.world_per_metre:.2f} times as long as a mean adult's, which no "
            "person's are; check that the calibration is in metres"
        )
    say(
        f"{person}: bones are {found.world_per_metre:.3f} times as long as the body model's (s*, single bones "
        f"scatter by {100 * found.spread:.0f} %)"
    )
    return found.world_per_metre


def limb_ratio(points: Points, fitted: Person, body: BodyModel) -> float:
    """Median of measured over fitted limb lengths, long bones only (S04, S05); NaN when none was measured."""
    at = {n: k for k, n in enumerate(points.names)}
    model = body.keypoints(points.names, fitted.poses, fitted.betas, fitted.trans)
    ratios = []
    for a, b in _LIMBS:
        if a in at and b in at:
            measured = np.linalg.norm(points.points_m[:, at[a]] - points.points_m[:, at[b]], axis=-1)
            ratios.append(measured / np.linalg.norm(model[:, at[a]] - model[:, at[b]], axis=-1))
    found = np.concatenate(ratios)[np.isfinite(np.concatenate(ratios))] if ratios else np.zeros(0)
    return float(np.median(found)) if len(found) else float("nan")
