# SPDX-License-Identifier: Apache-2.0
"""Cost and accuracy of checking, refining and estimating cameras, on planted truth and real captures. Run by hand.

    OMP_NUM_THREADS=1 STUDIORECON_REAL_DATA=... python -m benchmarks.cameras [--seeds 5] [--pose2sim PYTHON]

Prints a table and writes benchmarks/results/cameras.json. Seconds are this process's own processor time beside wall
time, because other work on the machine counts in the latter. Bars: refinement ≤ 2 s; the doctor < 60 s; cameras found
from 60 frames of two people at 3 px within 1° and 3 cm; board corners ≤ 1.1 px median and lengths within 0.5 %; the
real man ≤ 25 mm from body to triangulated keypoints, ≤ 7 px median. ``--pose2sim`` is the Python of an environment with
that package: both triangulate the same keypoints with the same calibration, and are compared on keypoints that both use
(likelihood 0.4).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.calibration import doctor, from_people
from studiorecon.calibration import files as calibration
from studiorecon.cameras import refine
from studiorecon.clocks import moments
from studiorecon.clocks import offsets as clocks
from studiorecon.detect import keypoints as sightings
from studiorecon.geometry.lens import calibration_from_video_pixels, normalised_from_calibration
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people import fit
from studiorecon.people.fitting.points import Points, person_keypoints, triangulate_keypoints
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.files import read_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.scene.schema import record
from studiorecon.tracks import keypoints as tracks_keypoints

from benchmarks.pose2sim_peer import pose2sim_points
from tests.defaults import UNSEARCHED, loaded
from tests.made.cameras import detect, ring, walk
from tests.made.imported import imported
from tests.made.take import after_similarity, made_take

ROOT = Path(__file__).resolve().parents[1]
RESULT = Path(__file__).parent / "results" / "cameras.json"
MAN = ("cam01", "cam02", "cam03", "cam04")
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
BONES = [(f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in _BONES]


def timed(call: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    wall, own = time.perf_counter(), time.process_time()
    answer = call()
    return answer, {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - own}


def refinement() -> dict[str, Any]:
    """A ring of four, one camera knocked by 1.2° and 5 cm, two people for 100 frames at 2 px."""
    truth, people = ring(), [walk([-1.2, -0.5, 0], [0.02, 0.01, 0], 100), walk([1.1, 0.9, 0], [0, -0.02, 0], 100, 2.0)]
    pose = truth[0].camera_from_world.copy()
    pose[:3, 3] += [0.05, 0.0, 0.02]
    given, seen = (
        [replace(truth[0], camera_from_world=pose), *truth[1:]],
        detect(truth, people, 2.0, np.random.default_rng(0)),
    )
    settings = loaded(refine.Settings)
    refine.decide(given, [], seen, 100, 30.0, True, settings)
    outcome, cost = timed(lambda: refine.decide(given, [], seen, 100, 30.0, True, settings))
    return {
        **cost,
        **{k: outcome.report[k] for k in ("before_px", "after_px", "before_px_per_camera", "after_px_per_camera")},
    }


def found_from_people(seeds: int) -> list[dict[str, Any]]:
    template = from_people.mean_body(BodyModel.load(ROOT / "resources/body.npz"))
    rows = []
    for seed in range(seeds):
        for lenses in ("focal lengths given", "focal lengths unknown"):
            truth, seen = made_take(seed=seed, occluded=False)
            focal = {c.name: c.focal_px[0] for c in truth} if lenses == "focal lengths given" else {}
            (cameras, report), cost = timed(
                lambda seen=seen, truth=truth, focal=focal: from_people.pose_cameras(
                    seen, [c.wh for c in truth], focal, 60, template, loaded(from_people.Settings)
                )
            )
            degrees, metres, scale = after_similarity(cameras, truth)
            claimed = max(report["sigma_deg"].values()), max(report["sigma_m"].values())
            rows.append(
                {
                    "seed": seed,
                    "lenses": lenses,
                    "worst_deg": degrees.max(),
                    "worst_m": metres.max(),
                    "scale": scale,
                    "claimed_deg": claimed[0],
                    "claimed_m": claimed[1],
                    **cost,
                }
            )
    return rows


def board(data: Path) -> dict[str, Any]:
    """Corners of a board that four webcams saw: reprojection and lengths of the triangulated corners against the true
    ones."""
    folder = data / "caliscope_webcams"
    names = [f"cam_{i}" for i in range(4)]
    reading = calibration.read_calibration([folder / "camera_array.toml"])
    lenses = calibration.paired_lenses(reading, "camera_array.toml", names, {}, loaded(calibration.Settings))[0]
    seen: dict[tuple[str, str], dict[int, np.ndarray]] = {}
    place: dict[str, np.ndarray] = {}
    with (folder / "calibration_session" / "xy.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            seen.setdefault((row["sync_index"], row["keypoint_id"]), {})[int(row["cam_id"])] = (
                np.array([float(row["img_loc_x"]), float(row["img_loc_y"])]) + 0.5
            )
            place[row["keypoint_id"]] = np.array([float(row["board_loc_x"]), float(row["board_loc_y"])])
    keys = [k for k, views in seen.items() if len(views) >= 2]
    raw = np.full((4, len(keys), 2), np.nan)
    for n, key in enumerate(keys):
        for v, pixel in seen[key].items():
            raw[v, n] = pixel
    cameras = [Camera(lens.name, lens.wh, lens.intrinsics, lens.camera_from_world) for lens in lenses]
    pixels = np.stack([straight(raw[v], lens) for v, lens in enumerate(lenses)])
    limits = Limits(min_confidence=0.1, huber_share=0.005, outlier_units=3.0, min_angle_deg=2.0, near_m=0.1)
    found = triangulate(pixels, np.isfinite(pixels).all(-1).astype(float), cameras, limits)
    error = found.error_px[:, found.valid]
    ratios = []
    for moment in {k[0] for k in keys}:
        corners = [n for n, k in enumerate(keys) if k[0] == moment and found.valid[n]]
        for i, a in enumerate(corners):
            for b in corners[i + 1 :]:
                true = np.linalg.norm(place[keys[a][1]] - place[keys[b][1]])
                ratios.append(np.linalg.norm(found.points_m[a] - found.points_m[b]) / true)
    return {
        "corners": int(found.valid.sum()),
        "median_px": float(np.nanmedian(error)),
        "p95_px": float(np.nanquantile(error, 0.95)),
        "length_ratio_median": float(np.median(ratios)),
        "pairs": len(ratios),
    }


def straight(pixels: np.ndarray, lens: Lens) -> np.ndarray:
    """Pixels (N, 2) as the pinhole of the lens's own intrinsics sees them, NaN where unknown."""
    known = np.isfinite(pixels).all(-1)
    rays, valid = normalised_from_calibration(np.where(known[:, None], pixels, 1.0), lens)
    focal = np.array([lens.intrinsics[0, 0], lens.intrinsics[1, 1]])
    return np.where((known & valid)[:, None], rays * focal + lens.intrinsics[:2, 2], np.nan)


