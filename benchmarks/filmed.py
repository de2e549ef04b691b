# SPDX-License-Identifier: Apache-2.0
"""Two takes as films, for benches that begin with pictures: the demo, and the man of pose2sim_balancing.

``folder`` keeps detections and the demo's films, which later benches reuse.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from studiorecon.calibration import files as calibration
from studiorecon.calibration.doctor import empty_detections
from studiorecon.calibration.room_pictures import read_room_pictures, without_distortion
from studiorecon.detect import keypoints as sightings
from studiorecon.footage.source import open_source
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.files import read_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.tracks import keypoints as tracks_keypoints

from benchmarks.cameras import MAN
from benchmarks.detector import DATA, ROOT, find_people, workflow
from tests.defaults import loaded

DEMO = ("cam1", "cam2", "cam3", "cam4")


@dataclass(frozen=True)
class Filmed:
    """A take of which only the films were looked at.

    Attributes:
        name, fps, frames: of the take.
        cameras: the reference, in pixels of the films; ``lenses``: the same as calibrated.
        other_lenses: of ``others``.
        seen: what the detector found, pixels of the films.
        rooms: camera → its room without people.
        others: another calibration of the same take, if there is one.
    """

    name: str
    fps: float
    frames: int
    cameras: list[Camera]
    lenses: dict[str, Lens]
    seen: list[Detections]
    rooms: dict[str, RoomPicture]
    others: list[Camera]
    other_lenses: dict[str, Lens]

    def straightened(
        self, lenses: Mapping[str, Lens]
    ) -> tuple[list[Camera], list[Detections], list[RoomPicture | None]]:
        """Cameras, sightings and rooms without the distortion of ``lenses``, as a calibrated capture has them."""
        cameras, seen, rooms = [], [], []
        for d, camera in zip(self.seen, self.cameras, strict=True):
            pinhole, straight = to_pinhole(d, lenses[camera.name], camera.wh)
            cameras.append(pinhole)
            seen.append(straight)
            room = self.rooms.get(camera.name)
            rooms.append(None if room is None else without_distortion(room, lenses[camera.name], pinhole))
        return cameras, seen, rooms


def found_in(camera: str, video: Path, folder: Path) -> Path:
    """The detector's people of one film, from ``folder`` where they are there."""
    found = folder / "found" / f"{camera}.npz"
    if not found.exists():
        found.parent.mkdir(parents=True, exist_ok=True)
        find_people(camera, video, "blazepose_heavy", found)
    return found


def sighted(
    cameras: Sequence[str], videos: Sequence[Path], maps: Mapping[str, Sequence[float]], folder: Path
) -> tuple[list[Detections], dict[str, tuple[int, int]]]:
    """What the detector sees in every film, followed through time, and the films' sizes."""
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(found_in, cameras, videos, [folder] * len(cameras)))
    seen, size = [], {}
    for c, raw, video in zip(cameras, found, videos, strict=True):
        out = folder / f"{c}.npz", folder / f"{c}.recorded.npz", folder / f"{c}.json"
        reported = json.dumps(maps.get(c, []))
        fps = open_source(video, 30.0).fps
        sightings.run(loaded(tracks_keypoints.Settings), c, [raw], "auto", "auto", video, fps, reported, *out, [], [])
        seen.append(read_detections(out[0]))
        size[c] = tuple(read_json(out[2])["wh"])
    return seen, size


def the_man(folder: Path) -> Filmed:
    """One man on one spot, four cameras, 100 frames at 60 per second.

    The take has two calibrations, 3.4° off one another. The reference is that of the motion-capture system
    (``Calib.qca.txt``), with which the edges of the room agree best; the other one is from hand-picked points.
    """
    take = DATA / "pose2sim_balancing"
    dataset = open_dataset(take / "single", ROOT / "tests/captures/pose2sim_single.yaml")
    videos = [dataset.footage[c] for c in MAN]
    seen, size = sighted(MAN, videos, dataset.pixel_maps, folder / "man")
    read = []
    for name in ("Calib.qca.txt", "Calib_scene.toml"):
        reading = calibration.read_calibration([take / "calibration" / name])
        lenses = calibration.paired_lenses(reading, name, list(MAN), dataset.pixel_maps, loaded(calibration.Settings))[
            0
        ]
        read.append({lens.name: lens for lens in lenses})
    pinholes = [[to_pinhole(empty_detections(c), lenses[c], size[c])[0] for c in MAN] for lenses in read]
    return Filmed(
        "man", 60.0, 100, pinholes[0], read[0], seen, read_room_pictures(MAN, videos, size), pinholes[1], read[1]
    )


def the_demo(folder: Path) -> Filmed:
    """The demo's four training cameras: two people in 60 frames of 480×272 at 30 per second, exactly known."""
    films = folder / "results/studio/demo/dataset"
    if not (films / "capture.yaml").exists():
        workflow(folder, ["results/studio/demo/dataset/capture.yaml"])
    videos = [films / "videos" / f"{c}.mp4" for c in DEMO]
    seen, size = sighted(DEMO, videos, {}, folder / "demo")
    reading = calibration.read_calibration([films / "intri.yml", films / "extri.yml"])
    lenses = calibration.paired_lenses(reading, "demo", list(DEMO), {}, loaded(calibration.Settings))[0]
    pinholes = [to_pinhole(empty_detections(n.name), n, size[n.name])[0] for n in lenses]
    rooms = read_room_pictures(DEMO, videos, size)
    return Filmed("demo", 30.0, 60, pinholes, {n.name: n for n in lenses}, seen, rooms, [], {})


TAKES = {"demo": the_demo, "man": the_man}


def part(seen: Sequence[Detections], frames: int) -> list[Detections]:
    """The first ``frames`` frames."""
    return [d.only(d.frame < frames) for d in seen]


def apart_percent(found: Sequence[Camera], truth: Sequence[Camera]) -> float:
    """By how much the cameras' distances from their middle are off, percent, in the mean."""
    ours, true = (np.array([c.centre_m for c in group]) for group in (found, truth))
    spread = [np.linalg.norm(x - x.mean(0), axis=1).mean() for x in (ours, true)]
    return float(100 * (spread[0] / spread[1] - 1))
