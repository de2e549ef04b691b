# SPDX-License-Identifier: Apache-2.0
"""Affinity of every two tracks, from their distance and the difference of their poses over all frames they share.

Paper, equation of the affinity and appendix: A = w_p exp(-d/σ_p) + w_θ exp(-θ/σ_θ). d in metres (A04, A05), θ the mean
angle over the body joints without the root (A06-A08, U27); a pair past its gate has no affinity, before any assignment
(U29, A03). d is between ``rays`` of shared keypoints, or between pelvises where there are too few of them; or always
between pelvises, at the depth of the monocular body (``pelvis``, U26) or of the scene (``scene``, ``people.lift``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry.lifting import lift_joint
from studiorecon.keypoints.correspondence import TrackGraph, track_graph
from studiorecon.people.association.postures import posture_differences_rad, postures
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


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


def require_measured(detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits) -> None:
    """Raise UserError when the settings need data that no detection has."""
    if limits.affinity == "pose":
        if not any(np.isfinite(p).any() for d, c in zip(detections, cameras) for p in postures(d, c)):
            raise UserError(
                "people.association.affinity is pose, but no detection has a body pose (recorded 2D keypoints do not): "
                "set it to both or position, or use the detector"
            )
    elif limits.position != "rays" and not any(_has_pelvis(d) for d in detections):
        raise UserError(
            "people.association.position is scene, but the scene's depth is unknown at every pelvis; set it to rays"
            if limits.position == "scene"
            else "people.association.position is pelvis, but no detection has the depth of its pelvis (recorded 2D "
            "keypoints do not): set it to rays, or use a detector that estimates bodies"
        )


def track_pairs(
    detections: Sequence[Detections], stable: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> TrackPairs:
    """Affinities of all tracks over all frames they share; ``stable``: their stable keypoints."""
    graph = track_graph(stable, cameras)
    by_pelvis = limits.position != "rays"
    shares = np.full(graph.distance_m.shape, np.nan) if by_pelvis else graph.distance_m / limits.gate_m
    if any(_has_pelvis(d) for d in detections):
        lifted = _pelvis_distances_m(graph, detections, cameras) / limits.pelvis_gate_m
        shares = np.where(np.isnan(shares), lifted, shares)
    pose = np.full(shares.shape, np.nan)
    if limits.affinity != "position":
        pose = _pose_differences_rad(graph, detections, cameras, limits)
    same_view = graph.view[:, None] == graph.view
    affinity = np.where(same_view, np.nan, affinities(shares, pose, limits))
    return TrackPairs(graph, pose, affinity, np.where(same_view, graph.moments > 0, affinity == 0))


def affinities(
    distance: Float[np.ndarray, " ..."], pose_rad: Float[np.ndarray, " ..."], limits: AssociationLimits
) -> Float[np.ndarray, " ..."]:
    """Affinity in [0, 1] of pairs at a ``distance`` in gates; 0 past the gate, NaN where unknown (A02, A03, A13).

    With ``affinity: both`` a pair with unknown poses is judged by its position alone, on the same scale. Position
    counts as 1 - d / gate but in the paper's star: the affinities of whole groups are summed, and a chance neighbour at
    the gate must add nothing (A05: "or cost -d instead of exp").
    """
    with np.errstate(invalid="ignore"):
        gate_m = limits.gate_m if limits.position == "rays" else limits.pelvis_gate_m
        position = np.exp(-distance * gate_m / limits.sigma_m) if limits.method == "star" else 1 - distance
        pose = np.exp(-pose_rad / limits.sigma_rad)
        if limits.affinity == "pose":
            distance, position = pose_rad / limits.pose_gate_rad, pose
        elif limits.affinity == "both":
            both = limits.position_weight * position + limits.pose_weight * pose
            position = np.where(np.isnan(pose), position, both / (limits.position_weight + limits.pose_weight))
        return np.where(np.isnan(distance), np.nan, np.where(distance < 1, position, 0.0))


def _has_pelvis(found: Detections) -> bool:
    return found.pelvis is not None and bool(np.isfinite(found.pelvis).all(1).any())


def _pelvis_distances_m(graph: TrackGraph, detections: Sequence[Detections], cameras: Sequence[Camera]) -> np.ndarray:
    """(M, M) length of the mean difference of two tracks' pelvises over the frames they share; NaN where none.

    The mean before the length lets independent errors of depth cancel (A11).
    """
    last = max((int(d.frame.max()) for d in detections if len(d.frame)), default=-1)
    places = np.full((len(graph.view), last + 1, 3), np.nan)
    for own, v, t in zip(places, graph.view, graph.track):
        found = detections[v].only(detections[v].track == t)
        if found.pelvis is not None:
            # The depth is the joint's own: no offset into the body is added (C11).
            own[found.frame] = lift_joint(found.pelvis[:, 2], found.pelvis[:, :2], cameras[v], 0.0)
    known = np.isfinite(places).all(-1)
    total = np.einsum("itc,jt->ijc", np.where(known[..., None], places, 0.0), known)
    shared = known.astype(float) @ known.T
    length = np.linalg.norm(total - total.swapaxes(0, 1), axis=-1)
    return np.where(shared > 0, length / np.maximum(shared, 1), np.nan)


def _pose_differences_rad(
    graph: TrackGraph, detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> np.ndarray:
    """(M, M) median over shared frames of the angle between two tracks' postures; NaN where none is known."""
    out = np.full(graph.distance_m.shape, np.nan)
    seen = [postures(d, c) for d, c in zip(detections, cameras)]
    known = np.array([any(np.isfinite(p).any() for p in own) for own in seen], dtype=bool)[graph.view]
    rows = [np.flatnonzero(detections[v].track == t) for v, t in zip(graph.view, graph.track)]
    comparable = (graph.view[:, None] != graph.view) & (graph.moments > 0) & known & known[:, None]
    for a, b in zip(*np.nonzero(np.triu(comparable, 1))):
        one, other = graph.view[a], graph.view[b]
        _, i, j = np.intersect1d(detections[one].frame[rows[a]], detections[other].frame[rows[b]], return_indices=True)
        first, second = (
            (seen[v][0][which], seen[v][1][which]) for v, which in ((one, rows[a][i]), (other, rows[b][j]))
        )
        apart = posture_differences_rad(first, second, limits.pose_distance)
        if np.isfinite(apart).any():
            out[a, b] = out[b, a] = np.median(apart[np.isfinite(apart)])
    return out
