# SPDX-License-Identifier: Apache-2.0
"""Groups of per-camera tracks that are one person: chosen by rays, checked by triangulation, joined over gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.groups import groups_by_affinity
from studiorecon.geometry.triangulation import Limits, triangulate, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS, stable_detections
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.reference_view import star_groups
from studiorecon.people.association.track_pairs import TrackPairs, margins, sights, track_pairs
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Tracks with less time of detections than this, seconds, are not grouped; they join where their keypoints fit a group's
# points.
_LONG_S = 0.15
# A camera sees a person in a frame where so many of the stable keypoints agree with the others'.
_AGREEING = 3
# Such a track needs so many comparable keypoints, and must agree so much better with one group than with any other.
_COMPARABLE, _CLEARLY = 6, 0.25


@dataclass(frozen=True)
class Group:
    """Tracks that show one person.

    Attributes:
        members: (view, track) pairs, sorted.
        points_m: (T, K, 3) stable keypoints, NaN where undetermined.
        agreement: (V,) share of each view's keypoints that agree with the points, NaN where it has none.
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
    def centres_m(self) -> Float[np.ndarray, "T 3"]:
        """(T, 3) median of the determined keypoints, NaN where there are none."""
        known = np.isfinite(self.points_m).all(-1)
        centres = np.full((len(self.points_m), 3), np.nan)
        for t in np.flatnonzero(known.any(-1)):
            centres[t] = np.median(self.points_m[t, known[t]], axis=0)
        return centres


def group_tracks(
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    fps: float,
    limits: AssociationLimits,
    agree: Limits,
) -> list[Group]:
    """All groups of at least two cameras; ``judge`` decides which are people.

    ``limits.method`` "tracks": whole tracks of all views together, checked by triangulation, joined over gaps. "star":
    the paper's single frame and reference view, unchanged.
    """
    stable = stable_detections(detections)
    seen = sights(detections, stable, cameras, limits)
    if limits.method == "star":
        return [_group(members, stable, cameras, frames, agree) for members in star_groups(seen, limits)]
    pairs = track_pairs(seen, stable, cameras, limits)
    groups = []
    long = np.flatnonzero(pairs.detections >= min(max(2.0, _LONG_S * fps), pairs.detections.max(initial=0)))
    between = np.ix_(long, long)
    # A person who is always present is not outvoted by false detections in short stretches.
    affinity = pairs.affinity[between] * pairs.moments[between]
    for nodes in groups_by_affinity(affinity, pairs.forbidden[between]):
        members = [(int(pairs.view[n]), int(pairs.track[n])) for n in long[nodes]]
        group = _without_strangers(
            _group(members, stable, cameras, frames, agree), stable, cameras, frames, limits, agree
        )
        if group is not None:
            groups.append(group)
    groups = _with_leftovers(groups, stable, cameras, frames, limits, agree)
    return _joined_over_gaps(groups, stable, cameras, frames, fps, limits, agree)


