# SPDX-License-Identifier: Apache-2.0
"""Cameras found from the films alone, without any calibration, against known ones.

``python -m benchmarks.cameras_found [--folder DIR] [--takes demo man] [--room edges]`` from the repository's root;
writes ``benchmarks/results/cameras_found.json``. People are found in the films by the embedded detector; focal lengths
are given or not, and one height, which is what the calibration makes of the people's bones. Bars: relative rotation of
any two cameras ≤ 1.0°, direction of their baselines ≤ 2°, lengths ≤ 3 % off, and a stated interval (95 %) that covers
the truth. DIR keeps the films and what the detector found. ``--room nothing`` or ``edges``: the same without what the
empty room shows, or without its floor.

The demo is exactly known. The man's take has two calibrations, 3.4° off one another (``benchmarks.filmed``); what is
found is printed against both.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.calibration import from_people
from studiorecon.calibration.room_pictures import room_edges
from studiorecon.errors import UserError
from studiorecon.geometry.triangulation import triangulate
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.from_tracks import bone_factor
from studiorecon.rig.metric_scale import GivenLengths, stature_m
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from benchmarks.cameras import timed
from benchmarks.cameras_stale import apart
from benchmarks.detector import ROOT
from benchmarks.filmed import TAKES, Filmed, apart_percent, part
from tests.defaults import loaded

RESULT = Path(__file__).parent / "results" / "cameras_found.json"
BARS = {"rotation_deg": 1.0, "direction_deg": 2.0, "scale_percent": 3.0}
# What of the empty room is looked at: nothing, its straight edges, and its floor too.
ROOM = ("nothing", "edges", "floor")
FRAMES = {"demo": (60,), "man": (60, 100)}


def height_m(cameras: Sequence[Camera], seen: Sequence[Detections], body: BodyModel) -> float:
    """People's height as calibrated cameras show their bones."""
    settings = loaded(from_people.Settings)
    points, _ = make_observations(seen, cameras, np.arange(100), settings.gate_m)
    loose = replace(settings.limits, outlier_units=3 * settings.limits.outlier_units)
    found = triangulate(points.pixels, points.confidence, cameras, loose)
    used = np.where(found.verified[:, None], found.points_m, np.nan)
    factor = bone_factor(used, found, points, from_people.mean_body(body))
    assert factor is not None
    return stature_m(body) / factor


def judged(take: Filmed, frames: int, told: bool, room: str, body: BodyModel) -> dict[str, Any]:
    """Cameras from the first ``frames`` frames, and how far they are from the calibrations; ``told``: with focal
    lengths, ``room``: how much of what the empty room shows is looked at (``ROOM``)."""
    edges = room_edges(take.rooms) if room != "nothing" else {}
    rooms = take.rooms if room == "floor" else {}
    focal = {c.name: float(np.mean(c.focal_px)) for c in take.cameras} if told else {}
    given = GivenLengths(height_m={"": height_m(take.cameras, take.seen, body)})
    row: dict[str, Any] = {"take": take.name, "frames": frames, "focal": told, "room": room}
    try:
        (found, report), cost = timed(
            lambda: from_people.pose_cameras(
                part(take.seen, frames),
                [c.wh for c in take.cameras],
                focal,
                frames,
                from_people.mean_body(body),
                loaded(from_people.Settings),
                given=given,
                stature=stature_m(body),
                edges=edges,
                rooms=rooms,
            )
        )
    except UserError as refusal:
        return {**row, "refused": str(refusal)}
    rotation, direction = apart(found, take.cameras)
    other = {"rotation_from_hand_picked_deg": apart(found, take.others)[0]} if take.others else {}
    longer = [f.focal_px[0] / c.focal_px[0] - 1 for f, c in zip(found, take.cameras, strict=True)]
    return {
        **row,
        "rotation_deg": rotation,
        "stated_deg": report["between_deg"],
        "covered": rotation <= report["between_deg"],
        "direction_deg": direction,
        "scale_percent": apart_percent(found, take.cameras),
        "focal_percent": 100 * max(longer, key=abs),
        "median_px": report["median_px"],
        "floor_places": sum(report["on_floor"].values()),
        "cpu_s": cost["cpu_s"],
        **other,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--takes", nargs="+", choices=TAKES, default=list(TAKES))
    parser.add_argument("--room", choices=ROOM, default="floor")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    body = BodyModel.load(ROOT / "resources/body.npz")
    stored = json.loads(RESULT.read_text(encoding="utf-8"))["rows"] if RESULT.exists() else []
    for name in options.takes:
        take = TAKES[name](folder.resolve())
        for told, frames in ((told, frames) for told in (True, False) for frames in FRAMES[name]):
            row = judged(take, frames, told, options.room, body)
            print("  ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
            same = ("take", "frames", "focal", "room")
            stored = [r for r in stored if [r.get(k) for k in same] != [row[k] for k in same]] + [row]
    print("bars:", ", ".join(f"{name} ≤ {bar}" for name, bar in BARS.items()))
    stored.sort(key=lambda r: (r["take"], not r["focal"], ROOM.index(r["room"]), r["frames"]))
    RESULT.write_text(json.dumps({"date": date.today().isoformat(), "rows": stored}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
