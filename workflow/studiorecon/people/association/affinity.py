# SPDX-License-Identifier: Apache-2.0
"""Affinity of two detections, or of two tracks, from their distance and the difference of their poses.

Paper, equation of the affinity and appendix: A = w_p exp(-d/σ_p) + w_θ exp(-θ/σ_θ). d in metres (A04, A05), θ the mean
angle over the body joints without the root (A06-A08, U27); a pair past its gate has no affinity, before any assignment
(U29, A03).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting

if TYPE_CHECKING:
    from jaxtyping import Float, Num


@dataclass(frozen=True)
class AssociationLimits:
    """Limits of grouping tracks into people.

    Attributes:
        pelvis_gate_m, pose_gate_rad: pelvises further apart are two people before any assignment (paper: 0.3, appendix;
            U28, U29); so are poses further apart than this mean angle where the pose alone decides (paper: not given).
        position_weight, pose_weight: of position and pose (paper: 0.9 and 0.1, appendix).
        sigma_m, sigma_rad: scale of the affinity in position, and in pose, mean joint angle without the root (paper:
            not given; U27); for a norm of 23 axis-angles that is a σ_θ of √23 times as much.
        undecided_margin: a track whose affinity to the next best person is nearer than this to that of its own is
            reported as undecided (A12).
        track_agreement: share of its keypoints that must agree with the triangulated person for a track to stay.
    """

    method: Literal["tracks", "star"] = setting(
        "tracks",
        "tracks = all views' whole tracks together; star = one frame, one reference view, Hungarian algorithm.",
        paper="star; U30, U31",
        paper_value="star",
    )
    affinity: Literal["both", "position", "pose"] = setting(
        "both",
        "Similarity of two detections: position, body pose, or both where a pose is known.",
        paper="both",
        paper_value="both",
    )
    position: Literal["rays", "pelvis", "scene"] = setting(
        "rays",
        "rays = distance between rays; pelvis = depth of the monocular body; scene = depth of the "
        "scene (needs networks for calibration and depth).",
        paper="pelvis lifted by the scene's depth, Eq. S1; U26, U28",
        paper_value="scene",
    )
    gate_m: float = setting(
        0.15,
        "Maximum distance between rays of one person.",
        unit="m",
        above=0,
        paper="0.3 between lifted pelvises; U28",
    )
    pose_distance: Literal["angle", "axis_angles"] = setting(
        "angle",
        "angle = mean angle between joint rotations; axis_angles = norm of the difference of pose parameters.",
        paper="‖θa − θb‖ of pose parameters, Eq. 1; U27",
        paper_value="axis_angles",
    )
    pelvis_gate_m: float = 0.3
    pose_gate_rad: float = 1.0
    position_weight: float = 0.9
    pose_weight: float = 0.1
    sigma_m: float = 0.3
    sigma_rad: float = 0.5
    undecided_margin: float = 0.05
    track_agreement: float = 0.5


def apply_gate(distance: Num[np.ndarray, " ..."], gate: float) -> Float[np.ndarray, " ..."]:
    """``distance`` where it is finite and below ``gate``, else NaN: pairs past the gate are no candidates (A02,
    A03)."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(distance) & (distance < gate), distance, np.nan)


def affinities(
    distance_m: Float[np.ndarray, " ..."], pose_rad: Float[np.ndarray, " ..."], gate_m: float, limits: AssociationLimits
) -> Float[np.ndarray, " ..."]:
    """Affinity in [0, 1] of pairs (any shape); exactly 0 for pairs that must not be matched (A02, A03, A13).

    With ``affinity: both`` the position must pass its gate; a pair with unknown poses is judged by its position alone,
    on the same scale. ``position`` and ``pose`` use one term, with its own gate (``gate_m``, ``limits.pose_gate_rad``).
    Position counts as 1 - d / gate but in the paper's star: the affinities of whole groups are summed, and a chance
    neighbour at the gate must add nothing (A05: "or cost -d instead of exp").
    """
    near, alike = apply_gate(distance_m, gate_m), apply_gate(pose_rad, np.inf)
    position = np.exp(-near / limits.sigma_m) if limits.method == "star" else 1 - near / gate_m
    pose = np.exp(-alike / limits.sigma_rad)
    if limits.affinity == "pose":
        return np.where(np.isfinite(apply_gate(pose_rad, limits.pose_gate_rad)), np.nan_to_num(pose), 0.0)
    if limits.affinity == "both":
        both = limits.position_weight * position + limits.pose_weight * pose
        position = np.where(np.isfinite(pose), both / (limits.position_weight + limits.pose_weight), position)
    return np.nan_to_num(position)


def window_distances(positions_m: Float[np.ndarray, "M T 3"]) -> Float[np.ndarray, "M M"]:
    """Distance of M tracks' positions (T, 3), NaN where unseen, averaged over the frames they share (A11); NaN where
    none.

    Averaging before the norm lets independent depth errors cancel; averaging distances would keep them.
    """
    count = len(positions_m)
    distance = np.full((count, count), np.nan)
    for i, j in zip(*np.triu_indices(count, 1)):
        offsets = positions_m[i] - positions_m[j]
        offsets = offsets[np.isfinite(offsets).all(-1)]
        if len(offsets):
            distance[i, j] = distance[j, i] = np.linalg.norm(offsets.mean(0))
    return distance
