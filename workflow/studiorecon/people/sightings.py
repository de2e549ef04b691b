# SPDX-License-Identifier: Apache-2.0
"""``people.sightings``: recorded 2D keypoints of one camera in pixels of its video, followed through time, before any calibration."""

from __future__ import annotations

import json
from pathlib import Path

import av
import cv2
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.geometry.lens import mapped_lens
from studiorecon.people.detections import Settings, detections_of, detections_of_found
from studiorecon.people.layout_choice import choose_layout
from studiorecon.people.readers import read_keypoints
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.dataset import PICTURE_SUFFIXES
from studiorecon.scene.files import write_json
from studiorecon.scene.found import is_found, read_found
from studiorecon.scene.people import Detections, write_detections


def picture_wh(source: Path) -> tuple[int, int]:
    """Width and height of a video's frames, its rotation tag applied, or of the first picture of a folder."""
    if source.is_dir():
        first = min((p for p in source.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith(".")), default=None)
        picture = cv2.imread(str(first)) if first else None
        if picture is None:
            raise Refusal(f"{source} holds no readable picture")
        return picture.shape[1], picture.shape[0]
    try:
        with av.open(str(source)) as container:
            frame = next(container.decode(container.streams.video[0]), None)
    except (av.FFmpegError, IndexError) as error:
        raise Refusal(f"{source} cannot be read as a video ({error}); copy it again") from None
    if frame is None:
        raise Refusal(f"{source} holds no frames; copy the recording again")
    return (frame.height, frame.width) if round(frame.rotation / 90) % 2 else (frame.width, frame.height)


def frame_rate(source: Path, picture_fps: float) -> float:
    """Frames per second of a video that can be read; of a folder of pictures ``picture_fps``. Raises Refusal where it does not say."""
    if source.is_dir():
        return picture_fps
    with av.open(str(source)) as container:
        stream = container.streams.video[0]
        rate = stream.average_rate or stream.guessed_rate
    if not rate:
        raise Refusal(f"{source} does not say its frame rate; rewrite it with a constant one")
    return float(rate)


def run(
    settings: Settings,
    camera: str,
    keypoints: Path,
    layout: str,
    first_frame: int,
    source: Path,
    picture_fps: float,
    pixel_map: str,
    sightings: Path,
    size: Path,
) -> None:
    """Write the tracks of ``camera``, by the frames of its footage, to ``sightings`` (npz) and the video's size to ``size`` (JSON).

    ``picture_fps`` is the rate of a folder of pictures; ``pixel_map`` (JSON): [scale, x, y] of ``Dataset.pixel_maps``, or [].
    """
    try:
        wh = picture_wh(source)
    except Refusal as refusal:
        # Decoding refuses it by name; the other cameras' clocks do not wait for that.
        warn(f"camera {camera}: {refusal}; until then it sees nobody")
        _write_nobody(camera, (0, 0), pixel_map, sightings, size)
        return
    if is_found(keypoints):
        whole = read_found(keypoints)
        about = {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)}
        found = detections_of_found(whole, *_as_filmed(camera, wh, sum(whole.looked), source, picture_fps, pixel_map), settings)
        say(f"camera {camera}: {len(found.frame)} sightings ({whole.note}), {len(np.unique(found.track))} tracks")
        write_detections(sightings, found)
        write_json(size, about)
        return
    entries, kind = read_keypoints(keypoints)
    if not entries:
        say(f"{keypoints} ({kind}) holds no person: camera {camera} sees nobody")
        _write_nobody(camera, wh, pixel_map, sightings, size)
        return
    frames = max(e.frame for e in entries) - first_frame + 1
    if frames < 2:
        raise Refusal(f"{keypoints}: no detection belongs to a frame of camera {camera}; set keypoint_first_frame in capture.yaml")
    chosen, note = choose_layout(np.stack([e.keypoints for e in entries]), layout, str(keypoints))
    if note:
        say(note)
    lens, footage = _as_filmed(camera, wh, frames, source, picture_fps, pixel_map)
    found = detections_of(entries, chosen, lens, footage, first_frame, settings)
    say(f"camera {camera}: {len(found.frame)} sightings ({kind}, {chosen}), {len(np.unique(found.track))} tracks")
    write_detections(sightings, found)
    write_json(size, {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)})


def _write_nobody(camera: str, wh: tuple[int, int], pixel_map: str, sightings: Path, size: Path) -> None:
    nobody = np.zeros(0, dtype=np.int64)
    write_detections(sightings, Detections(camera, "coco17", nobody, nobody, np.zeros((0, 17, 3))))
    write_json(size, {"camera": camera, "wh": list(wh), "pixel_map": json.loads(pixel_map)})


def _as_filmed(camera: str, wh: tuple[int, int], frames: int, source: Path, picture_fps: float, pixel_map: str) -> tuple[Lens, Footage]:
    """Lens and footage whose working pixels are the video's own: a pinhole of any focal length maps them onto themselves."""
    intrinsics = np.array([[max(wh), 0, wh[0] / 2], [0, max(wh), wh[1] / 2], [0, 0, 1.0]])
    lens = mapped_lens(Lens(camera, wh, intrinsics, "opencv", np.zeros(8), np.eye(4), np.eye(2, 3)), json.loads(pixel_map))
    fps = frame_rate(source, picture_fps)
    return lens, Footage(camera, False, wh, intrinsics.tolist(), fps, frames, 0, source.name, "", wh, 0, 0.0, [])