def track_margins(
    groups: Sequence[Group], detections: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> dict[tuple[int, int], float]:
    """By how much every grouped (view, track) prefers its group to the next best one (A12).

    Below ``undecided_margin`` it is undecided.
    """
    stable = stable_detections(detections)
    pairs: TrackPairs = track_pairs(sights(detections, stable, cameras, limits), stable, cameras, limits)
    node = {(int(v), int(t)): n for n, (v, t) in enumerate(zip(pairs.view, pairs.track))}
    found = margins(pairs, [[node[m] for m in g.members] for g in groups])
    return {m: float(found[node[m]]) for g in groups for m in g.members}


def torso_m(group: Group) -> float:
    """Median distance from the middle of the shoulders to the middle of the hips; NaN when never seen."""
    at = [STABLE_KEYPOINTS.index(f"{s}_{j}") for j in ("shoulder", "hip") for s in ("left", "right")]
    ends = group.points_m[:, at]
    known = np.isfinite(ends).all((1, 2))
    lengths = np.linalg.norm(ends[known, :2].mean(1) - ends[known, 2:].mean(1), axis=-1)
    return float(np.median(lengths)) if len(lengths) else float("nan")


def _group(
    members: Sequence[tuple[int, int]],
    stable: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    agree: Limits,
) -> Group:
    pixels, confidence = _observed(members, stable, frames)
    views, times, count = confidence.shape
    found = triangulate(pixels.reshape(views, -1, 2), confidence.reshape(views, -1), cameras, agree)
    inliers = found.inliers.reshape(views, times, count)
    judged = (confidence > agree.min_confidence) & found.valid.reshape(times, count)
    total = judged.sum((1, 2))
    agreement = np.where(total > 0, (inliers & judged).sum((1, 2)) / np.maximum(total, 1), np.nan)
    return Group(
        tuple(sorted(members)), found.points_m.reshape(times, count, 3), agreement, inliers.sum(-1) >= _AGREEING
    )


def _observed(
    members: Sequence[tuple[int, int]], stable: Sequence[Detections], frames: int
) -> tuple[np.ndarray, np.ndarray]:
    pixels = np.full((len(stable), frames, len(STABLE_KEYPOINTS), 2), np.nan)
    confidence = np.zeros(pixels.shape[:-1])
    for view, track in members:
        which = stable[view].track == track
        pixels[view, stable[view].frame[which]] = stable[view].keypoints[which, :, :2]
        confidence[view, stable[view].frame[which]] = stable[view].keypoints[which, :, 2]
    return pixels, confidence


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
        group = _group([m for m in group.members if m != worst], stable, cameras, frames, agree)
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
            free = [(shares[m][i], -i) for i, members in enumerate(placed) if _free(m, members, stable)]
            first, second = sorted([*free, (0.0, -len(groups)), (0.0, -len(groups))], reverse=True)[:2]
            if first[0] >= limits.track_agreement and first[0] - second[0] >= _CLEARLY:
                clear.append((first[0] - second[0], m, -first[1]))
        if not clear:
            break
        _, member, i = max(clear)
        placed[i].append(member)
        left.remove(member)
    return [
        g if len(m) == len(g.members) else _group(m, stable, cameras, frames, agree) for g, m in zip(groups, placed)
    ]


def _free(member: tuple[int, int], members: Sequence[tuple[int, int]], stable: Sequence[Detections]) -> bool:
    """Whether ``members`` have no detection of this camera in any of the member's frames: one detection per view."""
    view, track = member
    mine = stable[view].frame[stable[view].track == track]
    theirs = stable[view].frame[np.isin(stable[view].track, [t for v, t in members if v == view])]
    return not np.isin(mine, theirs).any()


def _joined_over_gaps(
    groups: list[Group],
    stable: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    fps: float,
    limits: AssociationLimits,
    agree: Limits,
) -> list[Group]:
    """Groups that follow each other joined as one, the nearest pair first; the gate grows with the unseen time
    (A14)."""
    while True:
        best: tuple[float, int, int] | None = None
        for i, first in enumerate(groups):
            for j, second in enumerate(groups):
                if i == j or not all(_free(m, first.members, stable) for m in second.members):
                    continue
                first_seen, second_seen = (np.flatnonzero(np.isfinite(g.centres_m).all(-1)) for g in (first, second))
                if not len(first_seen) or not len(second_seen) or first_seen[-1] >= second_seen[0]:
                    continue
                gap_s = (second_seen[0] - first_seen[-1]) / fps
                apart = float(np.linalg.norm(second.centres_m[second_seen[0]] - first.centres_m[first_seen[-1]]))
                if (
                    gap_s <= limits.reentry_s
                    and apart < 2 * limits.gate_m + limits.reentry_speed_m_s * gap_s
                    and (best is None or apart < best[0])
                ):
                    best = (apart, i, j)
        if best is None:
            return groups
        merged = _group([*groups[best[1]].members, *groups[best[2]].members], stable, cameras, frames, agree)
        groups = [g for k, g in enumerate(groups) if k not in best[1:]] + [merged]