def real_doctor(data: Path, take: str, out: Path) -> tuple[dict[str, Any], list[Camera], list[Detections], list[Lens]]:
    """All steps of ``snakemake doctor`` on a real capture, one after another, without Snakemake's own seconds."""
    dataset = open_dataset(data / "pose2sim_balancing" / take, ROOT / f"tests/captures/pose2sim_{take}.yaml")

    def steps() -> None:
        maps = json.dumps(dict(dataset.pixel_maps))
        imported(loaded(calibration.Settings), list(dataset.calibration), list(MAN), maps, out / "calibration.json")
        for c in MAN:
            about = dataset.keypoint_layout, str(dataset.keypoint_first_frame.get(c, "auto")), dataset.footage[c]
            pixel_map = json.dumps(dataset.pixel_maps[c])
            found = out / f"{c}.npz", out / f"{c}.recorded.npz", out / f"{c}.json", [], []
            sightings.run(loaded(tracks_keypoints.Settings), c, [dataset.keypoints[c]], *about, 60.0, pixel_map, *found)
        footage, seen = [dataset.footage[c] for c in MAN], [out / f"{c}.npz" for c in MAN]
        lags, written = out / "lags.json", (out / "clocks.json", out / "sync.json")
        filmed = clocks.Take(list(MAN), footage)
        moments.run(loaded(clocks.Settings), filmed, 0, lags, *UNSEARCHED)
        clocks.run(loaded(clocks.Settings), filmed, seen, lags, *written)
        doctor.run(
            loaded(doctor.Settings),
            take,
            out / "calibration.json",
            list(MAN),
            footage,
            seen,
            [out / f"{c}.json" for c in MAN],
            out / "clocks.json",
            out / "sync.json",
            out / "doctor.json",
            out / "doctor.html",
        )

    _, cost = timed(steps)
    report = read_json(out / "doctor.json")
    lenses = [record(Lens, v) for v in read_json(out / "calibration.json")["lenses"]]
    sizes = [tuple(read_json(out / f"{c}.json")["wh"]) for c in MAN]
    both = [to_pinhole(read_detections(out / f"{c}.npz"), lens, wh) for c, lens, wh in zip(MAN, lenses, sizes)]
    reported = {
        "verdict": report["verdict"],
        "advice": report["advice"],
        "lags": {c: v["frames"] for c, v in report["sync"]["lags_frames"].items()},
    }
    return {**cost, **reported}, [c for c, _ in both], [d for _, d in both], lenses


