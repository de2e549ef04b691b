# SPDX-License-Identifier: Apache-2.0
"""Groups of per-camera tracks that may be one person: chosen by affinity, and triangulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.groups import groups_by_affinity
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS, stable_detections
from studiorecon.keypoints.tracking import match_detections
from studiorecon.people.association.affinity import AssociationLimits, TrackPairs, track_pairs
from studiorecon.people.association.terms import Bones, measure_bones
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# A camera sees a person in a frame where so many of the stable keypoints agree with the others'.
_MIN_AGREEING = 3


@dataclass(frozen=True)
class Group:
    """Tracks that may show one person.

    Attributes:
        members: (view, track) pairs, sorted.
        points_m: stable keypoints, NaN where undetermined.
        agreement: share of each view's keypoints that agree with the points, NaN where it has none.
        seen: (V, T) bool: the view has at least three agreeing keypoints in that frame.
    """

    members: tuple[tuple[int, int], ...]
    points_m: Float[np.ndarray, "T K 3"]
    agreement: Float[np.ndarray, " V"]
    seen: Bool[np.ndarray, "V T"]

    @property
    def frames(self) -> Integer[np.ndarray, " F"]:
        """Frames in which at least two cameras agree."""
        return np.flatnonzero(self.seen.sum(0) >= 2)

    @property
    def confidence(self) -> float:
        """Mean share of keypoints that agree."""
        return float(np.nanmean(self.agreement))

    def seen_by(self, cameras: Sequence[Camera]) -> list[str]:
        """Names of the cameras that see the group."""
        return [camera.name for camera, seen in zip(cameras, self.seen) if seen.any()]

    @cached_property
    def bones(self) -> Bones:
        """Its bones' lengths."""
        return measure_bones(self.points_m)

    @cached_property
    def centres_m(self) -> Float[np.ndarray, "T 3"]:
        """Median of the determined keypoints, NaN where there are none."""
        known = np.isfinite(self.points_m).all(-1)
        centres = np.full((len(self.points_m), 3), np.nan)
        for t in np.flatnonzero(known.any(-1)):
            centres[t] = np.median(self.points_m[t, known[t]], axis=0)
        return centres


@dataclass(frozen=True)
class TrackComparison:
    """All cameras' detections of a capture, their stable keypoints, and the affinities of their tracks.

    Attributes:
        frames, fps: of the capture; limits, agree: of association and of triangulation.
    """

    detections: Sequence[Detections]
    cameras: Sequence[Camera]
    frames: int
    fps: float
    limits: AssociationLimits
    agree: Limits

    @cached_property
    def stable(self) -> list[Detections]:
        """The detections with the stable keypoints only."""
        return stable_detections(self.detections)

    @cached_property
    def pairs(self) -> TrackPairs:
        """Affinities of all tracks; raises UserError when they need depth, and no pelvis has any."""
        if self.limits.position == "scene" and not any(
            d.pelvis is not None and np.isfinite(d.pelvis).all(1).any() for d in self.detections
        ):
            raise UserError(
                "people.association.position is scene, but the scene's depth is unknown at every pelvis; set it to rays"
            )
        return track_pairs(self.detections, self.stable, self.cameras, self.limits)

    def rows(self, group: Group) -> list[int]:
        """Rows of the pairs that are the group's members."""
        return [self.pairs.nodes.index(m) for m in group.members]

    def between(self, group: Group, values: Float[np.ndarray, "M M"]) -> Float[np.ndarray, " N"]:
        """The known ``values`` of pairs of its members, each as often as there are frames in which both are seen."""
        pairs = np.triu_indices(len(self.pairs.nodes), 1)
        known = np.isin(pairs, self.rows(group)).all(0) & np.isfinite(values[pairs])
        return np.repeat(values[pairs][known], self.pairs.graph.moments[pairs][known])

    def group(self, members: Sequence[tuple[int, int]], keypoints: Sequence[str] = STABLE_KEYPOINTS) -> Group:
        """The group of ``members`` (view, track), with its triangulated ``keypoints``."""
        shape = len(self.cameras), self.frames, len(keypoints)
        seen = np.full((*shape, 3), [np.nan, np.nan, 0.0])
        found = self.stable if keypoints is STABLE_KEYPOINTS else stable_detections(self.detections, None, keypoints)
        for view, track in members:
            own = found[view].only(found[view].track == track)
            seen[view, own.frame] = own.keypoints
        flat = seen.reshape(shape[0], -1, 3)
        points = triangulate(flat[..., :2], flat[..., 2], self.cameras, self.agree)
        inliers = points.inliers.reshape(shape)
        judged = (seen[..., 2] > self.agree.min_confidence) & points.valid.reshape(shape[1:])
        total = judged.sum((1, 2))
        agreement = np.where(total > 0, (inliers & judged).sum((1, 2)) / np.maximum(total, 1), np.nan)
        points_m, often = points.points_m.reshape(*shape[1:], 3), inliers.sum(-1) >= _MIN_AGREEING
        return Group(tuple(sorted(members)), points_m, agreement, often)


