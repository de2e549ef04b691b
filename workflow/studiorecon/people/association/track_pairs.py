# SPDX-License-Identifier: Apache-2.0
"""Distance and difference in pose of every two tracks, or every two detections, that may be one person.

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
from studiorecon.geometry import rotations
from studiorecon.geometry.lifting import lift_joint
from studiorecon.keypoints.correspondence import (
    TrackGraph,
    median_over_shared,
    ray_directions,
    ray_distances,
    track_graph,
)
from studiorecon.people.association.affinity import (
    AssociationLimits,
    affinities,
    apply_gate,
    combine_similarities,
    window_distances,
)
from studiorecon.people.association.postures import (
    joint_differences_rad,
    limb_differences_rad,
    limb_directions,
    parameter_differences_rad,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_MIN_SHARED = 4
_BY_PELVIS = ("pelvis", "scene")


@dataclass(frozen=True)
class Sights:
    """One camera's detections, prepared for comparison.

    Attributes:
        camera: the camera; frame, track: (D,).
        directions: (D, K, 3) unit rays of the stable keypoints, ``present`` (D, K).
        pelvis_m: (D, 3) world pelvis joint, NaN without monocular depth.
        pose: (D, 23, 3, 3) body joints of the monocular body, NaN without one.
        limbs: (D, 12, 3) limb directions in the world by the detector's guess, NaN without one.
        parameters: (D, 23, 3) the monocular body's original axis-angles, where those are to be compared.
    """

    camera: Camera
    frame: Integer[np.ndarray, " D"]
    track: Integer[np.ndarray, " D"]
    directions: Float[np.ndarray, "D K 3"]
    present: Bool[np.ndarray, "D K"]
    pelvis_m: Float[np.ndarray, "D 3"]
    pose: Float[np.ndarray, "D 23 3 3"]
    limbs: Float[np.ndarray, "D 12 3"]
    parameters: Float[np.ndarray, "D 23 3"] | None = None

    @property
    def postures(self) -> bool:
        """Whether any detection has a posture."""
        return bool(np.isfinite(self.pose).any() or np.isfinite(self.limbs).any())


def posture_angle_rad(
    first: Sights, i: Integer[np.ndarray, " ..."], second: Sights, j: Integer[np.ndarray, " ..."]
) -> Float[np.ndarray, " ..."]:
    """Angle in radians between the postures of detections ``i`` of one camera and ``j`` of another, broadcast.

    Of body joints where both have bodies, else of limb directions; NaN where neither is known.
    """
    limbs = limb_differences_rad(first.limbs[i], second.limbs[j])
    if not (np.isfinite(first.pose).any() and np.isfinite(second.pose).any()):
        return limbs
    if first.parameters is not None and second.parameters is not None:
        joints = parameter_differences_rad(first.parameters[i], second.parameters[j])
    else:
        joints = joint_differences_rad(first.pose[i], second.pose[j])
    return np.where(np.isfinite(joints), joints, limbs)


def sights(
    detections: Sequence[Detections], stable: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> list[Sights]:
    """One ``Sights`` per camera; raises UserError when the settings need data that no detection has."""
    if limits.position == "scene" and limits.affinity != "pose" and not any(_some(d.pelvis) for d in detections):
        raise UserError(
            "people.association.position is scene, but the scene's depth is unknown at every pelvis; set it to rays"
        )
    if limits.position == "pelvis" and limits.affinity != "pose" and not any(_some(d.pelvis) for d in detections):
        raise UserError(
            "people.association.position is pelvis, but no detection has the depth of its pelvis (recorded 2D "
            "keypoints do not): set it to rays, or use a detector that estimates bodies"
        )
    as_given = limits.pose_distance == "axis_angles"
    seen = [_sights(d, s, c, as_given) for d, s, c in zip(detections, stable, cameras)]
    if limits.affinity == "pose" and not any(s.postures for s in seen):
        raise UserError(
            "people.association.affinity is pose, but no detection has a body pose (recorded 2D keypoints do not): "
            "set it to both or position, or use the detector"
        )
    return seen


def _sights(detections: Detections, stable: Detections, camera: Camera, as_given: bool) -> Sights:
    count = len(detections.frame)
    directions, present = ray_directions(stable.keypoints, camera)
    pelvis = np.full((count, 3), np.nan) if detections.pelvis is None else detections.pelvis
    poses = np.full((count, 23, 3), np.nan) if detections.body_pose is None else detections.body_pose
    known = np.isfinite(poses).all((1, 2))
    matrices = rotations.exp(np.where(known[:, None, None], poses, 0.0))
    # The depth is the joint's own: no offset into the body is added (C11).
    world = lift_joint(pelvis[:, 2], pelvis[:, :2], camera, 0.0)
    return Sights(
        camera,
        detections.frame,
        detections.track,
        directions,
        present,
        world,
        np.where(known[:, None, None, None], matrices, np.nan),
        limb_directions(detections, camera),
        poses if as_given else None,
    )


def _some(values: np.ndarray | None) -> bool:
    return values is not None and bool(np.isfinite(values).all(tuple(range(1, values.ndim))).any())


def detection_affinities(
    first: Sights, i: Integer[np.ndarray, " A"], second: Sights, j: Integer[np.ndarray, " B"], limits: AssociationLimits
) -> Float[np.ndarray, "A B"]:
    """(A, B) affinity of the detections ``i`` (A,) of one camera and ``j`` (B,) of another, in the paper's form."""
    if not len(i) or not len(j):
        return np.zeros((len(i), len(j)))
    if limits.position in _BY_PELVIS:
        distance, gate_m = (
            np.linalg.norm(first.pelvis_m[i][:, None] - second.pelvis_m[j][None], axis=-1),
            limits.pelvis_gate_m,
        )
    else:
        rows, columns = (grid.ravel() for grid in np.meshgrid(i, j, indexing="ij"))
        gap = ray_distances(
            first.camera.centre_m, first.directions[rows], second.camera.centre_m, second.directions[columns]
        )
        shared = first.present[rows] & second.present[columns]
        distance, gate_m = median_over_shared(gap, shared, _MIN_SHARED).reshape(len(i), len(j)), limits.gate_m
    return affinities(distance, posture_angle_rad(first, i[:, None], second, j[None]), gate_m, limits)


