# SPDX-License-Identifier: Apache-2.0
"""``detect.keypoints``: recorded 2D keypoints of one camera in pixels of its video, followed through time, before any
calibration."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.geometry.lens import mapped_lens
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.readers import KeypointEntry, read_keypoints
from studiorecon.keypoints.reading import Settings, detections_of, detections_of_found
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.raw_detections import is_found, read_raw_detections
from studiorecon.signature import Written


def run(
    settings: Settings,
    camera: str,
    keypoints: list[Path],
    layout: str,
    first_frame: int,
    source: Path,
    picture_fps: float,
    pixel_map: str,
    sightings: Written,
    size: Written,
) -> None:
    """Write the tracks of ``camera``, by the frames of its footage, to ``sightings`` (npz) and the video's size to
    ``size`` (JSON).

    ``picture_fps`` is the rate of a folder of pictures; ``pixel_map`` (JSON): [scale, x, y] of ``Dataset.pixel_maps``,
    or []. ``keypoints`` are one file or folder, or one for every chapter of ``source``, each counted from
    ``first_frame`` on.
    """
    try:
        filmed = open_source(source, picture_fps)
    except UserError as refusal:
        # Decoding refuses it by name; the other cameras' clocks do not wait for that.
        warn(f"camera {camera}: {refusal}; until then it sees nobody")
        _write_nobody(camera, (0, 0), pixel_map, sightings, size)
        return
    wh = filmed.wh
    if is_found(keypoints[0]):
        whole = read_raw_detections(keypoints[0])
        about = {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)}
        found = detections_of_found(whole, *_as_filmed(camera, filmed, sum(whole.looked), pixel_map), settings)
        say(f"camera {camera}: {len(found.frame)} sightings ({whole.note}), {len(np.unique(found.track))} tracks")
        write_detections(sightings, found)
        write_json(size, about)
        return
    entries, kind = _of_chapters(keypoints, filmed)
    where = ", ".join(map(str, keypoints))
    if not entries:
        say(f"{where} ({kind}) holds no person: camera {camera} sees nobody")
        _write_nobody(camera, wh, pixel_map, sightings, size)
        return
    frames = max(e.frame for e in entries) - first_frame + 1
    if frames < 2:
        raise UserError(
            f"{where}: no detection belongs to a frame of camera {camera}; set keypoint_first_frame in capture.yaml"
        )
    chosen, note = choose_layout(np.stack([e.keypoints for e in entries]), layout, where)
    if note:
        say(note)
    lens, footage = _as_filmed(camera, filmed, frames, pixel_map)
    found = detections_of(entries, chosen, lens, footage, first_frame, settings)
    say(f"camera {camera}: {len(found.frame)} sightings ({kind}, {chosen}), {len(np.unique(found.track))} tracks")
    write_detections(sightings, found)
    write_json(size, {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)})


def _of_chapters(keypoints: list[Path], filmed: FootageSource) -> tuple[list[KeypointEntry], str]:
    """What ``read_keypoints`` gives of all files, by the frames of the whole film."""
    found: list[KeypointEntry] = []
    before = 0
    for path, film in zip(keypoints, filmed.parts if len(keypoints) > 1 else [filmed], strict=True):
        entries, kind = read_keypoints(path, filmed.wh)
        found += [replace(entry, frame=entry.frame + before) for entry in entries]
        before += film.frames
    return found, kind


def _write_nobody(camera: str, wh: tuple[int, int], pixel_map: str, sightings: Path, size: Path) -> None:
    nobody = np.zeros(0, dtype=np.int64)
    write_detections(sightings, Detections(camera, "coco17", nobody, nobody, np.zeros((0, 17, 3))))
    write_json(size, {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)})


def _as_filmed(camera: str, filmed: FootageSource, frames: int, pixel_map: str) -> tuple[Lens, Footage]:
    """Lens and footage whose working pixels are the video's own: a pinhole of any focal length maps them onto
    themselves."""
    wh = filmed.wh
    intrinsics = np.array([[max(wh), 0, wh[0] / 2], [0, max(wh), wh[1] / 2], [0, 0, 1.0]])
    lens = mapped_lens(
        Lens(camera, wh, intrinsics, "opencv", np.zeros(8), np.eye(4), np.eye(2, 3)), json.loads(pixel_map)
    )
    return lens, Footage(
        camera, False, wh, intrinsics.tolist(), filmed.fps, frames, 0, filmed.path.name, "", wh, 0, 0.0, []
    )
