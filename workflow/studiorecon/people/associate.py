# SPDX-License-Identifier: Apache-2.0
"""``people.associate``: which tracks of which cameras are the same person, and who is a person of this scene at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.errors import Refusal
from studiorecon.geometry.smoothing import Smoothing
from studiorecon.people import fit
from studiorecon.people.affinity import AssociationLimits
from studiorecon.people.corrected import read_corrected, rows_of
from studiorecon.people.evidence import EvidenceLimits
from studiorecon.people.foreground import open_view
from studiorecon.people.left_out import LeftOut, tell
from studiorecon.people.points import Triangulation, lift, observations
from studiorecon.people.standing import HullSettings, Standing, find_standing, write_standing
from studiorecon.people.verdicts import Verdict, identities_from_keypoints
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections, usable, write_identities, write_people


@dataclass(frozen=True)
class Settings:
    """Limits of agreement, of association and of the pictures' say; ``fit``, ``smooth`` and ``hull`` for people without keypoints."""

    triangulation: Triangulation
    association: AssociationLimits
    evidence: EvidenceLimits
    fit: fit.BodyFit
    smooth: Smoothing
    hull: HullSettings


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
    association: Path,
    who: Path,
) -> None:
    """Write ``people`` (people.tsv, in order of appearance) and ``identities`` (camera, track → person, empty = rejected).

    ``association`` (json) says why, per track, for the identity desk. The folder ``who`` has two files per person, so that a change of
    one person's tracks is no change of another's: <person>.tsv, that person's lines of ``identities``, and <person>.npz, the
    silhouettes of somebody without keypoints (empty for others).
    ``plates`` are those of the cameras ``plated``, whose clean plates the user brought (may be none): people who stand out from them
    and have no keypoints follow those who do, with their silhouettes there. ``corrected`` is the user's own
    identities.tsv, or nothing: it is taken as it stands.
    """
    cameras, found = read_model(model.parent), read_manifest(manifest)
    given: Sequence[Detections] = [read_detections(p) for p in detections] or [_nobody(c.name) for c in cameras]
    if not detections:
        say("no camera has keypoints: people are looked for in the visual hull alone, if plates were brought")
    given, unusable = zip(*(usable(d) for d in given))
    if sum(unusable):
        say(f"{sum(unusable)} keypoints are not finite or at exactly (0, 0), and were left out")
    if [d.camera for d in given] != [c.name for c in cameras]:
        raise Refusal(
            f"detections are of {[d.camera for d in given]}, the model has {[c.name for c in cameras]}; delete results and run again"
        )
    missed: list[LeftOut] = []
    if corrected:
        table = read_corrected(corrected[0], given)
        rows = rows_of(table, given)
        verdicts = {key: Verdict(person, float("nan"), float("nan"), "" if person else "left out by hand") for key, person in table.items()}
        say(f"{len(rows)} people as corrected in {corrected[0]}")
    else:
        limits = settings.association, settings.triangulation, settings.evidence
        verdicts, rows, missed = identities_from_keypoints(*limits, cameras, given, videos, found.frames, found.fps)
        table = {key: verdict.person for key, verdict in verdicts.items()}
    upright: list[Standing] = []
    if settings.hull.use == "auto" and len(plates) >= settings.hull.limits.cameras:
        upright = _without_keypoints(settings, cameras, given, table, [row[0] for row in rows], videos, plated, plates, body, found)
        rows += [(p.name, len(p.frames), ",".join(p.seen_by), p.start.agreement, "hull") for p in upright]
        if not upright:
            say("nobody without keypoints stands out from the given plates")
    if not rows and not any(len(d.frame) for d in given):
        warn(
            f"nobody was found in any camera: {found.frames} frames each of {', '.join(d.camera for d in given)} were looked at; if "
            "somebody is there, bring keypoints of another detector; write people: 0 into capture.yaml if the room is empty"
        )
    write_people(people, rows, [one.row() for one in missed])
    write_identities(identities, table)
    newcomer = f"p{max((int(row[0][1:]) for row in rows), default=-1) + 1}"
    told = [{"name": one.name, "reason": one.reason, "tracks": one.tracks, "lines": one.lines(newcomer)} for one in missed]
    write_json(association, _as_json(verdicts, given, bool(corrected)) | {"unusable_keypoints": sum(unusable), "left_out": told})
    # Also where nobody is.
    who.mkdir(parents=True, exist_ok=True)
    for name, *_ in rows:
        write_identities(who / f"{name}.tsv", {key: person for key, person in table.items() if person == name})
        write_standing(who / f"{name}.npz", [p for p in upright if p.name == name])
    tell(missed, newcomer)


def _nobody(camera: str) -> Detections:
    """The detections of a camera that has none."""
    return Detections(camera, "body_25", np.zeros(0, int), np.zeros(0, int), np.zeros((0, 25, 3)))


def _as_json(verdicts: dict[tuple[str, int], Verdict], given: Sequence[Detections], corrected: bool) -> dict[str, Any]:
    """What the identity desk shows of every track: whose it is and why, when it is seen, how sure that is."""
    tracks = []
    for d in given:
        for t in np.unique(d.track):
            frames = d.frame[d.track == t]
            about = {"camera": d.camera, "track": int(t), "first": int(frames.min()), "last": int(frames.max()), "detections": len(frames)}
            tracks.append(about | asdict(verdicts[d.camera, int(t)]))
    return {"corrected": corrected, "tracks": tracks}


def _without_keypoints(
    settings: Settings,
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
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
        keypoint_names, keypoints = observations(name, list(detections), identities, model, manifest.frames)
        points = lift(keypoint_names, keypoints, list(cameras), settings.triangulation, settings.fit.unverified_sigma_m)
        try:
            known.append(fit.fit_person(name, points, model, manifest.fps, options)[0])
        except Refusal as refusal:
            warn(f"people without keypoints are not looked for: {refusal}")
            return []
    by_name = {c.name: (c, video) for c, video in zip(cameras, videos)}
    views = [open_view(*by_name[name], plate, settings.hull.foreground) for name, plate in zip(plated, plates)]
    return find_standing(views, known, model, manifest.frames, manifest.fps, settings.hull)