@dataclass(frozen=True)
class TrackPairs:
    """Pairwise affinities of M tracks.

    Attributes:
        view, track: (M,) camera number and track id.
        affinity: (M, M) 0..1, 0 = no link; measured: (M, M) bool, False where the two share nothing to compare.
        forbidden: (M, M) bool: these two are not one person. moments: (M, M) number of frames in which both are seen.
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
        """(M,) number of detections of each track."""
        return np.diagonal(self.moments)


def track_pairs(
    seen: Sequence[Sights], stable: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> TrackPairs:
    """Affinities of all tracks over all frames they share.

    Position counts as 1 - d / gate, not as exp(-d / σ): the affinities of whole groups are summed, and a chance
    neighbour at the gate must add nothing (A05: "or cost -d instead of exp").
    """
    graph = track_graph(stable, cameras)
    shares = graph.distance_m / limits.gate_m
    if limits.position in _BY_PELVIS:
        shares = _pelvis_distances(graph, seen) / limits.pelvis_gate_m
    elif any(np.isfinite(s.pelvis_m).any() for s in seen):
        shares = np.where(np.isnan(shares), _pelvis_distances(graph, seen) / limits.pelvis_gate_m, shares)
    pose = _pose_differences(graph, seen) if limits.affinity != "position" else np.full(shares.shape, np.nan)
    near = apply_gate(shares, 1.0)
    affinity = combine_similarities(
        1 - near, np.exp(-pose / limits.sigma_rad), apply_gate(pose, limits.pose_gate_rad), limits
    )
    judged = pose / limits.pose_gate_rad if limits.affinity == "pose" else shares
    forbidden = ~np.isnan(judged) & ~(np.nan_to_num(judged, nan=0.0) < 1)
    same_view = graph.view[:, None] == graph.view[None]
    return TrackPairs(
        graph.view,
        graph.track,
        ~np.isnan(judged) & ~same_view,
        np.where(same_view, 0.0, affinity),
        forbidden | (same_view & (graph.moments > 0)),
        graph.moments,
        graph.distance_m,
        pose,
    )


def margins(pairs: TrackPairs, groups: Sequence[Sequence[int]]) -> Float[np.ndarray, " M"]:
    """(M,) a node's mean affinity to its own group less that to the best other group (A12); NaN for nodes in no
    group."""
    out = np.full(len(pairs.view), np.nan)
    for g, group in enumerate(groups):
        for node in group:
            others = [_closeness(pairs, node, other) for k, other in enumerate(groups) if k != g]
            out[node] = _closeness(pairs, node, [n for n in group if n != node]) - max(others, default=0.0)
    return out


def _closeness(pairs: TrackPairs, node: int, group: Sequence[int]) -> float:
    """Mean affinity to the group's comparable tracks, weighted by their length; 0 without any."""
    known = [n for n in group if pairs.measured[node, n]]
    return float(np.average(pairs.affinity[node, known], weights=pairs.detections[known])) if known else 0.0


def _pelvis_distances(graph: TrackGraph, seen: Sequence[Sights]) -> np.ndarray:
    last = max((int(s.frame.max()) for s in seen if len(s.frame)), default=-1)
    tracks = []
    for v, t in zip(graph.view, graph.track):
        positions, which = np.full((last + 1, 3), np.nan), seen[v].track == t
        positions[seen[v].frame[which]] = seen[v].pelvis_m[which]
        tracks.append(positions)
    distance = window_distances(tracks)
    distance[graph.view[:, None] == graph.view[None]] = np.nan
    return distance


def _pose_differences(graph: TrackGraph, seen: Sequence[Sights]) -> np.ndarray:
    """(M, M) median over shared frames of the angle between two tracks' postures; NaN where none is known."""
    count = len(graph.view)
    out = np.full((count, count), np.nan)
    for a in range(count):
        for b in range(a + 1, count):
            if graph.view[a] == graph.view[b]:
                continue
            one, other = (seen[graph.view[n]] for n in (a, b))
            i, j = (np.flatnonzero(s.track == graph.track[n]) for s, n in ((one, a), (other, b)))
            _, at_i, at_j = np.intersect1d(one.frame[i], other.frame[j], return_indices=True)
            apart = posture_angle_rad(one, i[at_i], other, j[at_j]) if len(at_i) else np.zeros(0)
            apart = apart[np.isfinite(apart)]
            if len(apart):
                out[a, b] = out[b, a] = np.median(apart)
    return out
