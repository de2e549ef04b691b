# SPDX-License-Identifier: Apache-2.0
"""Who of those that the keypoints agree on is a person of this scene, and for every track why it is whose it is, or nobody's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.geometry.triangulation import Limits
from studiorecon.images.video import read_frames
from studiorecon.people.affinity import AssociationLimits
from studiorecon.people.evidence import EvidenceLimits, absent, motion_support, person_share, sampled_frames
from studiorecon.people.grouping import Group, group_tracks, torso_m, track_margins
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

_ENOUGH_CAMERAS = 3


@dataclass(frozen=True)
class Verdict:
    """What is known about one track.

    Attributes:
        person: ``p0``, …, or "" for nobody.
        margin: by how much it prefers its group to the next best one (numerics A12), NaN without a group.
        agreement: share of its group's keypoints in this camera that agree, NaN without a group.
        reason: why it is nobody's, or why its person is doubtful; "" when neither.
    """

    person: str
    margin: float
    agreement: float
    reason: str


def judge(group: Group, cameras: Sequence[Camera], frames: int, fps: float, limits: AssociationLimits) -> str | None:
    """Why a group is not a person of this scene, as the end of a sentence; None when it is one."""
    least = min(limits.least_s * fps, 0.5 * frames)
    if len(group.frames) < least:
        return f"two cameras agree for {len(group.frames) / fps:.2f} s only, {least / fps:.2f} s are needed"
    # Where rays of three cameras meet for a while, somebody stands, however many more cameras are blocked or look elsewhere.
    seen_by = int((group.seen.sum(1) >= least / 2).sum())
    needed = min(int(np.ceil(limits.camera_share * len(cameras))), _ENOUGH_CAMERAS)
    if seen_by < needed:
        return f"a bystander: {seen_by} of {len(cameras)} cameras see it, {needed} are needed"
    length = torso_m(group)
    if np.isfinite(length) and not limits.torso_m[0] <= length <= limits.torso_m[1]:
        return f"its torso would be {length:.2f} m long"
    return None


def supports(groups: Sequence[Group], detections: Sequence[Detections], videos: Sequence[Path], limits: EvidenceLimits) -> list[float]:
    """Share of the places every group's keypoints moved over that changed in the picture, NaN when too little moved."""
    counts = np.zeros((len(groups), len(detections), 2), dtype=int)
    for v, found in enumerate(progress(detections, "cameras")):
        picked = sampled_frames(found.frame, limits.frames)
        if not len(picked):
            continue
        wanted = set(picked.tolist())
        pictures = {t: picture for t, picture in enumerate(read_frames(videos[v], 0, int(picked[-1]) + 1)) if t in wanted}
        for g, group in enumerate(groups):
            tracks = [t for view, t in group.members if view == v]
            which = np.flatnonzero(np.isin(found.track, tracks) & np.isin(found.frame, picked))
            counts[g, v] = motion_support([pictures[int(found.frame[d])] for d in which], [found.keypoints[d] for d in which], limits)
    return [person_share(views) for views in counts]


def name_people(groups: Sequence[Group]) -> list[int]:
    """Order of the groups as p0, p1, …: by first frame seen by two cameras, then by how long, then by x."""
    return sorted(
        range(len(groups)), key=lambda i: (groups[i].frames[0], -len(groups[i].frames), float(np.nanmedian(groups[i].centres_m[:, 0])))
    )


def identities_from_keypoints(
    association: AssociationLimits,
    triangulation: Limits,
    evidence: EvidenceLimits,
    cameras: Sequence[Camera],
    given: Sequence[Detections],
    videos: list[Path],
    frames: int,
    fps: float,
) -> tuple[dict[tuple[str, int], Verdict], list[tuple[str, int, str, float, str]]]:
    """A verdict for every (camera, track), and the lines of people.tsv, of everybody the keypoints of two cameras or more agree on."""
    groups = group_tracks(given, cameras, frames, fps, association, triangulation)
    margins = track_margins(groups, given, cameras, association)
    reasons: dict[tuple[int, int], str] = {}
    kept = []
    for group in groups:
        reason = judge(group, cameras, frames, fps, association)
        if reason is None:
            kept.append(group)
        else:
            reasons |= dict.fromkeys(group.members, reason)
            say(f"not a person of this scene: {_tracks(group, cameras)}: {reason}")
    if kept and videos and evidence.frames:
        confirmed = _confirmed(kept, supports(kept, given, videos, evidence), cameras, evidence)
        gone = [m for g in kept if not any(g is c for c in confirmed) for m in g.members]
        reasons |= dict.fromkeys(gone, "the pictures show nobody there")
        kept = confirmed
    kept = [kept[i] for i in name_people(kept)]
    nan = float("nan")
    alone = "no other camera agrees with it, or it fits two people alike"
    table = {
        (d.camera, int(t)): Verdict("", margins.get((v, int(t)), nan), nan, reasons.get((v, int(t)), alone))
        for v, d in enumerate(given)
        for t in np.unique(d.track)
    }
    rows = []
    for number, group in enumerate(kept):
        for v, t in group.members:
            near = margins[v, t] < association.undecided_margin
            doubt = f"undecided: it prefers p{number} to somebody else by {margins[v, t]:.2f} only" if near else ""
            table[cameras[v].name, t] = Verdict(f"p{number}", margins[v, t], float(group.agreement[v]), doubt)
            if doubt:
                say(f"{cameras[v].name}/{t} is {doubt}")
        seen_by = [c.name for c, seen in zip(cameras, group.seen.any(1)) if seen]
        confidence = float(np.nanmean(group.agreement))
        rows.append((f"p{number}", len(group.frames), ",".join(seen_by), confidence, "keypoints"))
        say(
            f"p{number}: seen in {len(group.frames)} of {frames} frames by {', '.join(seen_by)}; "
            f"{confidence:.0%} of its keypoints agree, torso {torso_m(group):.2f} m"
        )
    rejected = sum(not v.person for v in table.values())
    say(
        f"{len(rows)} people with keypoints; {rejected} of {len(table)} tracks belong to nobody"
        if table
        else "no people: no camera has a detection"
    )
    return table, rows


def _confirmed(groups: list[Group], shares: list[float], cameras: Sequence[Camera], limits: EvidenceLimits) -> list[Group]:
    kept = []
    for group, share, gone in zip(groups, shares, absent(shares, limits)):
        if gone:
            say(
                f"not a person of this scene: {_tracks(group, cameras)}: the pictures show nobody there, only {share:.0%} of the places "
                "that its keypoints moved over changed"
            )
        else:
            kept.append(group)
    if np.isfinite(shares).any() and not any(share >= limits.present_share for share in shares):
        listed = ", ".join(f"{share:.0%}" for share in shares)
        say(f"whether the pictures show these people is undetermined: only {listed} of the places that their keypoints moved over changed")
    return kept


def _tracks(group: Group, cameras: Sequence[Camera]) -> str:
    return "tracks " + ", ".join(f"{cameras[v].name}/{t}" for v, t in group.members)
