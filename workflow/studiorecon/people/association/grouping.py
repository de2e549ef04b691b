# SPDX-License-Identifier: Apache-2.0
"""Groups of per-camera tracks that may be one person: chosen by rays, checked by triangulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.geometry.groups import groups_by_affinity
from studiorecon.geometry.triangulation import Limits, unit_px
from studiorecon.keypoints.correspondence import stable_detections
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.gaps import Clothes, Return, join_over_gaps
from studiorecon.people.association.group import Group, has_no_rival, make_group
from studiorecon.people.association.reference_view import star_groups
from studiorecon.people.association.track_pairs import TrackPairs, node_margins, require_measured, track_pairs
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# Tracks with less time of detections than this, seconds, are not grouped; they join where their keypoints fit a group's
# points.
_LONG_S = 0.15
# Such a track needs so many comparable keypoints, and must agree so much better with one group than with any other.
_COMPARABLE, _CLEARLY = 6, 0.25


@dataclass(frozen=True)
class TrackComparison:
    """All cameras' detections of a capture, their stable keypoints, and the affinities of their tracks.

    Attributes:
        frames, fps: of the capture; limits, agree: of association and of triangulation.
    """

    detections: Sequence[Detections]
    stable: Sequence[Detections]
    cameras: Sequence[Camera]
    frames: int
    fps: float
    limits: AssociationLimits
    agree: Limits
    pairs: TrackPairs

    @staticmethod
    def from_detections(
        detections: Sequence[Detections],
        cameras: Sequence[Camera],
        frames: int,
        fps: float,
        limits: AssociationLimits,
        agree: Limits,
    ) -> TrackComparison:
        """The comparison of all detections; raises UserError when the settings need data that no detection has."""
        require_measured(detections, cameras, limits)
        stable = stable_detections(detections)
        pairs = track_pairs(detections, stable, cameras, limits)
        return TrackComparison(detections, stable, cameras, frames, fps, limits, agree, pairs)

    def member_rows(self, group: Group) -> list[int]:
        """Rows of the pairs that are the group's members."""
        node = {member: n for n, member in enumerate(self.pairs.nodes)}
        return [node[m] for m in group.members]

    def group(self, members: Sequence[tuple[int, int]]) -> Group:
        """The group of ``members`` (view, track)."""
        return make_group(members, self.stable, self.cameras, self.frames, self.agree)


def group_tracks(
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    fps: float,
    limits: AssociationLimits,
    agree: Limits,
) -> list[Group]:
    """All groups of at least two cameras; ``acceptance`` decides which are people.

    ``limits.method`` "tracks": whole tracks of all views together, checked by triangulation, joined over gaps. "star":
    the paper's single frame and reference view, unchanged.
    """
    return groups_and_returns(TrackComparison.from_detections(detections, cameras, frames, fps, limits, agree))[0]


def groups_and_returns(compared: TrackComparison, clothes: Clothes | None = None) -> tuple[list[Group], list[Return]]:
    """All groups of the compared detections, and possible returns of people; ``clothes`` compares two groups."""
    pairs, stable = compared.pairs, compared.stable
    if compared.limits.method == "star":
        stars = star_groups(compared.detections, stable, compared.cameras, compared.limits)
        return [compared.group(members) for members in stars], []
    long = np.flatnonzero(pairs.detections >= min(max(2.0, _LONG_S * compared.fps), pairs.detections.max(initial=0)))
    between = np.ix_(long, long)
    # A person who is always present is not outvoted by false detections in short stretches.
    affinity = pairs.affinity[between] * pairs.moments[between]
    nodes = pairs.nodes
    found = [
        _without_strangers(compared.group([nodes[n] for n in long[chosen]]), compared)
        for chosen in groups_by_affinity(affinity, pairs.forbidden[between])
    ]
    groups = _with_leftovers([g for g in found if g is not None], compared)
    return join_over_gaps(groups, stable, compared.fps, compared.group, clothes)


def track_margins(groups: Sequence[Group], compared: TrackComparison) -> dict[tuple[int, int], float]:
    """By how much every grouped (view, track) prefers its group to the next best one (A12).

    Below ``undecided_margin`` it is undecided.
    """
    rows = [compared.member_rows(g) for g in groups]
    found = node_margins(compared.pairs, rows)
    return {m: float(found[n]) for g, own in zip(groups, rows) for m, n in zip(g.members, own)}


def _fit(member: tuple[int, int], group: Group, compared: TrackComparison) -> tuple[float, int]:
    """(share of a track's keypoints within the outlier limit of the group's points, number of comparable ones)."""
    view, track = member
    mine, camera, agree = compared.stable[view], compared.cameras[view], compared.agree
    mine = mine.only(mine.track == track)
    projected, depth = camera.project(group.points_m[mine.frame])
    comparable = (mine.keypoints[..., 2] > agree.min_confidence) & (np.nan_to_num(depth, nan=-1.0) > agree.near_m)
    error = np.linalg.norm(projected - mine.keypoints[..., :2], axis=-1)
    limit = unit_px([camera], agree)[0] * agree.outlier_units
    total = int(comparable.sum())
    return (float((np.where(comparable, error, np.inf) < limit).sum() / total) if total else float("nan")), total


def _without_strangers(group: Group, compared: TrackComparison) -> Group | None:
    """The group without tracks that disagree with its points, worst first; None when fewer than two cameras remain."""
    while len({v for v, _ in group.members}) >= 2:
        share, worst = min((float(np.nan_to_num(_fit(m, group, compared)[0], nan=-1.0)), m) for m in group.members)
        if share >= compared.limits.track_agreement:
            return group
        group = compared.group([m for m in group.members if m != worst])
    return None


def _with_leftovers(groups: list[Group], compared: TrackComparison) -> list[Group]:
    """Groups with the tracks that no pair of rays placed, where their keypoints fit a group's projected points (A14).

    Two people in line with a camera both fit a detection of one of them: the clearest tracks are placed first. A track
    that still fits two groups equally gets no person rather than a wrong one.
    """
    placed = [list(g.members) for g in groups]
    shares = {
        m: [share if total >= _COMPARABLE else 0.0 for share, total in (_fit(m, g, compared) for g in groups)]
        for m in sorted(set(compared.pairs.nodes) - {m for g in groups for m in g.members})
    }
    while True:
        clear = []
        for m, own in shares.items():
            free = [(own[i], -i) for i, members in enumerate(placed) if has_no_rival(m, members, compared.stable)]
            first, second = sorted([*free, (0.0, -len(groups)), (0.0, -len(groups))], reverse=True)[:2]
            if first[0] >= compared.limits.track_agreement and first[0] - second[0] >= _CLEARLY:
                clear.append((first[0] - second[0], m, -first[1]))
        if not clear:
            return [g if len(m) == len(g.members) else compared.group(m) for g, m in zip(groups, placed)]
        _, member, i = max(clear)
        placed[i].append(member)
        del shares[member]
