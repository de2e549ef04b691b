# SPDX-License-Identifier: Apache-2.0
"""Errors of cameras that are estimated from the films alone, without a calibration.

``python -m benchmarks.cameras_found [--folder DIR] [--takes made demo man] [--room edges]`` from the repository's root;
writes ``benchmarks/results/cameras_found.json``. People are found in the films by the embedded detector; focal lengths
are given or not, and one height, which is what the calibration makes of the people's bones. Bars: relative rotation of
any two cameras ≤ 1.0°, direction of their baselines ≤ 2°, lengths ≤ 3 % off, and a stated interval (95 %) that covers
the truth. DIR keeps the films and detections. ``--room nothing`` or ``edges``: without evidence of the empty room, or
without its floor.

``made`` needs no films: seeds with drawn keypoints of people who walk about for 25 s before four cameras with barrel
distortion (``tests.made.strollers``), focal lengths and k1 unknown; focal lengths must be within 2 %, and stated
standard deviations are right where 1.96 of them cover the truth in 91 to 98 % of the cameras. ``varied``: the same with
3 to 8 cameras on arcs and rings, one to three people, lenses similar or not, 5 to 15 frames per second.

The demo is exactly known. The man's take has two calibrations, 3.4° off one another (``benchmarks.filmed``); results
are compared with both.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import date
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.calibration import from_people
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
from tests.made.strollers import made_capture

RESULT = Path(__file__).parent / "results" / "cameras_found.json"
BARS = {"rotation_deg": 1.0, "direction_deg": 2.0, "scale_percent": 3.0}
# What of the empty room is looked at: nothing, its straight edges, and its floor too.
ROOM = ("nothing", "edges", "floor")
# Of the mean body's bones, as made people have them.
HEIGHT_M = 1.70
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


def scored(take: Filmed, frames: int, reported: bool, room: str, body: BodyModel) -> dict[str, Any]:
    """Cameras from the first ``frames`` frames, and how far they are from the calibrations; ``told``: with focal
    lengths, ``room``: how much of what the empty room shows is looked at (``ROOM``)."""
    edges = {name: r.edges_px for name, r in take.rooms.items()} if room != "nothing" else {}
    rooms = take.rooms if room == "floor" else {}
    focal = {c.name: float(np.mean(c.focal_px)) for c in take.cameras} if reported else {}
    given = GivenLengths(height_m={"": height_m(take.cameras, take.seen, body)})
    row: dict[str, Any] = {"take": take.name, "frames": frames, "focal": reported, "room": room}
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


def made_row(seed: int, k1: float, similar: bool, body: BodyModel, **drawn: Any) -> dict[str, Any]:
    """Cameras from drawn keypoints, and how far they are from the planted ones; ``drawn`` as for ``made_capture``."""
    made = made_capture(seed, k1, similar, **{"people": 1 + seed % 2, **drawn})
    row: dict[str, Any] = {"take": "made", "seed": seed, "k1": k1, "alike": similar, **drawn}
    sizes, settings = [c.wh for c in made.cameras], loaded(from_people.Settings)
    about = from_people.mean_body(body), settings, None, GivenLengths(height_m={"": HEIGHT_M}), stature_m(body)
    try:
        (found, report), cost = timed(lambda: from_people.pose_cameras(made.detections, sizes, {}, made.frames, *about))
    except UserError as refusal:
        return {**row, "refused": str(refusal)}
    names = [c.name for c in made.cameras]
    longer = [np.log(f.focal_px[0] / c.focal_px[0]) for f, c in zip(found, made.cameras, strict=True)]
    radial = [report["radial_k1"][n] - k for n, k in zip(names, made.radial, strict=True)]
    rotation, direction = apart(found, made.cameras)
    lengths = [[np.linalg.norm(a.centre_m - b.centre_m) for a, b in combinations(g, 2)] for g in (found, made.cameras)]
    sigmas = [report[name][n] for name in ("focal_sigma", "radial_sigma") for n in names]
    return {
        **row,
        "rotation_deg": rotation,
        "stated_deg": report["between_deg"],
        "direction_deg": direction,
        "focal_percent": 100 * max(longer, key=abs),
        "baseline_percent": 100 * float(np.abs(np.divide(*lengths) - 1).max()),
        "radial": max(radial, key=abs),
        "off_sigmas": [float(off / s) for off, s in zip([*longer, *radial], sigmas, strict=True)],
        "cpu_s": cost["cpu_s"],
    }


def varied_row(seed: int, body: BodyModel) -> dict[str, Any]:
    """A made capture of which everything is drawn: its cameras and their lenses, and how long people walk."""
    rng = np.random.default_rng([seed, 200])
    views = int(rng.integers(3, 9))
    drawn = {
        "views": views,
        "people": int(rng.integers(1, 4)),
        "seconds": float(rng.uniform(20, 40)),
        "fps": float(rng.choice([5.0, 10.0, 15.0])),
        "principal_share": 0.003,
        "around": float(rng.choice([0.35, 0.6, 1.0])) if views > 3 else 1.0,
    }
    return made_row(seed, float(rng.uniform(-0.35, 0.1)), bool(rng.random() < 0.6), body, **drawn) | {"take": "varied"}


def print_summary(rows: Sequence[dict[str, Any]]) -> None:
    """Medians, maxima and coverage of made captures."""
    placed = [r for r in rows if "refused" not in r]
    halves = [np.reshape(r["off_sigmas"], (2, -1)) for r in placed]
    off = np.concatenate(halves, axis=1) if halves else np.zeros((2, 0))
    covered = np.mean([r["rotation_deg"] <= r["stated_deg"] for r in placed])
    print(f"{len(placed)} of {len(rows)} made captures placed; covered: rotation {covered:.0%}, ", end="")
    print(", ".join(f"{n} {(np.abs(off[k]) < 1.96).mean():.0%}" for k, n in enumerate(("focal length", "k1"))))
    for name in ("rotation_deg", "focal_percent", "baseline_percent"):
        size = np.abs([r[name] for r in placed])
        print(f"{name}: median {np.median(size):.2f}, largest {size.max():.2f}")


def shown(take: str, rows: Iterable[dict[str, Any]], stored: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """``stored`` with new rows of ``take``, which are printed."""
    new = []
    for row in rows:
        print("  ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
        new.append(row)
    print_summary(new)
    return [r for r in stored if r["take"] != take] + new


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--takes", nargs="+", choices=["made", "varied", *TAKES], default=["made", *TAKES])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--room", choices=ROOM, default="floor")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    body = BodyModel.load(ROOT / "resources/body.npz")
    stored = json.loads(RESULT.read_text(encoding="utf-8"))["rows"] if RESULT.exists() else []
    if "made" in options.takes:
        planted = [(k1, True) for k1 in (0.0, -0.1, -0.22, -0.35)] + [(-0.22, False)]
        keys = [(seed, k1, similar) for k1, similar in planted for seed in range(options.seeds)]
        stored = shown("made", (made_row(*key, body) for key in keys), stored)
    if "varied" in options.takes:
        stored = shown("varied", (varied_row(seed, body) for seed in range(options.seeds)), stored)
    for name in [name for name in options.takes if name in TAKES]:
        take = TAKES[name](folder.resolve())
        for reported, frames in ((reported, frames) for reported in (True, False) for frames in FRAMES[name]):
            row = scored(take, frames, reported, options.room, body)
            print("  ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)
            same = ("take", "frames", "focal", "room")
            stored = [r for r in stored if [r.get(k) for k in same] != [row[k] for k in same]] + [row]
    print("bars:", ", ".join(f"{name} ≤ {bar}" for name, bar in BARS.items()))
    filmed = [r for r in stored if r["take"] in TAKES]
    filmed.sort(key=lambda r: (r["take"], not r["focal"], ROOM.index(r["room"]), r["frames"]))
    stored = [r for r in stored if r["take"] not in TAKES] + filmed
    RESULT.write_text(json.dumps({"date": date.today().isoformat(), "rows": stored}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
