# SPDX-License-Identifier: Apache-2.0
"""``detect.keypoints``: tracks recorded 2D keypoints of one camera over time, in pixels of its video, before any
calibration.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.keypoints.coordinate_readings import affine
from studiorecon.keypoints.detections import Settings, as_filmed, detections_from_detector, detections_from_recorded
from studiorecon.keypoints.film_check import BORNE_OUT, Film, check_against_film
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.motion import film_motion
from studiorecon.keypoints.numbering import possible_numberings
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.keypoints.unmatched import without_record
from studiorecon.progress import say, warn
from studiorecon.scene.keypoint_verdict import KeypointVerdict, write_keypoint_verdict
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.raw_detections import is_detector_file, read_raw_detections
from studiorecon.scene.recorded_keypoints import RecordedKeypoints, write_recorded
from studiorecon.signature import Written

# The layout of an empty recording: nothing reads its points.
_NOBODYS = "body_25"


def run(
    settings: Settings,
    camera: str,
    keypoints: list[Path],
    layout: str,
    first_frame: str,
    source: Path,
    picture_fps: float,
    pixel_map: str,
    sightings: Written,
    recorded: Written,
    size: Written,
    others: list[Path],
    other_cameras: list[str],
) -> None:
    """Write the tracks of ``camera``, its keypoints as recorded, and the video's size.

    ``sightings`` (npz) gets the tracks by frames of its footage, ``recorded`` (npz) the keypoints in its film's frames
    and pixels, ``size`` (JSON) the video's size and the decisions on keypoints. ``picture_fps`` is the rate of a folder
    of pictures; ``pixel_map`` (JSON): [scale, x, y] of ``Dataset.pixel_maps``, or []; ``first_frame``: number of the
    film's first frame in the keypoint files, or "auto". ``keypoints`` are one file or folder, or one for every chapter
    of ``source``. ``others``: keypoints of ``other_cameras``, compared when those of ``camera`` do not fit its film.
    """
    about = KeypointVerdict(camera, (0, 0), json.loads(pixel_map))
    try:
        filmed = open_source(source, picture_fps)
    except UserError as refusal:
        # Decoding will raise an error with its name; the clocks of the other cameras need not wait for that.
        warn(f"camera {camera}: {refusal}; until then it has no detections")
        found, own = _nobody(camera), _none("", "")
    else:
        about = replace(about, wh=filmed.wh)
        if is_detector_file(keypoints[0]):
            whole = read_raw_detections(keypoints[0])
            stop = max((sum(stretch) for stretch in whole.looked), default=0)
            found = detections_from_detector(whole, *as_filmed(camera, filmed, stop, pixel_map), settings)
            own, what = _none(whole.note, ""), whole.note
        else:
            rest = dict(zip(other_cameras, others, strict=True))
            first = None if first_frame == "auto" else int(first_frame)
            own, described = _compared(settings, camera, keypoints, rest, layout, first, filmed, pixel_map)
            about = replace(about, refusal=own.refusal, notes=tuple(described))
            frames = int(own.pictures[-1]) + 1 if len(own.pictures) else 0
            found = detections_from_recorded(own, *as_filmed(camera, filmed, frames, pixel_map), settings)
            found = _nobody(camera) if own.refusal else found
            what = f"{own.program}, {own.layout}"
        say(f"camera {camera}: {len(found.frame)} detections ({what}), {len(np.unique(found.track))} tracks")
    write_detections(sightings, found)
    write_recorded(recorded, own)
    write_keypoint_verdict(size, about)


def _compared(
    settings: Settings,
    camera: str,
    paths: Sequence[Path],
    others: Mapping[str, Path],
    layout: str,
    first_frame: int | None,
    filmed: FootageSource,
    pixel_map: str,
) -> tuple[RecordedKeypoints, list[str]]:
    """The keypoints of a file in the frames and pixels of the film, if they fit it, and sentences about them."""
    given, path = _of_chapters(paths, filmed, first_frame), ", ".join(map(str, paths))
    if not len(given.frame):
        warn(f"{path} ({given.program}) holds no person: camera {camera} only shows the room")
        return _none(given.program, layout), []
    most = int(np.unique(given.frame, return_counts=True)[1].max())
    if 2 * len(given.pictures) < filmed.frames < 2 * most:
        remedy = "exchange the first two axes, frames come before people" if given.program == "npz" else ""
        raise UserError(
            f"{path} holds {most} people in {len(given.pictures)} frames, and the film has {filmed.frames} frames: "
            f"{remedy or 'give the people of every frame the number or name of their own picture'}"
        )
    numbers = possible_numberings(given.pictures, filmed.frames, filmed.fps, first_frame, given.counted)
    shown = np.concatenate([one.frame_of[np.isin(given.pictures, given.frame)] for one in numbers.possible])
    motion = film_motion(filmed, int(shown.min()), int(shown.max()))
    mapped = json.loads(pixel_map) if settings.keypoint_pixels != "video" else []
    scale, x, y = mapped or (1.0, 0.0, 0.0)
    centre = 0.5 - settings.keypoint_centres
    map_ = affine(scale, scale, x, y)
    film = Film(camera, filmed.wh, filmed.frames, motion, map_, centre, filmed.stored_wh, layout, path)

    def theirs() -> Mapping[str, RecordedKeypoints]:
        found = {}
        for name, place in others.items():
            one = read_keypoints(place, filmed.wh)
            usual = possible_numberings(one.pictures, filmed.frames, filmed.fps, first_frame, one.counted).possible[0]
            found[name] = one.renumbered(usual.frame_of, filmed.frames)
        return found

    verdict = check_against_film(given, numbers, film, theirs)
    gap_frames = settings.tracking.gap_s * filmed.fps
    notes = [*verdict.notes, *without_record(camera, verdict.recorded.pictures, filmed.frames, gap_frames)]
    for sentence in [*notes, *filter(None, [verdict.refusal])]:
        warn(sentence)
    if verdict.lift is not None and verdict.lift > BORNE_OUT and not verdict.refusal:
        say(f"camera {camera}: its keypoints agree with the motion in its film ({verdict.lift:.2f} of 1)")
    return replace(verdict.recorded, refusal=verdict.refusal), notes


def _of_chapters(paths: Sequence[Path], filmed: FootageSource, first_frame: int | None) -> RecordedKeypoints:
    """The result of ``read_keypoints`` for one file, or for one per chapter, by the frames of the whole film."""
    if len(paths) == 1:
        return read_keypoints(paths[0], filmed.wh)
    found, before = list[RecordedKeypoints](), 0
    for path, part in zip(paths, filmed.parts, strict=True):
        one = read_keypoints(path, filmed.wh)
        usual = possible_numberings(one.pictures, part.frames, part.fps, first_frame, one.counted).possible[0]
        in_part = one.renumbered(usual.frame_of, part.frames)
        found.append(replace(in_part, frame=in_part.frame + before, pictures=in_part.pictures + before))
        before += part.frames
    somebody = [one for one in found if len(one.frame)] or found[:1]
    if len({one.keypoints.shape[1] for one in somebody}) > 1:
        raise UserError(
            f"{paths[0]} and the keypoints of its later chapters have different numbers of keypoints; run the detector "
            "with one model on all of them"
        )
    pictures, frame = (np.concatenate([getattr(one, name) for one in found]) for name in ("pictures", "frame"))
    return replace(found[0], pictures=pictures, frame=frame, keypoints=np.concatenate([s.keypoints for s in somebody]))


def _none(program: str, layout: str) -> RecordedKeypoints:
    """An empty recording."""
    name = layout if layout in LAYOUTS else _NOBODYS
    nobody = np.zeros(0, dtype=np.int64)
    return RecordedKeypoints(program, nobody, nobody, np.zeros((0, len(LAYOUTS[name].keypoints), 3)), True, name)


def _nobody(camera: str) -> Detections:
    own = _none("", "coco17")
    return Detections(camera, own.layout, own.frame, own.frame, own.keypoints)
