# SPDX-License-Identifier: Apache-2.0
"""Identities that the user corrected: the person of every track, used unchanged."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.people import Detections, read_given_identities, split_tracks, track_text

_PERSON = re.compile(r"p\d+")


def read_corrected_identities(path: Path, detections: Sequence[Detections]) -> dict[tuple[str, int], str]:
    """(camera, track) → person for every detected track; tracks that the file leaves out have no person.

    Raises UserError, naming the line's camera and track, for a track that does not exist, a person that is not called
    p0, p1, …, or one who is in fewer than two cameras.
    """
    given = read_given_identities(path)
    tracks = {(d.camera, int(t)) for d in detections for t in np.unique(split_tracks(d, given).track)}
    for (camera, track), person in given.items():
        if (camera, track) not in tracks:
            raise UserError(
                f"{path} names track {track_text(track)} of camera {camera}, which was not "
                "detected; start from people/identities.tsv"
            )
        if person and not _PERSON.fullmatch(person):
            raise UserError(
                f"{path} calls track {track_text(track)} of camera {camera} {person!r}; people are called p0, p1, … "
                "(empty = no person)"
            )
    for person in sorted({p for p in given.values() if p}):
        cameras = {camera for (camera, _), p in given.items() if p == person}
        if len(cameras) < 2:
            raise UserError(
                f"{path} gives {person} tracks of camera {cameras.pop()} only; a body needs two cameras at least"
            )
    return dict.fromkeys(sorted(tracks), "") | given


def people_table_rows(
    identities: Mapping[tuple[str, int], str], detections: Sequence[Detections]
) -> list[tuple[str, int, str, float, str]]:
    """Lines of ``people.tsv`` (person, frames seen, cameras, confidence 1, source) of corrected identities, in order of
    their numbers."""
    rows = []
    for person in sorted({p for p in identities.values() if p}, key=lambda p: int(p[1:])):
        frames: set[int] = set()
        cameras = []
        for found in detections:
            tracks = [track for (camera, track), p in identities.items() if p == person and camera == found.camera]
            shown = found.frame[np.isin(found.track, tracks)]
            if len(shown):
                cameras.append(found.camera)
                frames |= set(shown.tolist())
        rows.append((person, len(frames), ",".join(cameras), 1.0, "corrected"))
    return rows
