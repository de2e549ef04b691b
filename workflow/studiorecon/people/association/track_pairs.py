# SPDX-License-Identifier: Apache-2.0
"""Distance and difference in pose of every two tracks that may be one person.

Three sources of position. ``rays``: the distance between the rays of shared keypoints; needs no depth. Pairs with too
few shared keypoints use depth-lifted pelvises instead, if the detections have them. ``pelvis``: the pelvis joint of the
monocular body at its own depth (U26), averaged over the frames that two tracks share (A11). ``scene``: the same joint
at the scene's depth, the paper's, computed by ``people.lift``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.lifting import lift_joint
from studiorecon.keypoints.correspondence import TrackGraph, track_graph
from studiorecon.people.association.affinity import AssociationLimits, affinities, window_distances
from studiorecon.people.association.postures import Postures, posture_differences_rad
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class TrackPairs:
    """Pairwise affinities of M tracks.

    Attributes:
        view, track: (M,) camera number and track id.
        affinity: (M, M) 0..1, 0 = no link; measured: (M, M) bool, False where the two share nothing to compare.
        forbidden: (M, M) bool: these two are not one person. moments: number of frames in which both are seen.
        distance_m, pose_rad: (M, M) distance of rays and angle of postures, NaN unknown.
    """

    view: Integer[np.ndarray, " M"]
    track: Integer[np.ndarray, " M"]
    measured: Bool[np.ndarray, "M M"]
    affinity: Float[np.ndarray, "M M"]
    forbidden: Bool[np.ndarray, "M M"]
    moments: Integer[np.ndarray, "M M"]
    distance_m: Float[np.ndarray, "M M"]
    pose_rad: Float[np.ndarray, "M M"]

    @property
    def detections(self) -> Integer[np.ndarray, " M"]:
        """Number of detections of each track."""
        return np.diagonal(self.moments)

    @property
    def nodes(self) -> list[tuple[int, int]]:
        """(view, track) of each of the M."""
        return list(zip(self.view.tolist(), self.track.tolist()))


def require_measured(detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits) -> None:
    """Raise UserError when the settings need data that no detection has."""
    if limits.affinity == "pose":
        if not any(Postures.of(d, c, limits).known for d, c in zip(detections, cameras)):
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
    gate_m = limits.pelvis_gate_m if by_pelvis else limits.gate_m
    shares = np.full(graph.distance_m.shape, np.nan) if by_pelvis else graph.distance_m / limits.gate_m
    if any(_has_pelvis(d) for d in detections):
        lifted = _pelvis_distances(graph, detections, cameras) / limits.pelvis_gate_m
        shares = np.where(np.isnan(shares), lifted, shares)
    pose = np.full(shares.shape, np.nan)
    if limits.affinity != "position":
        pose = _pose_differences(graph, detections, cameras, limits)
    judged = pose / limits.pose_gate_rad if limits.affinity == "pose" else shares
    forbidden = ~np.isnan(judged) & ~(np.nan_to_num(judged, nan=0.0) < 1)
    same_view = graph.view[:, None] == graph.view[None]
    return TrackPairs(
        graph.view,
        graph.track,
        ~np.isnan(judged) & ~same_view,
        np.where(same_view, 0.0, affinities(shares * gate_m, pose, gate_m, limits)),
        forbidden | (same_view & (graph.moments > 0)),
        graph.moments,
        graph.distance_m,
        pose,
    )


def node_margins(pairs: TrackPairs, groups: Sequence[Sequence[int]]) -> Float[np.ndarray, " M"]:
    """A node's mean affinity to its own group less that to the best other group (A12); NaN for nodes in no group."""
    own = np.zeros((len(pairs.view), len(groups) + 1), dtype=bool)  # the last: nobody
    for g, group in enumerate(groups):
        own[list(group), g] = True
    # Mean over the comparable tracks, weighted by their length; 0 without any.
    weights = pairs.measured * pairs.detections
    near = (weights * pairs.affinity) @ own / np.maximum(weights @ own, 1e-12)
    margin = np.where(own, near, 0.0).sum(1) - np.where(own, 0.0, near).max(1)
    return np.where(own.any(1), margin, np.nan)


def _has_pelvis(found: Detections) -> bool:
    return found.pelvis is not None and bool(np.isfinite(found.pelvis).all(1).any())


def _pelvis_distances(graph: TrackGraph, detections: Sequence[Detections], cameras: Sequence[Camera]) -> np.ndarray:
    last = max((int(d.frame.max()) for d in detections if len(d.frame)), default=-1)
    tracks = np.full((len(graph.view), last + 1, 3), np.nan)
    for own, v, t in zip(tracks, graph.view, graph.track):
        which, pelvis = detections[v].track == t, detections[v].pelvis
        if pelvis is not None:
            # The depth is the joint's own: no offset into the body is added (C11).
            own[detections[v].frame[which]] = lift_joint(pelvis[which, 2], pelvis[which, :2], cameras[v], 0.0)
    distance = window_distances(tracks)
    distance[graph.view[:, None] == graph.view[None]] = np.nan
    return distance


def _pose_differences(
    graph: TrackGraph, detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> np.ndarray:
    """(M, M) median over shared frames of the angle between two tracks' postures; NaN where none is known."""
    count = len(graph.view)
    out = np.full((count, count), np.nan)
    seen = [Postures.of(d, c, limits) for d, c in zip(detections, cameras)]
    rows = [np.flatnonzero(detections[v].track == t) for v, t in zip(graph.view, graph.track)]
    for a, b in zip(*np.nonzero(np.triu(graph.moments, 1))):
        one, other = graph.view[a], graph.view[b]
        if one == other or not (seen[one].known and seen[other].known):
            continue
        _, i, j = np.intersect1d(detections[one].frame[rows[a]], detections[other].frame[rows[b]], return_indices=True)
        apart = posture_differences_rad(seen[one], rows[a][i], seen[other], rows[b][j], limits)
        apart = apart[np.isfinite(apart)]
        if len(apart):
            out[a, b] = out[b, a] = np.median(apart)
    return out
