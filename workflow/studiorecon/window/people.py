# SPDX-License-Identifier: Apache-2.0
"""Who is who, for correcting it by clicks: tracks with their boxes, small films of the cameras, and identities.tsv."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames, write_watchable
from studiorecon.people.corrected_identities import read_corrected_identities
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.capture_yaml import path_under, read_description
from studiorecon.scene.files import atomic_path
from studiorecon.scene.people import (
    Detections,
    read_detections,
    read_identities,
    split_tracks,
    track_number,
    track_text,
    whole_track,
    write_identities,
)
from studiorecon.scene.reports import read_association
from studiorecon.window.projects import find_project

if TYPE_CHECKING:
    from jaxtyping import Integer

# Four films side by side fill a screen of 1440 pixels.
_FILM_PX = 640
_encoding = threading.Lock()


def read_tracks(name: str) -> dict[str, Any]:
    """``tracks`` of the scene's association, and ``cameras`` with each whole track's boxes, by frame, in pixels."""
    results = Path("results") / name
    manifest = read_manifest(results / "capture/manifest.json")
    tracks = read_association(results / "people/association.json")["tracks"]
    whose, cameras = read_identities(results / "people/identities.tsv"), []
    for found in (split_tracks(one, whose) for one in _detections(name)):
        frame = next(read_frames(results / "capture" / f"{found.camera}.mkv", 0, 1))
        boxes: dict[str, list[list[int]]] = {}
        for frame_number, track, box in zip(found.frame, found.track, _boxes(found)):
            boxes.setdefault(track_text(whole_track(int(track))), []).append([int(frame_number), *map(int, box)])
        cameras.append({"name": found.camera, "wh": [frame.shape[1], frame.shape[0]], "boxes": boxes})
    named = [{**track, "track": track_text(track["track"])} for track in tracks]
    return {"fps": manifest.fps, "frames": manifest.frames, "tracks": named, "cameras": cameras}


def _detections(name: str) -> list[Detections]:
    """The detections that the association of a scene is about: of the second look where there was one."""
    results = Path("results") / name
    seen = {track["camera"] for track in read_association(results / "people/association.json")["tracks"]}
    files = [(results / "people/detections" / f"{c}.npz", results / "tracks" / f"{c}.npz") for c in sorted(seen)]
    return [read_detections(second if second.is_file() else first) for second, first in files]


def _boxes(found: Detections) -> Integer[np.ndarray, "D 4"]:
    """Left, top, right and bottom of every detection, with a tenth of its size around the keypoints."""
    there = found.keypoints[..., 2:] > 0
    low = np.where(there, found.keypoints[..., :2], np.inf).min(axis=1)
    high = np.where(there, found.keypoints[..., :2], -np.inf).max(axis=1)
    margin = 0.1 * (high - low)
    corners = np.concatenate([low - margin, high + margin], axis=1)
    return np.where(np.isfinite(corners), corners, 0).round().astype(int)


def camera_film(name: str, camera: str) -> Path:
    """A small film of one camera's working pictures that browsers play; made once, and again after a new capture."""
    source = Path("results") / name / "capture" / f"{camera}.mkv"
    if not source.is_file():
        raise UserError(f"{name} has no pictures of camera {camera} yet; make the film first")
    film = Path(".snakemake/window/films") / name / f"{camera}.mp4"
    with _encoding:
        if not film.is_file() or film.stat().st_mtime < source.stat().st_mtime:
            fps = read_manifest(source.with_name("manifest.json")).fps
            with atomic_path(film) as partial:
                write_watchable(partial, _small(read_frames(source)), fps, crf=24)
    return film


def _small(frames: Iterator[Integer[np.ndarray, "H W 3"]]) -> Iterator[Integer[np.ndarray, "h w 3"]]:
    for frame in frames:
        scale = min(1.0, _FILM_PX / frame.shape[1])
        yield cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else frame


def save_identities(name: str, rows: Sequence[tuple[str, str, str]]) -> str:
    """The file of corrected identities, (camera, track, person) for every track, that the next run will read.

    Raises UserError, and leaves the file, where a person is in one camera only, or a track is no longer there.
    """
    folder = find_project(name)
    if not folder.is_dir():
        raise UserError(f"the capture of {name} is not in this folder, so that it cannot be run again here")
    file = folder / (path_under(read_description(folder, None), "identities") or "identities.tsv")
    tried = file.with_name(f".tried-{file.name}")
    try:
        numbered = {(str(camera), track_number(str(track))): str(person) for camera, track, person in rows}
        write_identities(
            tried, {(camera, track): who for (camera, track), who in numbered.items() if track is not None}
        )
        read_corrected_identities(tried, _detections(name))
        tried.replace(file)
    except UserError as refusal:
        raise UserError(str(refusal).replace(str(tried), "the correction")) from None
    finally:
        tried.unlink(missing_ok=True)
    return file.as_posix()
