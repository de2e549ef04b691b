# SPDX-License-Identifier: Apache-2.0
"""``calibration.doctor``: checks whether the calibration fits the people, and what the capture lacks, before a long
run.

It always ends with a page: a calibration that does not fit is a result, not a failure. ``cameras.refine`` raises the
error.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.calibration.checks.advice import brightness_and_clipping, edge_agreement_note, footage_notes
from studiorecon.calibration.checks.doctor_page import page
from studiorecon.calibration.checks.examination import Settings, examine
from studiorecon.calibration.room_pictures import read_room_pictures, without_distortion
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.geometry.lens import video_from_working
from studiorecon.images.encoded import png
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.progress import say
from studiorecon.rig.contact_sheet import contact_sheet
from studiorecon.rig.lens_model import LensReading, reinterpret_lens
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.starts import LENS_READINGS
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import ClockFinding, Clocks, read_clock_findings, read_clocks
from studiorecon.scene.files import write_json, write_text
from studiorecon.scene.keypoint_verdict import read_keypoint_verdict
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_PICTURE_ROWS = 480


def undistort_picture(
    picture: Integer[np.ndarray, "H W 3"], lens: Lens, camera: Camera
) -> Integer[np.ndarray, "H W 3"]:
    """The picture (H, W, 3) of a video as seen by the pinhole ``camera`` of ``to_pinhole``, 480 rows high."""
    small = camera.resized((round(_PICTURE_ROWS * camera.wh[0] / camera.wh[1]), _PICTURE_ROWS))
    place = video_from_working(small.pixel_centres(), lens, camera.wh, small.intrinsics).astype(np.float32) - 0.5
    return cv2.remap(picture, place[..., 0], place[..., 1], cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT)


def _rooms(
    sources: Sequence[Path],
    cameras: Sequence[Camera],
    lenses: Sequence[Lens],
    moments: Sequence[Integer[np.ndarray, " T"]],
    asked: Sequence[bool],
) -> list[RoomPicture | None]:
    """The room without people in the pinhole ``cameras`` at the ``moments`` (frames) of their footage, filmed through
    ``lenses``.

    None where it is not ``asked`` for, or cannot be read.
    """
    names = [c.name for c in cameras]
    wanted, paths = zip(*((n, path) for n, path, a in zip(names, sources, asked, strict=True) if a))
    found = read_room_pictures(wanted, paths, {c.name: c.wh for c in cameras}, dict(zip(names, moments, strict=True)))
    return [
        without_distortion(found[c.name], lens, c) if c.name in found else None
        for c, lens in zip(cameras, lenses, strict=True)
    ]


def keypoint_pixels(seen: Detections, frame: int | None) -> Float[np.ndarray, "N 2"]:
    """(N, 2) pixels of all keypoints of a frame."""
    points = seen.keypoints[seen.frame == (-1 if frame is None else frame)].reshape(-1, 3)
    return points[points[:, 2] > 0, :2]


def usable_clocks(common: Clocks) -> Clocks:
    """``common``, or the footage as filmed where the videos share no moment, because it can still be checked."""
    if common.frames:
        return common
    as_filmed = tuple(replace(c, offset_s=0.0, drift_ppm=0.0) for c in common.cameras)
    return replace(common, start_s=0.0, frames=min(c.frames for c in as_filmed), cameras=as_filmed)


def first_frame(common: Clocks, camera: str) -> float:
    """The fractional frame of a camera's footage at the scene's first moment."""
    position = common.positions(camera)
    return float(np.interp(0.0, position, np.arange(len(position))))


def lags_frames(found: Sequence[ClockFinding], used: Clocks) -> dict[str, dict[str, float]]:
    """Per camera, the delay of its people by the clocks in use, relative to the median camera, in its own frames
    (``frames``), with the 95 % interval (``low``, ``high``), at least half a frame to either side."""
    late_s = {
        one.camera: (used.of(one.camera).offset_s - one.people_s[0], one.people_s[1]) for one in found if one.people_s
    }
    usual_s = float(np.quantile([late for late, _ in late_s.values()], 0.5, method="lower")) if late_s else 0.0
    lags = {}
    for camera, (seconds, half_s) in late_s.items():
        fps = used.of(camera).fps
        # Shutters of synchronised cameras differ by up to half a frame, and only whole frames can be cut.
        frames, half = (seconds - usual_s) * fps, max(half_s * fps, 0.5)
        lags[camera] = {"frames": frames, "low": frames - half, "high": frames + half}
    return lags


def empty_detections(camera: str) -> Detections:
    """The empty detections of a camera without keypoints."""
    return Detections(camera, "coco17", np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 17, 3)))


def run(
    settings: Settings,
    scene: str,
    calibration: Path,
    cameras: list[str],
    sources: list[Path],
    sightings: list[Path],
    sizes: list[Path],
    clocks: Path,
    sync: Path,
    report: Written,
    doctor: Written,
    notes: str = "[]",
) -> None:
    """Write ``report`` (JSON) and ``doctor`` (HTML) for ``cameras`` and their videos ``sources``.

    ``clocks`` give their frames in use, ``sync`` how those were determined. ``sightings`` and ``sizes`` exist for the
    cameras with keypoints, in any order. Cameras that people did not place are not examined. ``notes`` (JSON):
    sentences about unused files in the capture's folder.
    """
    calibrated = read_calibration(calibration)
    lenses, left_out = calibrated.lenses, calibrated.left_out
    sources = [source for camera, source in zip(cameras, sources, strict=True) if camera not in left_out]
    cameras = [camera for camera in cameras if camera not in left_out]
    if unknown := [c for c in cameras if c not in lenses]:
        raise UserError(f"camera {unknown[0]} is not in {calibration} (that has {', '.join(lenses)})")
    filmed, decided = read_clocks(clocks), [read_keypoint_verdict(path) for path in sizes]
    common = usable_clocks(filmed)
    heights = {v.camera: v.wh[1] for v in decided}
    seen = {d.camera: resample_keypoints(d, common, heights[d.camera]) for d in (read_detections(p) for p in sightings)}
    raw = [seen.get(c, empty_detections(c)) for c in cameras]
    moments = [common.source_frames(c) for c in cameras]
    films = [open_source(source, 0.0) for source in sources]
    looks = [seek_frames(film, [int(of[0]), int(of[len(of) // 2])]) for film, of in zip(films, moments, strict=True)]
    starts = [first_frame(common, c) for c in cameras]
    about = [
        {**about_film(c, film, pictures), "frames": common.frames, "first_frame": start, "keypoints": c in seen}
        for c, film, pictures, start in zip(cameras, films, looks, starts, strict=True)
    ]
    say_about_films(about, films)  # before anything slow: results from the files alone

    def read(model: LensReading) -> tuple[list[Camera], list[Detections]]:
        both = [to_pinhole(d, reinterpret_lens(lenses[c], model), film.wh) for c, d, film in zip(cameras, raw, films)]
        return [camera for camera, _ in both], [d for _, d in both]

    pinholes, detections = read("as_read")
    readings = {
        name: read(model) for name, model in LENS_READINGS.items() if any(lenses[c].model != model for c in cameras)
    }
    found, unlike = read_clock_findings(sync)
    lags = lags_frames([one for one in found if one.camera in cameras], common)
    described = {"sentences": [one.sentence for one in found], "refusal": filmed.refusal, "lags_frames": lags}
    # Cameras that filmed people, or all: the room in held-out pictures is not used.
    asked = [c in seen or not seen for c in cameras]
    rooms = _rooms(sources, pinholes, [lenses[c] for c in cameras], moments, asked)
    notes_of_films = [sentence for v in decided for sentence in v.notes]
    compared = {"refused": [v.refusal for v in decided if v.refusal], "notes": notes_of_films + unlike}
    doubts = calibrated.about["doubts"] or []
    result, points = examine(pinholes, detections, about, settings, readings, described, doubts, rooms, compared)
    frame = result["shown_frame"]
    straight = [
        undistort_picture(both[-1] if frame is None else seek_frames(film, [int(of[frame])])[0], lenses[c], camera)
        for both, film, of, c, camera in zip(looks, films, moments, cameras, pinholes)
    ]
    shown = {"after_px_per_camera": [result["px_per_camera"][c] for c in cameras]}
    sheet = contact_sheet(pinholes, [], straight, points, shown, [keypoint_pixels(d, frame) for d in detections])
    result["notes"] = json.loads(notes)
    write_json(report, result)
    write_text(doctor, page(scene, result, png(sheet)))
    # The step that estimates the clocks writes their sentences.
    conclusion = [*result["notes"], f"VERDICT: {result['verdict']}", *result["advice"]]
    for sentence in [*conclusion, *filter(None, [edge_agreement_note(result)]), f"the page is {doctor}"]:
        say(sentence)


def about_film(camera: str, film: FootageSource, pictures: Sequence[Integer[np.ndarray, "H W 3"]]) -> dict[str, Any]:
    """The report's entry of a camera from its file and two of its ``pictures``."""
    return {
        "camera": camera,
        "wh": list(film.wh),
        **brightness_and_clipping(pictures),
        "fps": film.fps,
        "video_frames": film.frames,
        "rotation_deg": film.rotation_deg,
    }


def say_about_films(about: Sequence[Mapping[str, Any]], films: Sequence[FootageSource]) -> None:
    """Log size, length, brightness and faults of every film."""
    for a in about:
        say(
            f"camera {a['camera']}: {a['wh'][0]}×{a['wh'][1]}, {a['fps']:g} fps, "
            f"{a['video_frames']} frames from {a['first_frame']:g} on, "
            f"mean grey {a['brightness']:.2f}, {'keypoints' if a['keypoints'] else 'no keypoints'}"
        )
    notes = [f"camera {a['camera']}: {note}" for a, film in zip(about, films) for note in film.notes]
    for sentence in [*notes, *footage_notes(about)]:
        say(sentence)
