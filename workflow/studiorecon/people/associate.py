# SPDX-License-Identifier: Apache-2.0
"""``people.associate``: which tracks of which cameras are the same person, and who is a person of this scene at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.people.association.acceptance import TrackVerdict, identities_from_keypoints
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.corrected import read_corrected, rows_of
from studiorecon.people.association.evidence import EvidenceLimits
from studiorecon.people.association.left_out import LeftOut, tell
from studiorecon.people.shared import Triangulated
from studiorecon.progress import say, warn
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections, usable, write_identities, write_people
from studiorecon.signature import Written


@dataclass(frozen=True)
class Settings(Triangulated):
    """Limits of agreement, of association and of the pictures' say."""

    association: AssociationLimits = setting(
        AssociationLimits(), "Which tracks of different cameras are one person, and who counts as one."
    )
    evidence: EvidenceLimits = EvidenceLimits()


def run(
    settings: Settings,
    model: Path,
    manifest: Path,
    detections: list[Path],
    videos: list[Path],
    corrected: list[Path],
    people: Written,
    identities: Written,
    association: Written,
    who: Written,
) -> None:
    """Write ``people`` (people.tsv, in order of appearance) and ``identities`` (camera, track → person, empty =
    rejected).

    ``association`` (json) says why, per track, for the identity page. The folder ``who`` has a file per person, so that
    a change of one person's tracks is no change of another's: <person>.tsv, that person's lines of ``identities``.
    ``corrected`` is the user's own identities.tsv, or nothing: it is taken as it stands.
    """
    cameras, found = read_model(model.parent), read_manifest(manifest)
    given: Sequence[Detections] = [read_detections(p) for p in detections] or [_nobody(c.name) for c in cameras]
    if not detections:
        say("no camera has keypoints: people are looked for in the visual hull alone")
    given, unusable = zip(*(usable(d) for d in given))
    if sum(unusable):
        say(f"{sum(unusable)} keypoints are not finite or at exactly (0, 0), and were left out")
    if [d.camera for d in given] != [c.name for c in cameras]:
        raise UserError(
            f"detections are of {[d.camera for d in given]}, the model has "
            f"{[c.name for c in cameras]}; delete results and run again"
        )
    missed: list[LeftOut] = []
    if corrected:
        table = read_corrected(corrected[0], given)
        rows = rows_of(table, given)
        verdicts = {
            key: TrackVerdict(person, float("nan"), float("nan"), "" if person else "left out by hand")
            for key, person in table.items()
        }
        say(f"{len(rows)} people as corrected in {corrected[0]}")
    else:
        limits = settings.association, settings.triangulation, settings.evidence
        verdicts, rows, missed = identities_from_keypoints(*limits, cameras, given, videos, found.frames, found.fps)
        table = {key: verdict.person for key, verdict in verdicts.items()}
    if detections and not rows and not any(len(d.frame) for d in given):
        warn(
            f"nobody was found in any camera: {found.frames} frames each of "
            f"{', '.join(d.camera for d in given)} were looked at; if "
            "somebody is there, bring keypoints of another detector; write people: 0 "
            "into capture.yaml if the room is empty"
        )
    elif detections and not rows and not missed:
        # Who was left out with a name is told below.
        reasons = Counter(verdict.reason for verdict in verdicts.values())
        warn(
            f"nobody of this scene was found: {sum(len(d.frame) for d in given)} detections in {len(verdicts)} "
            f"tracks of {', '.join(d.camera for d in given)} belong to no person, most because "
            f"{reasons.most_common(1)[0][0]}; bring a longer clip, or keypoints of all its frames"
        )
    write_people(people, rows, [one.row() for one in missed])
    write_identities(identities, table)
    newcomer = f"p{max((int(row[0][1:]) for row in rows), default=-1) + 1}"
    told = [
        {"name": one.name, "reason": one.reason, "tracks": one.tracks, "lines": one.lines(newcomer)} for one in missed
    ]
    write_json(
        association,
        _as_json(verdicts, given, bool(corrected)) | {"unusable_keypoints": sum(unusable), "left_out": told},
    )
    # Also where nobody is.
    who.mkdir(parents=True, exist_ok=True)
    for name, *_ in rows:
        write_identities(who / f"{name}.tsv", {key: person for key, person in table.items() if person == name})
    tell(missed, newcomer)


def _nobody(camera: str) -> Detections:
    """The detections of a camera that has none."""
    return Detections(camera, "body_25", np.zeros(0, int), np.zeros(0, int), np.zeros((0, 25, 3)))


def _as_json(
    verdicts: dict[tuple[str, int], TrackVerdict], given: Sequence[Detections], corrected: bool
) -> dict[str, Any]:
    """What the identity page shows of every track: whose it is and why, when it is seen, how sure that is."""
    tracks = []
    for d in given:
        for t in np.unique(d.track):
            frames = d.frame[d.track == t]
            about = {
                "camera": d.camera,
                "track": int(t),
                "first": int(frames.min()),
                "last": int(frames.max()),
                "detections": len(frames),
            }
            tracks.append(about | asdict(verdicts[d.camera, int(t)]))
    return {"corrected": corrected, "tracks": tracks}
