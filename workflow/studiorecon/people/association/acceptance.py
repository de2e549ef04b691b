# SPDX-License-Identifier: Apache-2.0
"""Decides which groups of tracks are people of this scene, and for every track its person, or none, with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.video import read_frames
from studiorecon.geometry.triangulation import Limits
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.false_positives import FOUND_TWICE, deep_points_m, is_duplicate, rejection_reason
from studiorecon.people.association.grouping import Group, group_tracks, torso_m, track_margins
from studiorecon.people.association.image_evidence import CameraEvidence, ImageEvidence, evidence_in_cameras
from studiorecon.people.association.picture_change import (
    EvidenceLimits,
    absent_people,
    limb_counts,
    motion_support,
    sampled_frames,
    steps_m,
    view_shares,
)
from studiorecon.people.association.proportions import proportion_fault
from studiorecon.people.association.rejected_people import RejectedPerson, list_rejected
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

_ENOUGH_CAMERAS = 3
# Cameras that see a person one after the other count if each does for so many times the time that two must agree.
_LONG = 2.0


@dataclass(frozen=True)
class TrackVerdict:
    """The decision on one track.

    Attributes:
        person: ``p0``, …, or "" for none.
        margin: by how much it prefers its group to the next best one (A12), NaN without a group.
        agreement: share of its group's keypoints in this camera that agree, NaN without a group.
        reason: why it has no person, or why its person is doubtful; "" when neither.
    """

    person: str
    margin: float
    agreement: float
    reason: str


def judge(group: Group, cameras: Sequence[Camera], frames: int, fps: float, limits: AssociationLimits) -> str:
    """Why a group is not a person of this scene, as the end of a sentence; "" when it is one."""
    least = min(limits.min_s * fps, 0.5 * frames)
    if len(group.frames) < least:
        return f"two cameras agree for {len(group.frames) / fps:.2f} s only, {least / fps:.2f} s are needed"
    # Where rays of three cameras meet for a while, a person is there, however many other cameras are blocked or face
    # another way. One after the other they count only where each agrees for long: at a low frame rate two that agree by
    # chance already do so for a while.
    needed = min(int(np.ceil(limits.camera_share * len(cameras))), _ENOUGH_CAMERAS)
    at_once = group.seen & (group.seen.sum(0) >= needed)
    seen_by = int(((at_once.sum(1) >= least / 2) | (group.seen.sum(1) >= _LONG * least)).sum())
    if seen_by < needed:
        return f"a bystander: {seen_by} of {len(cameras)} cameras see it, {needed} are needed"
    length = torso_m(group)
    if np.isfinite(length) and not limits.torso_m[0] <= length <= limits.torso_m[1]:
        return f"its torso would be {length:.2f} m long"
    return proportion_fault(group.points_m)


def supports(
    groups: Sequence[Group], cameras: Sequence[Camera], videos: Sequence[Path], fps: float, limits: EvidenceLimits
) -> tuple[Float[np.ndarray, "G V"], Float[np.ndarray, "G V 4"]]:
    """Share of the positions that every group's joints left or reached that changed in the pictures, NaN with too
    little motion.

    For all joints (G, V), and for each arm and leg (G, V, 4).
    """
    picked = [sampled_frames(group.frames, limits.frames) for group in groups]
    points_m = np.stack([group.points_m for group in groups])
    least = [steps_m(group.points_m, fps, limits) for group in groups]
    wanted = set(np.concatenate(picked).tolist())
    counts = np.zeros((len(groups), len(cameras), points_m.shape[2], 2), dtype=int)
    for v, camera in enumerate(progress(cameras, "cameras")):
        pictures = {t: picture for t, picture in enumerate(read_frames(videos[v], 0, max(wanted) + 1)) if t in wanted}
        for g, frames in enumerate(picked):
            counts[g, v] = motion_support(
                [pictures[t] for t in frames.tolist()], points_m[:, frames], g, least[g], camera, limits
            )
    return view_shares(counts.sum(2)), view_shares(limb_counts(counts))


def name_people(groups: Sequence[Group]) -> list[int]:
    """Order of the groups as p0, p1, …: by first frame seen by two cameras, then by duration, then by x."""
    return sorted(
        range(len(groups)),
        key=lambda i: (groups[i].frames[0], -len(groups[i].frames), float(np.nanmedian(groups[i].centres_m[:, 0]))),
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
    witnesses: Sequence[CameraEvidence | None] = (),
) -> tuple[dict[tuple[str, int], TrackVerdict], list[tuple[str, int, str, float, str]], list[RejectedPerson]]:
    """Verdicts for every (camera, track), the lines of people.tsv, and the rejected groups.

    Candidates are all groups on which the keypoints of two cameras or more agree. ``witnesses``: every camera's
    evidence other than its film, used for those that the pictures contradict.
    """
    groups = group_tracks(given, cameras, frames, fps, association, triangulation)
    margins = track_margins(groups, given, cameras, association)
    why = [judge(group, cameras, frames, fps, association) for group in groups]
    likely = [g for g, reason in zip(groups, why) if not reason]
    if likely and videos and evidence.frames:
        shares, limbs = supports(likely, cameras, videos, fps, evidence)
        described = [
            evidence_in_cameras(group, given, cameras, videos, witnesses, evidence) if gone else None
            for group, gone in zip(likely, absent_people(shares, limbs, evidence))
        ]
        contradicted = iter(_contradicted(shares, described, cameras, evidence))
        why = [reason or next(contradicted) for reason in why]
    why = _without_ghosts(groups, why, given, cameras, fps, triangulation)
    rejected = [(g, reason) for g, reason in zip(groups, why) if reason]
    for group, reason in rejected:
        say(f"not a person of this scene: {_tracks(group, cameras)}: {reason}")
    reasons = {m: reason for group, reason in rejected for m in group.members}
    kept = [g for g, reason in zip(groups, why) if not reason]
    kept = [kept[i] for i in name_people(kept)]
    nan = float("nan")
    alone = "no other camera agrees with it, or it fits two people equally well"
    table = {
        (d.camera, int(t)): TrackVerdict("", margins.get((v, int(t)), nan), nan, reasons.get((v, int(t)), alone))
        for v, d in enumerate(given)
        for t in np.unique(d.track)
    }
    rows = []
    for number, group in enumerate(kept):
        for v, t in group.members:
            near = margins[v, t] < association.undecided_margin
            doubt = f"undecided: it fits p{number} only {margins[v, t]:.2f} better than another person" if near else ""
            table[cameras[v].name, t] = TrackVerdict(f"p{number}", margins[v, t], float(group.agreement[v]), doubt)
            if doubt:
                say(f"{cameras[v].name}/{t} is {doubt}")
        seen_by = [c.name for c, seen in zip(cameras, np.any(group.seen, axis=1)) if seen]
        confidence = float(np.nanmean(group.agreement))
        rows.append((f"p{number}", len(group.frames), ",".join(seen_by), confidence, "keypoints"))
        say(
            f"p{number}: seen in {len(group.frames)} of {frames} frames by {', '.join(seen_by)}; "
            f"{confidence:.0%} of its keypoints agree, torso {torso_m(group):.2f} m"
        )
    nobodys = sum(not v.person for v in table.values())
    say(
        f"{len(rows)} people with keypoints; {nobodys} of {len(table)} tracks belong to no person"
        if table
        else "no people: no camera has a detection"
    )
    return table, rows, list_rejected([(g, r) for g, r in rejected if r != FOUND_TWICE], cameras, frames, fps)


def _without_ghosts(
    groups: Sequence[Group],
    why: Sequence[str],
    given: Sequence[Detections],
    cameras: Sequence[Camera],
    fps: float,
    agree: Limits,
) -> list[str]:
    """The reasons, with those of ``false_positives`` added; groups that most cameras see longest come first."""
    out, centres_m = list(why), np.array([c.centre_m for c in cameras])
    order = sorted(range(len(groups)), key=lambda i: (bool(why[i]), -int(groups[i].seen.sum()), groups[i].members))
    for n, i in enumerate(order):
        points_m = groups[i].points_m
        before = [groups[j].points_m for j in order[:n] if not out[j]]
        if why[i]:
            out[i] = FOUND_TWICE if any(is_duplicate(points_m, other) for other in before) else why[i]
            continue
        others = [g.points_m for j, g in enumerate(groups) if j != i and not why[j]]
        deep_m = deep_points_m(groups[i].members, given, cameras, len(points_m), agree)
        out[i] = rejection_reason(points_m, deep_m, before, others, centres_m, fps)
    return out


def _contradicted(
    shares: np.ndarray,
    described: Sequence[Sequence[ImageEvidence | None] | None],
    cameras: Sequence[Camera],
    limits: EvidenceLimits,
) -> list[str]:
    """A sentence per group on how pictures contradict its keypoints, from the shares (G, V) that changed; "" where they
    do not.

    They do not where ``described`` is None, or where the cameras' other evidence ``described`` confirms the person.
    """
    reasons = []
    for share, others in zip(shares, described):
        if others is None:
            reasons.append("")
            continue
        seen = ", ".join(f"{s:.0%} ({c.name})" for s, c in zip(share, cameras) if np.isfinite(s))
        reason = f"the pictures show no person there: of the pixels that its joints moved over only {seen} changed"
        by = [c.name for c, other in zip(cameras, others) if other is not None and other.confirms(limits)]
        if by:
            say(
                f"of the pixels that a person's joints moved over only {seen} changed; {', '.join(by)} confirm the "
                "person"
            )
        elif told_more := _nor([other for other in others if other is not None]):
            reason = f"{reason}, {told_more}"
        reasons.append("" if by else reason)
    if np.isfinite(shares).any() and not (np.nan_to_num(shares) >= limits.present_share).any():
        listed = ", ".join(f"{s:.0%}" for s in shares[np.isfinite(shares)])
        say(
            f"whether the pictures show these people is undetermined: only {listed} of the pixels that their joints "
            "moved over changed"
        )
    return reasons


def _nor(described: Sequence[ImageEvidence]) -> str:
    """The other evidence that fails to confirm a person, as the end of a sentence; "" without other evidence."""
    masks = max((one.covered for one in described if np.isfinite(one.covered)), default=float("nan"))
    plates = max((one.differs for one in described if np.isfinite(one.differs)), default=float("nan"))
    parts = [f"the detector's masks cover {masks:.0%}" * bool(np.isfinite(masks))]
    parts.append(f"{plates:.0%} differ from a clean plate" * bool(np.isfinite(plates)))
    return " and ".join(part for part in parts if part)


def _tracks(group: Group, cameras: Sequence[Camera]) -> str:
    return "tracks " + ", ".join(f"{cameras[v].name}/{t}" for v, t in group.members)
