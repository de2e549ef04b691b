# SPDX-License-Identifier: Apache-2.0
"""``people.associate``: groups the cameras' tracks into persons, and decides which groups are people of this scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.camera_files.calibration import find_lens
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.people.association.acceptance import TrackVerdict, identities_from_keypoints
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.rejected_people import RejectedPerson, report_rejected
from studiorecon.people.corrected_identities import people_table_rows, read_corrected_identities
from studiorecon.people.fit_settings import TriangulationSettings
from studiorecon.people.fitting.readouts import estimate_readouts
from studiorecon.people.pictures.coverage import CameraEvidence
from studiorecon.progress import say, warn
from studiorecon.rig.body_points import person_tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.files import write_json
from studiorecon.scene.people import (
    Detections,
    read_detections,
    split_tracks,
    whole_track,
    write_identities,
    write_people,
)
from studiorecon.scene.readouts import Readout, write_readouts
from studiorecon.scene.step_files import require
from studiorecon.signature import Written

# Less confident keypoints only cost time where readouts are estimated.
_SURE = 0.3


@dataclass(frozen=True)
class Settings(TriangulationSettings):
    """Limits of agreement and of association."""

    association: AssociationLimits = setting(
        AssociationLimits(), "Which tracks of different cameras are one person, and who counts as one."
    )


@dataclass(frozen=True)
class WitnessFiles:
    """Files of a camera beside its film, <camera>.npz or .png where they exist: the detector's files ``found`` with
    masks, and clean ``plates``; ``calibration`` gives the frames of the footage with people."""

    calibration: Path | None = None
    found: list[Path] = field(default_factory=list)
    plates: list[Path] = field(default_factory=list)

    def of(self, cameras: Sequence[Camera], footage: Manifest) -> list[CameraEvidence | None]:
        """Evidence of every camera; None where there is none."""
        masks, pictures = ({path.stem: path for path in paths} for paths in (self.found, self.plates))
        return [
            CameraEvidence(
                find_lens(self.calibration, c.name), footage.of(c.name), masks.get(c.name), pictures.get(c.name)
            )
            if self.calibration and (c.name in masks or c.name in pictures)
            else None
            for c in cameras
        ]


@dataclass(frozen=True)
class Associated:
    """Persons of all tracks.

    Attributes:
        verdicts: (camera, track) → person and reason.
        rows: of people.tsv.
        missed: people who were left out.
    """

    verdicts: dict[tuple[str, int], TrackVerdict]
    rows: list[tuple]
    missed: list[RejectedPerson]

    @property
    def table(self) -> dict[tuple[str, int], str]:
        """(camera, track) → person; empty = rejected."""
        return {key: verdict.person for key, verdict in self.verdicts.items()}


def associate_as_corrected(path: Path, given: Sequence[Detections]) -> Associated:
    """Persons of all tracks by the user's own table, unchanged."""
    table = read_corrected_identities(path, given)
    rows = people_table_rows(table, [split_tracks(d, table) for d in given])
    say(f"{len(rows)} people as corrected in {path}")
    verdicts = {
        key: TrackVerdict(person, float("nan"), "" if person else "left out by hand") for key, person in table.items()
    }
    return Associated(verdicts, rows, [])


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
    witnesses: WitnessFiles = WitnessFiles(),
) -> None:
    """Write ``people`` (people.tsv, in order of appearance) and ``identities`` (camera, track → person, empty =
    rejected).

    ``association`` (json) holds the reasons per track, for the identity page. The folder ``who`` has a file per person,
    so that a change of one person's tracks does not affect another's: <person>.tsv, that person's lines of
    ``identities``; and readouts.json, every camera's readout. ``corrected`` is the user's own identities.tsv, or
    nothing: it is used unchanged. ``witnesses`` confirm people who change no picture.
    """
    cameras, footage = read_model(model.parent), read_manifest(manifest)
    given = _read_of_all(detections, cameras)
    if corrected:
        found = associate_as_corrected(corrected[0], given)
    else:
        evidence = witnesses.of(cameras, footage)
        limits, (frames, fps) = (settings.association, settings.triangulation), (footage.frames, footage.fps)
        found = Associated(*identities_from_keypoints(*limits, cameras, given, videos, frames, fps, evidence))
    given = [split_tracks(d, found.table) for d in given]
    _warn_of_nobody(found, given, footage)
    rows_look = _readouts(given, found.table, cameras, footage)
    newcomer = f"p{max((int(row[0][1:]) for row in found.rows), default=-1) + 1}"
    write_people(people, found.rows, [one.row() for one in found.missed])
    write_identities(identities, found.table)
    why = _as_json(found.verdicts, given, bool(corrected)) | {
        "left_out": [one.as_json(newcomer) for one in found.missed],
        "readouts": [asdict(one) for one in rows_look],
    }
    write_json(association, why)
    # Also without people.
    who.mkdir(parents=True, exist_ok=True)
    for name, *_ in found.rows:
        write_identities(who / f"{name}.tsv", _lines_of(name, found.table))
    write_readouts(who / "readouts.json", rows_look)
    report_rejected(found.missed, newcomer)


