# SPDX-License-Identifier: Apache-2.0
"""Affinity of every two tracks, from their distance and the difference of their poses over all frames they share.

Paper, equation of the affinity and appendix: A = w_p exp(-d/σ_p) + w_θ exp(-θ/σ_θ). d in metres (A04, A05), θ the mean
angle over the body joints without the root (A06-A08, U27); a pair past its gate has no affinity, before any assignment
(U29, A03). d is between ``rays`` of shared keypoints, or between pelvises at the depth of the ``scene``
(``people.lift``, U26). θ is between monocular bodies, else between limbs of the detector's guess.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.geometry.lifting import lift_joint
from studiorecon.keypoints.correspondence import TrackGraph, track_graph
from studiorecon.people.association.postures import (
    joint_differences_rad,
    limb_differences_rad,
    limb_directions,
    parameter_differences_rad,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class AssociationLimits:
    """Limits of grouping tracks into people.

    Attributes:
        pelvis_gate_m: pelvises further apart are two people before any assignment (paper: 0.3, appendix; U28, U29).
        position_weight, pose_weight: of position and pose (paper: 0.9 and 0.1, appendix).
        sigma_m, sigma_rad: scale of the affinity in position, and in pose, mean joint angle without the root (paper:
            not given; U27); for a norm of 23 axis-angles that is a σ_θ of √23 times as much.
        undecided_margin: a track whose affinity to the next best person is nearer than this to that of its own is
            reported as undecided (A12).
    """

    method: Literal["tracks", "star"] = setting(
        "tracks",
        "tracks = all views' whole tracks together; star = one frame, one reference view, Hungarian algorithm.",
        paper="star; U30, U31",
        paper_value="star",
    )
    affinity: Literal["both", "position"] = setting(
        "both",
        "Similarity of two detections: position alone, or with body pose where one is known.",
        paper="both",
        paper_value="both",
    )
    position: Literal["rays", "scene"] = setting(
        "rays",
        "rays = distance between rays; scene = between pelvises at the scene's depth (needs networks for calibration "
        "and depth).",
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
    position_weight: float = 0.9
    pose_weight: float = 0.1
    sigma_m: float = 0.3
    sigma_rad: float = 0.5
    undecided_margin: float = 0.05

    @property
    def apart_m(self) -> float:
        """Distance from which two tracks are two people."""
        return self.gate_m if self.position == "rays" else self.pelvis_gate_m


@dataclass(frozen=True)
class TrackPairs:
    """Affinities of M tracks.

    Attributes:
        graph: the tracks, the distances of their rays, and the numbers of frames in which both are seen.
        pose_rad: angle between postures, NaN unknown.
        affinity: 0 to 1, 0 = no link; NaN where the two share nothing to compare.
        forbidden: these two are not one person.
    """

    graph: TrackGraph
    pose_rad: Float[np.ndarray, "M M"]
    affinity: Float[np.ndarray, "M M"]
    forbidden: Bool[np.ndarray, "M M"]

    @property
    def nodes(self) -> list[tuple[int, int]]:
        """(view, track) of each of the M."""
        return list(zip(self.graph.view.tolist(), self.graph.track.tolist()))

    def margins(self, groups: Sequence[Sequence[tuple[int, int]]]) -> dict[tuple[int, int], float]:
        """Mean affinity of every grouped (view, track) to its own group less that to the best other group (A12)."""
        # The last: nobody.
        own = np.array([[node in group for group in [*groups, ()]] for node in self.nodes]).reshape(-1, len(groups) + 1)
        # Mean over the comparable tracks, weighted by their length; 0 without any.
        weights = np.isfinite(self.affinity) * np.diagonal(self.graph.moments)
        near = (weights * np.nan_to_num(self.affinity)) @ own / np.maximum(weights @ own, 1e-12)
        margin = np.where(own, near, 0.0).sum(1) - np.where(own, 0.0, near).max(1)
        return {self.nodes[n]: float(margin[n]) for n in np.flatnonzero(own.any(1))}


def track_pairs(
    detections: Sequence[Detections], stable: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> TrackPairs:
    """Affinities of all tracks over all frames they share; ``stable``: their stable keypoints."""
    graph = track_graph(stable, cameras)
    distance_m, pose_rad = graph.distance_m, np.full(graph.distance_m.shape, np.nan)
    if limits.position == "scene":
        distance_m = _over_shared(graph, detections, [_pelvises_m(d, c) for d, c in zip(detections, cameras)], _gap_m)
    if limits.affinity == "both":
        pose_rad = _over_shared(graph, detections, *_postures(detections, cameras, limits))
    same_view = graph.view[:, None] == graph.view
    affinity = np.where(same_view, np.nan, affinities(distance_m, pose_rad, limits))
    return TrackPairs(graph, pose_rad, affinity, np.where(same_view, graph.moments > 0, affinity == 0))


def affinities(
    distance_m: Float[np.ndarray, " ..."], pose_rad: Float[np.ndarray, " ..."], limits: AssociationLimits
) -> Float[np.ndarray, " ..."]:
    """Affinity in [0, 1] of pairs; 0 past the gate, NaN at an unknown distance (A02, A03, A13).

    A pair with unknown poses is judged by its position alone, on the same scale. Position counts as 1 - d / gate but in
    the paper's star: the affinities of whole groups are summed, and a chance neighbour at the gate must add nothing
    (A05: "or cost -d instead of exp").
    """
    with np.errstate(invalid="ignore"):
        star = limits.method == "star"
        position = np.exp(-distance_m / limits.sigma_m) if star else 1 - distance_m / limits.apart_m
        both = limits.position_weight * position + limits.pose_weight * np.exp(-pose_rad / limits.sigma_rad)
        affinity = np.where(np.isnan(pose_rad), position, both)
        return np.where(np.isnan(distance_m), np.nan, np.where(distance_m < limits.apart_m, affinity, 0.0))


def _over_shared(
    graph: TrackGraph,
    detections: Sequence[Detections],
    values: Sequence[np.ndarray],
    compare: Callable[[np.ndarray, np.ndarray], float],
) -> Float[np.ndarray, "M M"]:
    """``compare`` of two tracks' ``values`` (one per detection of each camera) over the frames they share; NaN where
    nothing is known."""
    out = np.full(graph.distance_m.shape, np.nan)
    known = [np.isfinite(v).all(tuple(range(1, v.ndim))) for v in values]
    rows = [np.flatnonzero((detections[v].track == t) & known[v]) for v, t in zip(graph.view, graph.track)]
    some = np.array([len(row) > 0 for row in rows], dtype=bool)
    shared = some[:, None] & some & (graph.view[:, None] != graph.view) & (graph.moments > 0)
    for a, b in zip(*np.nonzero(np.triu(shared, 1))):
        one, other = graph.view[a], graph.view[b]
        _, i, j = np.intersect1d(detections[one].frame[rows[a]], detections[other].frame[rows[b]], return_indices=True)
        if len(i):
            out[a, b] = out[b, a] = compare(values[one][rows[a][i]], values[other][rows[b][j]])
    return out


def _pelvises_m(found: Detections, camera: Camera) -> Float[np.ndarray, "D 3"]:
    """Pelvises in the world, NaN unknown. The depth is the joint's own: no offset into the body is added (C11)."""
    if found.pelvis is None:
        return np.full((len(found.frame), 3), np.nan)
    return lift_joint(found.pelvis[:, 2], found.pelvis[:, :2], camera, 0.0)


def _gap_m(first_m: np.ndarray, second_m: np.ndarray) -> float:
    """Length of the mean difference: the mean before the length lets independent errors of depth cancel (A11)."""
    return float(np.linalg.norm((first_m - second_m).mean(0)))


def _postures(
    detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> tuple[list[np.ndarray], Callable[[np.ndarray, np.ndarray], float]]:
    """Postures of all detections, those of monocular bodies if there are any, and the median angle between two
    tracks'."""
    if all(d.body_pose is None for d in detections):
        differences, seen = limb_differences_rad, [limb_directions(d, c) for d, c in zip(detections, cameras)]
    else:
        differences = joint_differences_rad if limits.pose_distance == "angle" else parameter_differences_rad
        seen = [np.full((len(d.frame), 23, 3), np.nan) if d.body_pose is None else d.body_pose for d in detections]
    return seen, lambda first, second: float(np.median(differences(first, second)))
