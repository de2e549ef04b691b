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
from studiorecon.people.association.track_pairs import Sights, TrackPairs, margins, sights, track_pairs
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# Tracks with less time of detections than this, seconds, are not grouped; they join where their keypoints fit a group's
# points.
_LONG_S = 0.15
# Such a track needs so many comparable keypoints, and must agree so much better with one group than with any other.
_COMPARABLE, _CLEARLY = 6, 0.25


@dataclass(frozen=True)
class Compared:
    """All cameras' detections, their stable keypoints, and the affinities of their tracks."""

    detections: Sequence[Detections]
    stable: Sequence[Detections]
    cameras: Sequence[Camera]
    seen: Sequence[Sights]
    pairs: TrackPairs

    @staticmethod
    def of(detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits) -> Compared:
        """Of the detections of all cameras; raises UserError when the settings need data that no detection has."""
        stable = stable_detections(detections)
        seen = sights(detections, stable, cameras, limits)
        return Compared(detections, stable, cameras, seen, track_pairs(seen, stable, cameras, limits))

    @property
    def node(self) -> dict[tuple[int, int], int]:
        """(view, track) → row of the pairs."""
        return {(int(v), int(t)): n for n, (v, t) in enumerate(zip(self.pairs.view, self.pairs.track))}


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
    return groups_and_returns(Compared.of(detections, cameras, limits), frames, fps, limits, agree)[0]


def groups_and_returns(
    compared: Compared,
    frames: int,
    fps: float,
    limits: AssociationLimits,
    agree: Limits,
    clothes: Clothes | None = None,
) -> tuple[list[Group], list[Return]]:
    """The same of compared detections, and who may have returned; ``clothes`` compares what groups wear."""
    stable, cameras, pairs = compared.stable, compared.cameras, compared.pairs
    if limits.method == "star":
        stars = star_groups(compared.seen, limits)
        return [make_group(members, stable, cameras, frames, agree) for members in stars], []
    groups = []
    long = np.flatnonzero(pairs.detections >= min(max(2.0, _LONG_S * fps), pairs.detections.max(initial=0)))
    between = np.ix_(long, long)
    # A person who is always present is not outvoted by false detections in short stretches.
    affinity = pairs.affinity[between] * pairs.moments[between]
    for nodes in groups_by_affinity(affinity, pairs.forbidden[between]):
        members = [(int(pairs.view[n]), int(pairs.track[n])) for n in long[nodes]]
        group = _without_strangers(
            make_group(members, stable, cameras, frames, agree), stable, cameras, frames, limits, agree
        )
        if group is not None:
            groups.append(group)
    groups = _with_leftovers(groups, stable, cameras, frames, limits, agree)

    def merge(members: list[tuple[int, int]]) -> Group:
        return make_group(members, stable, cameras, frames, agree)

    return join_over_gaps(groups, stable, fps, merge, clothes)


def track_margins(groups: Sequence[Group], compared: Compared) -> dict[tuple[int, int], float]:
    """By how much every grouped (view, track) prefers its group to the next best one (A12).

    Below ``undecided_margin`` it is undecided.
    """
    node = compared.node
    found = margins(compared.pairs, [[node[m] for m in g.members] for g in groups])
    return {m: float(found[node[m]]) for g in groups for m in g.members}


def track_agreements(
    group: Group, stable: Sequence[Detections], cameras: Sequence[Camera], agree: Limits
) -> dict[tuple[int, int], float]:
    """Share of every member's keypoints that are within the outlier limit of the group's points."""
    return {m: _fit(m, group, stable, cameras, agree)[0] for m in group.members}


def _fit(
    member: tuple[int, int], group: Group, stable: Sequence[Detections], cameras: Sequence[Camera], agree: Limits
) -> tuple[float, int]:
    view, track = member
    which = np.flatnonzero(stable[view].track == track)
    projected, depth = cameras[view].project(group.points_m[stable[view].frame[which]])
    comparable = (stable[view].keypoints[which, :, 2] > agree.min_confidence) & (
        np.nan_to_num(depth, nan=-1.0) > agree.near_m
    )
    error = np.linalg.norm(projected - stable[view].keypoints[which, :, :2], axis=-1)
    limit = unit_px([cameras[view]], agree)[0] * agree.outlier_units
    total = int(comparable.sum())
    return (float((np.where(comparable, error, np.inf) < limit).sum() / total) if total else float("nan")), total


def _without_strangers(
    group: Group,
    stable: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    limits: AssociationLimits,
    agree: Limits,
) -> Group | None:
    """The group without tracks that disagree with its points, worst first; None when fewer than two cameras remain."""
    while len({v for v, _ in group.members}) >= 2:
        shares = {
            m: s for m, s in track_agreements(group, stable, cameras, agree).items() if not s >= limits.track_agreement
        }
        if not shares:
            return group
        worst = min(shares, key=lambda m: (np.nan_to_num(shares[m], nan=-1.0), m))
        group = make_group([m for m in group.members if m != worst], stable, cameras, frames, agree)
    return None


def _with_leftovers(
    groups: list[Group],
    stable: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    limits: AssociationLimits,
    agree: Limits,
) -> list[Group]:
    """Groups with the tracks that no pair of rays placed, where their keypoints fit a group's projected points (A14).

    Two people in line with a camera both fit a detection of one of them: the clearest tracks are placed first. A track
    that still fits two groups equally gets no person rather than a wrong one.
    """
    taken = {m for g in groups for m in g.members}
    left = [(v, int(t)) for v, d in enumerate(stable) for t in np.unique(d.track) if (v, int(t)) not in taken]
    fits = {m: [_fit(m, g, stable, cameras, agree) for g in groups] for m in left}
    shares = {m: [share if total >= _COMPARABLE else 0.0 for share, total in found] for m, found in fits.items()}
    placed = [list(g.members) for g in groups]
    while True:
        clear = []
        for m in left:
            free = [(shares[m][i], -i) for i, members in enumerate(placed) if has_no_rival(m, members, stable)]
            first, second = sorted([*free, (0.0, -len(groups)), (0.0, -len(groups))], reverse=True)[:2]
            if first[0] >= limits.track_agreement and first[0] - second[0] >= _CLEARLY:
                clear.append((first[0] - second[0], m, -first[1]))
        if not clear:
            break
        _, member, i = max(clear)
        placed[i].append(member)
        left.remove(member)
    return [
        g if len(m) == len(g.members) else make_group(m, stable, cameras, frames, agree) for g, m in zip(groups, placed)
    ]