def _lines_of(name: str, table: Mapping[tuple[str, int], str]) -> dict[tuple[str, int], str]:
    """One person's lines of the table, with all parts of tracks that were cut."""
    tracks = {(camera, whole_track(track)) for (camera, track), person in table.items() if person == name}
    parts = {key for key in table if key[1] != whole_track(key[1]) and (key[0], whole_track(key[1])) in tracks}
    return {key: person for key, person in table.items() if person == name or key in parts}


def _read_of_all(paths: Sequence[Path], cameras: Sequence[Camera]) -> list[Detections]:
    """Detections of every camera, in the order of ``cameras``."""
    given = [read_detections(path) for path in paths]
    for path, one, camera in zip(paths, given, cameras, strict=True):
        require(path, one.camera == camera.name, f"it is of {one.camera}, not {camera.name}")
    return given


def _warn_of_nobody(found: Associated, given: Sequence[Detections], footage: Manifest) -> None:
    if found.rows:
        return
    cameras, detections = ", ".join(d.camera for d in given), sum(len(d.frame) for d in given)
    if not detections:
        warn(
            f"no camera has a detection in {footage.frames} frames ({cameras}); if somebody is there, bring "
            "keypoints of another detector; if the room is empty, write people: 0 into capture.yaml"
        )
    elif not found.missed:  # ``report_rejected`` names the others
        reasons = Counter(verdict.reason for verdict in found.verdicts.values())
        warn(
            f"no person was identified: {detections} detections in {len(found.verdicts)} tracks of {cameras} were "
            f"rejected, most because {reasons.most_common(1)[0][0]}; let a person walk in view of two cameras, "
            "bring a longer clip, or keypoints of all its frames"
        )


def _readouts(
    given: Sequence[Detections], whose: Mapping[tuple[str, int], str], cameras: Sequence[Camera], footage: Manifest
) -> list[Readout]:
    """Every camera's readout, from the keypoints of all identified people; those in use are logged."""
    people = sorted({person for person in whose.values() if person})
    seen = person_tracks(given, whose, people, footage.frames, _SURE)
    found = estimate_readouts(seen.pixels, cameras, footage.fps)
    for one in found:
        if one.used_s:
            say(
                f"{one.camera} has a rolling shutter of {1000 * one.used_s:.1f} ± {1000 * (one.sigma_s or 0):.1f} "
                "ms, which is corrected in its keypoints"
            )
    return found


def _as_json(
    verdicts: dict[tuple[str, int], TrackVerdict], given: Sequence[Detections], corrected: bool
) -> dict[str, Any]:
    """The identity page's data of every track: its person with the reason, its frames, its confidence."""
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
