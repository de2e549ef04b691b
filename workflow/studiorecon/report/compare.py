# SPDX-License-Identifier: Apache-2.0
"""``report.compare``: any renders against any photos, by hand: ``python -m studiorecon report.compare --renders DIR --truth DIR``.

Each folder holds one video (``<camera>.mkv``, ``.mp4``, …) or one folder of pictures (``<camera>/*.png``) per camera; frames are
compared in order. Prints the measures, and writes them as JSON when ``--metrics FILE`` is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.flow import one_thread
from studiorecon.images.video import read_frames
from studiorecon.progress import progress, say
from studiorecon.report.measures import FULL, TEMPORAL, Flicker, measure_picture, summary
from studiorecon.scene.dataset import PICTURE_SUFFIXES, VIDEO_SUFFIXES
from studiorecon.scene.files import write_json


def cameras_in(folder: Path) -> dict[str, Path]:
    """camera → its video or folder of pictures; raises Refusal when there is none."""
    if not folder.is_dir():
        raise Refusal(f"{folder} is not a folder; give one with a video or a folder of pictures per camera")
    found = {}
    for entry in sorted(folder.iterdir()):
        if entry.is_dir() and _pictures(entry):
            found[entry.name] = entry
        elif entry.suffix.lower() in VIDEO_SUFFIXES and "." not in entry.stem:
            found[entry.stem] = entry
    if not found:
        raise Refusal(f"{folder} holds neither videos nor folders of pictures; put <camera>.mkv or <camera>/*.png there")
    return found


def frames_of(source: Path) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 frames of a video or a folder of pictures, in name order."""
    if source.is_file():
        yield from read_frames(source)
        return
    for path in _pictures(source):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            raise Refusal(f"{path} is not a readable picture")
        yield picture[..., ::-1]


def compare_camera(camera: str, renders: Path, truth: Path, flow_preset: str) -> list[dict[str, float | None]]:
    """The measures of each frame of one camera; raises Refusal when sizes or numbers of frames differ."""
    values, flicker = [], Flicker(flow_preset)
    pairs = zip(frames_of(renders), frames_of(truth), strict=True)
    try:
        for picture, photo in progress(pairs, f"frames of {camera}"):
            if picture.shape != photo.shape:
                sizes = f"{picture.shape[1]}×{picture.shape[0]} and {photo.shape[1]}×{photo.shape[0]}"
                raise Refusal(f"the frames of {renders} and {truth} differ in size ({sizes}); resize one of them")
            values.append({**measure_picture(picture, photo, {}), **flicker.measure(photo, {"render": picture})["render"]})
    except ValueError as error:
        if "zip()" not in str(error):
            raise
        raise Refusal(f"{renders} and {truth} have different numbers of frames; cut the longer one") from None
    return values


def run(renders: Path, truth: Path, metrics: Path | None = None) -> None:
    """Compare every camera that both folders have."""
    left, right = cameras_in(renders), cameras_in(truth)
    common = [camera for camera in left if camera in right]
    if not common:
        raise Refusal(f"no camera of {renders} ({', '.join(left)}) is in {truth} ({', '.join(right)}); name the files alike")
    for camera in sorted(set(left) ^ set(right)):
        say(f"camera {camera} is in one folder only and is left out")
    with one_thread():
        measured = {camera: compare_camera(camera, left[camera], right[camera], "medium") for camera in common}
    result = {name: summary({c: [v[name] for v in values] for c, values in measured.items()}, "no frames") for name in (*FULL, *TEMPORAL)}
    for name, entry in result.items():
        each = ", ".join(f"{c} {_shown(e['value'])}" for c, e in entry["cameras"].items())
        say(f"{name}: {_shown(entry['value'])} ({each})")
    if metrics is not None:
        write_json(metrics, result)


def _pictures(folder: Path) -> list[Path]:
    return [p for p in sorted(folder.iterdir()) if p.suffix.lower() in PICTURE_SUFFIXES]


def _shown(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.4f}"