def the_man(
    cameras: list[Camera], seen: list[Detections], lenses: list[Lens], data: Path, pose2sim: Path | None, out: Path
) -> dict[str, Any]:
    """The man of ``single`` after refinement: keypoints, body, and the same keypoints through Pose2Sim."""
    refining = loaded(refine.Settings)
    refine.decide(cameras, [], seen, 100, 30.0, True, refining)
    outcome, cost = timed(lambda: refine.decide(cameras, [], seen, 100, 30.0, True, refining))
    body = BodyModel.load(ROOT / "resources/body.npz")
    everybody = {(d.camera, int(t)): "p0" for d in seen for t in np.unique(d.track)}
    names, keypoints = person_keypoints("p0", seen, everybody, body, 100)
    settings = loaded(fit.Settings)
    points = _lifted(names, keypoints, outcome.training, settings)
    person, _ = fit.fit_person("p0", points, body, 60.0, settings)
    on_body = body.keypoints(names, person.poses, person.betas, person.trans)
    known = np.isfinite(points.points_m).all(-1)
    ours, fitted = _named(names, points), _named(names, replace(points, points_m=on_body))
    report = {
        **cost,
        "before_px": outcome.report["before_px"],
        "after_px": outcome.report["after_px"],
        "freedom": outcome.report["freedom"],
        "body_to_points_mean_mm": 1000 * float(np.linalg.norm(on_body - points.points_m, axis=-1)[known].mean()),
        "ours": scored(ours, outcome.training, seen, lenses),
        "ours, the given cameras": scored(
            _named(names, _lifted(names, keypoints, cameras, settings)), cameras, seen, lenses
        ),
        "ours, the body": scored(fitted, outcome.training, seen, lenses),
    }
    if pose2sim is not None:
        folder = data / "pose2sim_balancing"
        file = folder / "calibration" / "Calib_scene.toml"
        theirs = pose2sim_points(pose2sim, file, folder / "pose2d_body25b_single", list(MAN), out / "pose2sim")
        english = {"L": "left_", "R": "right_"}
        toes = {"bigtoe": "big_toe", "smalltoe": "small_toe"}
        renamed = {
            english[n[0]] + toes.get(n[1:].lower(), n[1:].lower()): v for n, v in theirs.items() if n[0] in english
        }
        report["pose2sim"] = scored(renamed, cameras, seen, lenses)
    return report


def _lifted(names: list[str], keypoints: np.ndarray, cameras: list[Camera], settings: fit.Settings) -> Points:
    return triangulate_keypoints(names, keypoints, cameras, settings.triangulation, settings.fit.unverified_sigma_m)


def _named(names: list[str], points: Points) -> dict[str, np.ndarray]:
    return {n: points.points_m[:, i] for i, n in enumerate(names)}