def groups_at_once(compared: TrackComparison) -> list[Group]:
    """All groups of at least two cameras whose tracks share frames.

    ``limits.method`` "tracks": whole tracks of all views together. "star": the paper's single frame and reference view,
    unchanged.
    """
    if compared.limits.method == "star":
        return [compared.group(members) for members in _stars(compared)]
    pairs = compared.pairs
    # Whatever the affinity goes by, rays decide where they are known: those that pass each other show two people.
    apart = pairs.graph.distance_m >= compared.limits.gate_m
    forbidden = np.where(np.isnan(pairs.graph.distance_m), pairs.forbidden, apart)
    # A person who is always present is not outvoted by false detections in short stretches.
    affinity = np.where(apart, 0.0, np.nan_to_num(pairs.affinity)) * pairs.graph.moments
    chosen = groups_by_affinity(affinity, forbidden)
    return [compared.group([pairs.nodes[n] for n in rows]) for rows in chosen]


def _stars(compared: TrackComparison) -> list[list[tuple[int, int]]]:
    """The paper's groups at the first frame with a person (its t₀ = 0; U31), and the tracks that begin later.

    The view with most people is the reference; the Hungarian algorithm matches every other view to it. A person whom
    it does not see never gets an identity (A15), and one frame's noise decides (A11). Tracks that begin later go to
    the person to whom they have the largest mean affinity (A14).
    """
    pairs = compared.pairs
    start = min((int(d.frame.min()) for d in compared.detections if len(d.frame)), default=0)
    here, stable = ([d.only(d.frame == start) for d in own] for own in (compared.detections, compared.stable))
    now = track_pairs(here, stable, compared.cameras, compared.limits)
    view, affinity = now.graph.view, np.nan_to_num(now.affinity)
    people = np.flatnonzero(view == np.argmax(np.bincount(view, minlength=len(compared.cameras))))
    at = [pairs.nodes.index(node) for node in now.nodes]
    groups = [[at[n]] for n in people]
    for v in set(view.tolist()):
        others = np.flatnonzero((view == v) & ~np.isin(view, view[people]))
        # No affinity is no match, whatever the assignment (A03, A13).
        for i, k in match_detections(1 - affinity[np.ix_(others, people)], 1.0):
            groups[k].append(at[others[i]])
    affinity, same_view = np.nan_to_num(pairs.affinity), pairs.graph.view[:, None] == pairs.graph.view
    rivals = same_view & (pairs.graph.moments > 0)
    for n in sorted(set(range(len(pairs.nodes))) - set(at)):
        near = [0.0 if rivals[n, g].any() else float(affinity[n, g].mean()) for g in groups]
        if max(near, default=0.0) > 0:
            groups[int(np.argmax(near))].append(n)
    return [[pairs.nodes[n] for n in g] for g in groups if len(set(pairs.graph.view[g])) >= 2]
