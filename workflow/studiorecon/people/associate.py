# SPDX-License-Identifier: Apache-2.0
"""``people.associate``: which tracks of which cameras are the same person, and who is a person of this scene at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.errors import Refusal
from studiorecon.geometry.smoothing import Smoothing
from studiorecon.geometry.triangulation import Limits
from studiorecon.images.video import read_frames
from studiorecon.people import fit
from studiorecon.people.affinity import AssociationLimits
from studiorecon.people.corrected import read_corrected, rows_of
from studiorecon.people.evidence import EvidenceLimits, absent, motion_support, person_share, sampled_frames
from studiorecon.people.foreground import open_view
from studiorecon.people.grouping import Group, group_tracks, torso_m
from studiorecon.people.standing import HullSettings, Standing, find_standing, write_standing
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.people import Detections, read_detections, write_identities, write_people


@dataclass(frozen=True)
class Settings:
    """Limits of agreement, of association and of the pictures' say; ``fit``, ``smooth`` and ``hull`` for people without keypoints."""

    triangulation: Limits
    association: AssociationLimits
    evidence: EvidenceLimits
    fit: fit.BodyFit
    smooth: Smoothing
    hull: HullSettings


def judge(group: Group, cameras: Sequence[Camera], frames: int, limits: AssociationLimits) -> str | None:
    """Why a group is not a person of this scene, as the end of a sentence; None when it is one."""
    seen_by = int(group.seen.any(1).sum())
    needed = int(np.ceil(limits.camera_share * len(cameras)))
    least = max(limits.least_frames, int(np.ceil(limits.least_share * frames)))
    if len(group.frames) < least:
        return f"two cameras agree in {len(group.frames)} frames only, {least} are needed"
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


def run(
    settings: Settings,
    model: Path,
    manifest: Path,
    detections: list[Path],
    videos: list[Path],
    plated: list[str],
    plates: list[Path],
    body: Path,
    corrected: list[Path],
    people: Path,
    identities: Path,
    standing: Path,
) -> None:
    """Write ``people`` (people.tsv, in order of appearance), ``identities`` (camera, track → person, empty = rejected) and ``standing``.

    ``plates`` are those of the cameras ``plated``, whose clean plates the user brought (may be none): people who stand out from them
    and have no keypoints follow those who do, with their silhouettes in ``standing`` (npz). ``corrected`` is the user's own
    identities.tsv, or nothing: it is taken as it stands.
    """
    cameras, found = read_model(model.parent), read_manifest(manifest)
    given = [read_detections(p) for p in detections]
    if [d.camera for d in given] != [c.name for c in cameras]:
        raise Refusal(
            f"detections are of {[d.camera for d in given]}, the model has {[c.name for c in cameras]}; delete results and run again"
        )
    if corrected:
        table = read_corrected(corrected[0], given)
        rows = rows_of(table, given)
        say(f"{len(rows)} people as corrected in {corrected[0]}")
    else:
        table, rows = identities_from_keypoints(settings, cameras, given, videos, found.frames, found.fps)
    upright: list[Standing] = []
    if settings.hull.use == "auto" and len(plates) >= settings.hull.limits.cameras:
        upright = _without_keypoints(settings, cameras, given, table, [row[0] for row in rows], videos, plated, plates, body, found)
        rows += [(p.name, len(p.frames), ",".join(p.seen_by), p.start.agreement, "hull") for p in upright]
        if not upright:
            say("nobody without keypoints stands out from the given plates")
    write_people(people, rows)
    write_identities(identities, table)
    write_standing(standing, upright)


def identities_from_keypoints(
    settings: Settings, cameras: Sequence[Camera], given: list[Detections], videos: list[Path], frames: int, fps: float
) -> tuple[dict[tuple[str, int], str], list[tuple[str, int, str, float, str]]]:
    """(camera, track) → person, and the lines of people.tsv, of everybody the keypoints of two cameras or more agree on."""
    groups = group_tracks(given, cameras, frames, fps, settings.association, settings.triangulation)
    kept = []
    for group in groups:
        reason = judge(group, cameras, frames, settings.association)
        if reason is None:
            kept.append(group)
        else:
            say(f"not a person of this scene: {_tracks(group, cameras)}: {reason}")
    if kept and videos and settings.evidence.frames:
        kept = _confirmed(kept, supports(kept, given, videos, settings.evidence), cameras, settings.evidence)
    kept = [kept[i] for i in name_people(kept)]
    table = {(d.camera, int(t)): "" for d in given for t in np.unique(d.track)}
    rows = []
    for number, group in enumerate(kept):
        table |= {(cameras[v].name, t): f"p{number}" for v, t in group.members}
        seen_by = [c.name for c, seen in zip(cameras, group.seen.any(1)) if seen]
        confidence = float(np.nanmean(group.agreement))
        rows.append((f"p{number}", len(group.frames), ",".join(seen_by), confidence, "keypoints"))
        say(
            f"p{number}: seen in {len(group.frames)} of {frames} frames by {', '.join(seen_by)}; "
            f"{confidence:.0%} of its keypoints agree, torso {torso_m(group):.2f} m"
        )
    rejected = sum(not person for person in table.values())
    say(
        f"{len(rows)} people with keypoints; {rejected} of {len(table)} tracks belong to nobody"
        if table
        else "no people: no camera has a detection"
    )
    return table, rows


def _without_keypoints(
    settings: Settings,
    cameras: Sequence[Camera],
    detections: list[Detections],
    identities: dict[tuple[str, int], str],
    names: list[str],
    videos: list[Path],
    plated: list[str],
    plates: list[Path],
    body: Path,
    manifest: Manifest,
) -> list[Standing]:
    """People who stand out from the given plates beside those with keypoints, whose bodies are fitted first to be told apart."""
    model = BodyModel.load(body)
    options = fit.Settings(settings.triangulation, settings.fit, settings.smooth, settings.hull)
    known = []
    for name in names:
        keypoint_names, keypoints = fit.observations(name, detections, identities, model, manifest.frames)
        points = fit.lift(keypoint_names, keypoints, list(cameras), options)
        try:
            known.append(fit.fit_person(name, points, model, manifest.fps, options)[0])
        except Refusal as refusal:
            say(f"people without keypoints are not looked for: {refusal}")
            return []
    by_name = {c.name: (c, video) for c, video in zip(cameras, videos)}
    views = [open_view(*by_name[name], plate, settings.hull.foreground) for name, plate in zip(plated, plates)]
    return find_standing(views, known, model, manifest.frames, manifest.fps, settings.hull)


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