def scored(
    points: dict[str, np.ndarray], cameras: list[Camera], seen: list[Detections], lenses: list[Lens]
) -> dict[str, float]:
    """Median reprojection error in pixels of the calibration, over confident keypoints of trunk and limbs, and of all
    that ``points`` have; mean over bones of the standard deviation of their lengths (mm)."""
    stable, everything = [], []
    for camera, d, lens in zip(cameras, seen, lenses):
        per_px = float(calibration_from_video_pixels(lens, camera.wh)[0, 0])
        for column, name in enumerate(LAYOUTS[d.layout].keypoints):
            if name in points:
                sure = d.keypoints[:, column, 2] >= 0.4
                off = camera.project(points[name][d.frame[sure]])[0] - d.keypoints[sure, column, :2]
                everything.append(per_px * np.linalg.norm(off, axis=-1))
                if name in STABLE_KEYPOINTS:
                    stable.append(everything[-1])
    flat = np.concatenate(stable)
    spread = [1000 * float(np.nanstd(np.linalg.norm(points[a] - points[b], axis=-1))) for a, b in BONES]
    return {
        "median_px": float(np.nanmedian(flat)),
        "p95_px": float(np.nanquantile(flat, 0.95)),
        "missing": float(np.isnan(flat).mean()),
        "all_median_px": float(np.nanmedian(np.concatenate(everything))),
        "bone_spread_mm": float(np.mean(spread)),
    }


def real_uncalibrated(cameras: list[Camera], seen: list[Detections]) -> dict[str, Any]:
    """The man's cameras from his keypoints and nothing but focal lengths, against the calibration as it was given."""
    template, settings = (
        from_people.mean_body(BodyModel.load(ROOT / "resources/body.npz")),
        loaded(from_people.Settings),
    )
    focal = {c.name: float(np.mean(c.focal_px)) for c in cameras}
    (found, report), cost = timed(
        lambda: from_people.pose_cameras(seen, [c.wh for c in cameras], focal, 100, template, settings)
    )
    degrees, metres, scale = after_similarity(found, cameras)
    return {
        **cost,
        "worst_deg": degrees.max(),
        "worst_m": metres.max(),
        "scale": scale,
        "median_px": report["median_px"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--pose2sim", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {
        "date": date.today().isoformat(),
        "machine": platform.machine(),
        "refinement": refinement(),
    }
    row("refinement, made ring", result["refinement"], ("cpu_s", "wall_s", "before_px", "after_px"))
    result["found_from_people"] = found_from_people(options.seeds)
    for found in result["found_from_people"]:
        keys = "worst_deg", "worst_m", "claimed_deg", "claimed_m", "scale", "cpu_s"
        row(f"found from people, seed {found['seed']}, {found['lenses']}", found, keys)
    if data := os.environ.get("STUDIORECON_REAL_DATA"):
        result["board"] = board(Path(data))
        row("caliscope_webcams, board", result["board"], ("median_px", "p95_px", "length_ratio_median"))
        for take in ("single", "multi"):
            with tempfile.TemporaryDirectory() as folder:
                reported, cameras, seen, lenses = real_doctor(Path(data), take, Path(folder))
                result[f"doctor_{take}"] = reported
                row(f"doctor, pose2sim {take}: {reported['verdict']}", reported, ("cpu_s", "wall_s"))
                if take == "single":
                    result["man_uncalibrated"] = real_uncalibrated(cameras, seen)
                    result["man"] = the_man(cameras, seen, lenses, Path(data), options.pose2sim, Path(folder))
        row(
            "the real man's cameras from himself",
            result["man_uncalibrated"],
            ("worst_deg", "worst_m", "scale", "median_px", "cpu_s"),
        )
        man = result["man"]
        row("the real man, refinement", man, ("cpu_s", "before_px", "after_px", "body_to_points_mean_mm"))
        for name in ("ours", "ours, the given cameras", "ours, the body", "pose2sim"):
            if name in man:
                row(
                    f"the real man, {name}",
                    man[name],
                    ("median_px", "p95_px", "all_median_px", "missing", "bone_spread_mm"),
                )
    RESULT.write_text(json.dumps(result, indent=1, default=float) + "\n", encoding="utf-8")


def row(name: str, values: dict[str, Any], keys: tuple[str, ...]) -> None:
    print(f"{name:56}" + "  ".join(f"{k} {values[k]:.3f}" for k in keys), flush=True)


if __name__ == "__main__":
    main()
