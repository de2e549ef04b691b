# SPDX-License-Identifier: Apache-2.0
"""Cameras found from the films alone, without any calibration, against real ones.

``python -m tests.bench.cameras_found [--folder DIR] [--frames 60 100]`` from the repository's root; writes
``tests/bench/results/cameras_found.json``. The man of pose2sim_balancing/single is found in the films by the embedded
detector; only focal lengths are given, and his height, which is what the calibration makes of his bones. Bars: relative
rotation of any two cameras ≤ 1.0°, direction of their baselines ≤ 2°, lengths ≤ 3 % off, and a stated interval (95 %)
that covers the truth. DIR keeps what the detector found.

The take has two calibrations, 3.4° off one another. The reference is that of the motion-capture system
(``Calib.qca.txt``): the edges of the room, which know nothing of either, agree with it to 0.3-0.7° for every pair of
cameras, and with the one from hand-picked points (``Calib_scene.toml``) to 0.5-2.1°; what is found is printed against
both.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.calibration import files as calibration
from studiorecon.calibration import from_people
from studiorecon.calibration.room_edges import edges_of
from studiorecon.detect import keypoints as sightings
from studiorecon.detect import people as detect
from studiorecon.geometry.triangulation import triangulate
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.correspondences import observe
from studiorecon.rig.from_tracks import bone_factor
from studiorecon.rig.given_lengths import GivenLengths, stature_m
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.tracks import keypoints as tracks_keypoints

from tests.bench.cameras import MAN, timed
from tests.bench.cameras_stale import apart
from tests.bench.detector import DATA, ROOT, networks
from tests.defaults import loaded

RESULT = Path(__file__).parent / "results" / "cameras_found.json"
BARS = {"rotation_deg": 1.0, "direction_deg": 2.0, "scale_percent": 3.0}


def found_in(camera: str, video: Path, folder: Path) -> Path:
    """The detector's people of one camera, from ``folder`` where they are there."""
    found = folder / "found" / f"{camera}.npz"
    if not found.exists():
        found.parent.mkdir(parents=True, exist_ok=True)
        detect.run(camera, video, [], 30.0, networks("blazepose_heavy"), [], "auto", found)
    return found


def the_man(folder: Path) -> tuple[list[Camera], list[Camera], list[Detections], dict[str, np.ndarray]]:
    """The motion-capture system's cameras, those from hand-picked points, and per camera what the detector sees and the
    room's edges."""
    take = DATA / "pose2sim_balancing"
    dataset = open_dataset(take / "single", ROOT / "tests/captures/pose2sim_single.yaml")
    videos = [dataset.footage[c] for c in MAN]
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(found_in, MAN, videos, [folder] * len(MAN)))
    seen, size = [], {}
    for c, raw, video in zip(MAN, found, videos):
        out = folder / f"{c}.npz", folder / f"{c}.json"
        pixel_map = json.dumps(dataset.pixel_maps[c])
        sightings.run(loaded(tracks_keypoints.Settings), c, raw, "auto", 0, video, 60.0, pixel_map, *out)
        seen.append(read_detections(out[0]))
        size[c] = tuple(read_json(out[1])["wh"])
    calibrated = []
    for name in ("Calib.qca.txt", "Calib_scene.toml"):
        reading = calibration.read_calibration([take / "calibration" / name])
        lenses = calibration.lenses_of(reading, name, list(MAN), {}, loaded(calibration.Settings))[0]
        calibrated.append([Camera(n.name, size[n.name], n.intrinsics, n.camera_from_world) for n in lenses])
    return *calibrated, seen, edges_of(MAN, videos, size)


def scale_percent(found: list[Camera], truth: list[Camera]) -> float:
    """By how much the cameras' distances from their middle are off, percent, in the mean."""
    ours, true = (np.array([c.centre_m for c in group]) for group in (found, truth))
    spread = [np.linalg.norm(x - x.mean(0), axis=1).mean() for x in (ours, true)]
    return float(100 * (spread[0] / spread[1] - 1))


def height_m(cameras: list[Camera], seen: list[Detections], body: BodyModel) -> float:
    """The man's height as calibrated cameras show his bones."""
    settings = loaded(from_people.Settings)
    points, _ = observe(seen, cameras, np.arange(100), settings.gate_m)
    loose = replace(settings.limits, outlier_units=3 * settings.limits.outlier_units)
    found = triangulate(points.pixels, points.confidence, cameras, loose)
    used = np.where(found.verified[:, None], found.points_m, np.nan)
    factor = bone_factor(used, found, points, from_people.mean_body(body))
    assert factor is not None
    return stature_m(body) / factor


def judged(
    cameras: list[Camera],
    others: list[Camera],
    seen: list[Detections],
    edges: dict[str, np.ndarray],
    frames: int,
    body: BodyModel,
) -> dict[str, Any]:
    """Cameras from the first ``frames`` frames, and how far they are from the calibrations."""
    part = [d.only(d.frame < frames) for d in seen]
    focal = {c.name: float(np.mean(c.focal_px)) for c in cameras}
    given = GivenLengths(height_m={"": height_m(cameras, seen, body)})
    (found, report), cost = timed(
        lambda: from_people.pose_cameras(
            part,
            [c.wh for c in cameras],
            focal,
            frames,
            from_people.mean_body(body),
            loaded(from_people.Settings),
            given=given,
            stature=stature_m(body),
            edges=edges,
        )
    )
    rotation, direction = apart(found, cameras)
    return {
        "frames": frames,
        "edges": bool(edges),
        "rotation_deg": rotation,
        "stated_deg": report["between_deg"],
        "covered": rotation <= report["between_deg"],
        "direction_deg": direction,
        "scale_percent": scale_percent(found, cameras),
        "median_px": report["median_px"],
        "rotation_from_hand_picked_deg": apart(found, others)[0],
        "cpu_s": cost["cpu_s"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--frames", nargs="+", type=int, default=[60, 100])
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    cameras, others, seen, edges = the_man(folder.resolve())
    body = BodyModel.load(ROOT / "resources/body.npz")
    rows = []
    for told in ({}, edges):
        for frames in given.frames:
            rows.append(judged(cameras, others, seen, told, frames, body))
            print("  ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
    print("bars, with edges:", ", ".join(f"{name} ≤ {bar}" for name, bar in BARS.items()))
    RESULT.write_text(json.dumps({"date": date.today().isoformat(), "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
