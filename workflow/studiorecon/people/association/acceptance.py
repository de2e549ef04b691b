# SPDX-License-Identifier: Apache-2.0
"""Decides which groups of tracks are people of this scene, and for every track its person, or none, with the reason.

A group's log-likelihood ratio is the prior and the sum of its terms. Two groups may also explain one person (found
twice, or in a mirror): such pairs cost nats if both are accepted. The set of groups with the largest sum is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.geometry.triangulation import Limits
from studiorecon.people.association import terms
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.gaps import Return, group_tracks
from studiorecon.people.association.grouping import Group, TrackComparison
from studiorecon.people.association.picture_terms import picture_terms
from studiorecon.people.association.rejected_people import RejectedPerson, list_rejected
from studiorecon.people.association.terms import Term, total_nats
from studiorecon.people.pictures.clothes import compare_clothes
from studiorecon.people.pictures.coverage import CameraEvidence
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool

# Pictures are read for groups that they can still decide: what they say at most, nats.
_PICTURES_NATS = 12.0


@dataclass(frozen=True)
class TrackVerdict:
    """The decision on one track.

    Attributes:
        person: ``p0``, …, or "" for none.
        margin: by how much it prefers its group to the next best one (A12), NaN without a group.
        reason: why it has no person, or why its person is doubtful; "" when neither.
    """

    person: str
    margin: float
    reason: str


def identities_from_keypoints(
    association: AssociationLimits,
    triangulation: Limits,
    cameras: Sequence[Camera],
    given: Sequence[Detections],
    videos: Sequence[Path],
    frames: int,
    fps: float,
    witnesses: Sequence[CameraEvidence | None] = (),
) -> tuple[dict[tuple[str, int], TrackVerdict], list[tuple[str, int, str, float, str]], list[RejectedPerson]]:
    """Verdicts for every (camera, track), the lines of people.tsv, and the rejected groups.

    Candidates are all groups on which the keypoints of two cameras or more agree. ``witnesses``: every camera's
    evidence other than its film.
    """
    compared = TrackComparison(given, cameras, frames, fps, association, triangulation)
    groups, returns = group_tracks(compared, compare_clothes(cameras, videos) if videos else None)
    # The paper rejects nobody: each person of its reference view is one.
    about: list[list[Term]] = [[] for _ in groups]
    accepted = np.ones(len(groups), dtype=bool)
    if association.method != "star":
        about = group_terms(groups, compared, videos, witnesses)
        pairs = pair_terms(groups, cameras, fps)
        accepted = choose_groups([total_nats(own) for own in about], {pair: term.nats for pair, term in pairs.items()})
        for (g, h), term in pairs.items():
            about[g] += [term] * bool(accepted[h] and not accepted[g])
    # p0, p1, …: by first frame seen by two cameras, then by frames of all cameras, then by x.
    kept = sorted(
        (g for g, one in zip(groups, accepted) if one),
        key=lambda g: (g.frames[0], -int(g.seen.sum()), float(np.nanmedian(g.centres_m[:, 0]))),
    )
    rejected = [(g, own) for g, own, one in zip(groups, about, accepted) if not one]
    table = _verdicts(kept, rejected, compared)
    rows = [_row(number, group, compared) for number, group in enumerate(kept)]
    nobodys = sum(not v.person for v in table.values())
    say(
        f"{len(rows)} people with keypoints; {nobodys} of {len(table)} tracks belong to no person"
        if table
        else "no people: no camera has a detection"
    )
    _report_returns(returns, table, cameras)
    return table, rows, list_rejected(rejected, cameras, frames, fps)


def group_terms(
    groups: Sequence[Group],
    compared: TrackComparison,
    videos: Sequence[Path],
    witnesses: Sequence[CameraEvidence | None],
) -> list[list[Term]]:
    """The terms of each group; pictures are read for those that they can still decide."""
    rig_m, distance_m, fps = rig_sigma_m(compared), compared.pairs.graph.distance_m, compared.fps
    about = []
    for group in groups:
        extremities_m = compared.group(group.members, terms.EXTREMITIES).points_m
        about.append(
            [
                terms.duration(group, fps),
                terms.views(group, compared.cameras),
                terms.rays(group, compared.between(group, distance_m), compared.limits.gate_m, rig_m),
                terms.size(group.bones),
                terms.proportions(group.bones),
                terms.posture(compared.between(group, compared.pairs.pose_rad)),
                terms.depth(group.points_m, extremities_m, group.bones, fps),
            ]
        )
    open_ = [k for k, own in enumerate(about) if videos and total_nats(own) > -_PICTURES_NATS]
    if open_:
        for k, own in zip(open_, picture_terms([groups[k] for k in open_], compared, videos, witnesses)):
            about[k] += own
    return about


def rig_sigma_m(compared: TrackComparison) -> float:
    """Deviation, m, of rays to one joint due to the cameras: the usual distance of rays of tracks that can be one
    person, weighted by their time; 0 with too few."""
    graph = compared.pairs.graph
    with np.errstate(invalid="ignore"):
        one = np.triu((compared.pairs.affinity > 0) & (graph.distance_m < compared.limits.gate_m), 1)
    apart = np.repeat(graph.distance_m[one], graph.moments[one])
    return float(np.quantile(apart, 0.5, method="inverted_cdf")) if len(apart) else 0.0


def pair_terms(groups: Sequence[Group], cameras: Sequence[Camera], fps: float) -> dict[tuple[int, int], Term]:
    """(g, h) → the term against group g if h is a person; pairs without one are left out."""
    centres_m = np.array([c.centre_m for c in cameras])
    found = {}
    for (g, one), (h, other) in permutations(enumerate(groups), 2):
        twice = terms.overlap(one.points_m, other.points_m)
        mirrored = terms.reflection(one.points_m, other.points_m, centres_m, fps)
        found[g, h] = min(twice, mirrored, key=lambda term: term.nats)
    return {pair: term for pair, term in found.items() if term.nats < 0}


def choose_groups(nats: Sequence[float], pairs: dict[tuple[int, int], float]) -> Bool[np.ndarray, " G"]:
    """Which groups are accepted: the set with the largest sum of ``nats`` and of the ``pairs`` (≤ 0) within it."""
    if not len(nats):
        return np.zeros(0, dtype=bool)
    objective = -np.array([*nats, *pairs.values()])
    # A pair's variable is 1 where both of its groups are.
    rows = np.zeros((len(pairs), len(objective)))
    for k, (g, h) in enumerate(pairs):
        rows[k, [g, h, len(nats) + k]] = 1, 1, -1
    constraints = [scipy.optimize.LinearConstraint(rows, -np.inf, 1)] if pairs else []
    found = scipy.optimize.milp(
        objective, integrality=np.ones(len(objective)), bounds=scipy.optimize.Bounds(0, 1), constraints=constraints
    )
    return np.round(found.x[: len(nats)]).astype(bool)


def _verdicts(
    kept: Sequence[Group], rejected: Sequence[tuple[Group, Sequence[Term]]], compared: TrackComparison
) -> dict[tuple[str, int], TrackVerdict]:
    """(camera, track) → verdict of every track; the undecided ones are logged."""
    cameras, alone = compared.cameras, "no other camera agrees with it, or it fits two people equally well"
    reasons = dict.fromkeys(compared.pairs.nodes, alone)
    for group, own in rejected:
        reasons |= dict.fromkeys(group.members, terms.strongest_objections(own))
    table = {(cameras[v].name, t): TrackVerdict("", float("nan"), reason) for (v, t), reason in reasons.items()}
    margins = compared.pairs.margins([group.members for group in kept])
    for number, group in enumerate(kept):
        for v, t in group.members:
            margin, doubt = margins[v, t], ""
            if margin < compared.limits.undecided_margin:
                doubt = f"undecided: it fits p{number} only {margin:.2f} better than another person"
                say(f"{cameras[v].name}/{t} is {doubt}")
            table[cameras[v].name, t] = TrackVerdict(f"p{number}", margin, doubt)
    return table


def _row(number: int, group: Group, compared: TrackComparison) -> tuple[str, int, str, float, str]:
    """The line of people.tsv."""
    names, trunk_m = group.seen_by(compared.cameras), terms.trunk_length_m(group.bones)
    torso = f", torso {trunk_m:.2f} m" if np.isfinite(trunk_m) else ""
    say(
        f"p{number}: seen in {len(group.frames)} of {compared.frames} frames by {', '.join(names)}; "
        f"{group.confidence:.0%} of its keypoints agree{torso}"
    )
    return f"p{number}", len(group.frames), ",".join(names), group.confidence, "keypoints"


def _report_returns(
    returns: Sequence[Return], table: dict[tuple[str, int], TrackVerdict], cameras: Sequence[Camera]
) -> None:
    """Log the people who keep their name over a gap, and the pairs of names that may be one person."""
    for one in returns:
        before, after = (table[cameras[v].name, t].person for v, t in (one.before, one.after))
        because = ", ".join(f"{term.text} ({term.nats:+.1f})" for term in one.terms)
        if one.joined and before:
            say(
                f"{before} is away from {one.left_s:.1f} to {one.back_s:.1f} s and keeps the name by "
                f"{one.margin_nats:.1f} nats: {because}"
            )
        elif before and after and before != after:
            warn(
                f"{after}, seen from {one.back_s:.1f} s on, may be {before}, who left at {one.left_s:.1f} s: undecided "
                f"by {one.margin_nats:.1f} nats ({because}); if so, give {after}'s tracks in identities.tsv to {before}"
            )
