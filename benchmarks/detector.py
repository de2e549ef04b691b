# SPDX-License-Identifier: Apache-2.0
"""Cost, detection rate and accuracy of the built-in detector, and of bodies from it against those of keypoint files.

``python -m benchmarks.detector [--parts cost people single multi demo] [--detector blazepose_heavy] [--folder DIR]``
from the repository's root; writes ``benchmarks/results/detector.json``. Other parts keep their last figures.
``single``, ``multi`` and ``demo`` run the workflow up to the bodies in DIR, and go on where they were. Seconds are
processor time: cameras run in parallel.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
import yaml
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.detect import people as detect
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.source import open_source
from studiorecon.people import second_look
from studiorecon.report.metrics.identities import score_identities
from studiorecon.scene.files import read_table
from studiorecon.scene.people import PEOPLE_COLUMNS, read_detections, read_identities, read_people
from studiorecon.scene.raw_detections import read_raw_detections

from tests.defaults import loaded

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("STUDIORECON_REAL_DATA", ROOT.parent / "shared/data")).resolve()
RESULTS = Path(__file__).parent / "results" / "detector.json"
FILES = {"blazepose": "pose_landmark_full.onnx", "blazepose_heavy": "pose_landmark_heavy.onnx"}
# Left, top, right, bottom of the three people in each picture of egohumans, read by hand off pictures 728 pixels wide.
MARKED = (
    ((415, 0, 540, 395), (120, 215, 310, 409), (160, 150, 300, 260)),
    ((290, 48, 357, 225), (352, 128, 437, 285), (217, 128, 300, 320)),
    ((278, 126, 330, 326), (308, 209, 470, 399), (420, 211, 500, 336)),
    ((235, 194, 324, 339), (392, 121, 462, 296), (352, 203, 442, 381)),
)
BARS = {
    "two_cores_ms_per_person_and_picture": 60.0,
    "single_reprojection_px": 1.3,
    "single_bodies_mm": 20.0,
    "egohumans_found": 11,
    "multi_people": 3,
    "demo_joints_mm": 20.0,
    "demo_identities_kept": 1.0,
}


def networks(detector: str) -> list[Path]:
    """The detector's files."""
    return [
        ROOT / "resources/detector" / name for name in ("movenet_multipose.onnx", FILES[detector], "confidence.json")
    ]


def find_people(camera: str, source: Path, detector: str, found: Path) -> None:
    """Write the people of a whole film to ``found``."""
    detect.run(camera, source, [], [], 30.0, DetectorFiles(networks(detector)), found)


def look_again(
    scene: Path, camera: str, video: Path, folder: Path, detector: str, hands: Literal["auto", "on", "off"] = "auto"
) -> None:
    """The second look of one camera of a finished ``scene`` at ``folder``/found.npz; writes into ``folder``."""
    second_look.run(
        replace(loaded(second_look.Settings), hands=hands),
        camera,
        second_look.CameraFiles(
            video,
            30.0,
            scene / "capture/manifest.json",
            scene / "calibration/calibration.json",
            scene / "clocks/clocks.json",
        ),
        second_look.FirstFiles(
            folder / "found.npz",
            [scene / f"tracks/{c.name}.npz" for c in read_model(scene / "cameras")],
            scene / "people/first/identities.tsv",
        ),
        DetectorFiles(networks(detector)),
        [ROOT / "resources/detector/hand_landmark_full.onnx"],
        scene / "cameras/images.txt",
        ROOT / "resources/body.npz",
        *(folder / name for name in ("detections.npz", "seen.npz", "report.json")),
    )


def cost(detector: str, folder: Path) -> dict[str, Any]:
    """Processor milliseconds per person and picture of a whole film with two people, all told: decoding, finding,
    following, and the second look. Two cores halve it. Runs ``multi`` first where DIR has none."""
    scene, camera = folder / "results/multi", "cam03"
    if not (scene / "people/first/identities.tsv").exists():
        multi(detector, folder)
    video = DATA / f"pose2sim_balancing/multi/videos/{camera}.mp4"
    began = time.process_time()
    find_people(camera, video, detector, folder / "found.npz")
    first_s = time.process_time() - began
    look_again(scene, camera, video, folder, detector)
    spent_s = time.process_time() - began
    people = len(read_raw_detections(folder / "seen.npz").frame)
    return {
        "cpu_ms_per_person_and_picture": round(1000 * spent_s / people, 1),
        "cpu_ms_of_it_second_look": round(1000 * (spent_s - first_s) / people, 1),
        "two_cores_ms_per_person_and_picture": round(500 * spent_s / people, 1),
    }


def people_in_pictures(detector: str, folder: Path) -> dict[str, Any]:
    """Whom the detector alone finds in the four single pictures of egohumans, each a capture of one frame, of the three
    people that were marked by hand in each.

    Somebody is found when the box of a skeleton's surer landmarks and the marked box overlap by 0.4 (intersection over
    union).
    """
    found, others, spent_s = [], [], time.process_time()
    for path, marked in zip(sorted((DATA / "egohumans_lego_4view/images").glob("*.jpg")), MARKED):
        one = folder / path.stem
        one.mkdir(exist_ok=True, parents=True)
        if not (one / path.name).exists():
            (one / path.name).symlink_to(path)
        find_people(path.stem, one, detector, folder / f"{path.stem}.npz")
        boxes = [box_of(keypoints) for keypoints in read_raw_detections(folder / f"{path.stem}.npz").keypoints]
        share = open_source(one, 30.0).wh[0] / 728
        overlaps = np.array([[overlap(np.array(m) * share, box) for box in boxes] for m in marked])
        rows, columns = scipy.optimize.linear_sum_assignment(-overlaps.reshape(3, len(boxes)))
        found.append(int((overlaps[rows, columns] >= 0.4).sum()))
        others.append(len(boxes) - found[-1])
    return {
        "egohumans_found": sum(found),
        "egohumans_found_in_each": found,
        "egohumans_other_skeletons": others,
        "egohumans_cpu_s_per_picture": round((time.process_time() - spent_s) / len(found), 1),
    }


def box_of(keypoints: np.ndarray) -> np.ndarray:
    """(4,) left, top, right, bottom of the surer landmarks (K, 3)."""
    sure = keypoints[keypoints[:, 2] > 0.3, :2]
    return np.array([*sure.min(0), *sure.max(0)]) if len(sure) else np.zeros(4)


def overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of two boxes."""
    shared = np.prod(np.maximum(np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2]), 0))
    return float(shared / (np.prod(first[2:] - first[:2]) + np.prod(second[2:] - second[:2]) - shared + 1e-9))


def workflow(folder: Path, targets: list[str], cores: int = 2, **config: str) -> None:
    """Run the workflow in ``folder`` up to ``targets``."""
    given = ["--config", *(f"{key}={value}" for key, value in config.items())] if config else []
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile")]
    command += ["--cores", str(cores), "--directory", str(folder)]
    subprocess.run([*command, *targets, *given], check=True, capture_output=True)


def rigid_mm(first: np.ndarray, second: np.ndarray) -> float:
    """Mean distance of joints (T, 24, 3) after the one rigid motion that lays all of the first on the second,
    millimetres."""
    a, b = first.reshape(-1, 3), second.reshape(-1, 3)
    rotation, _ = scipy.spatial.transform.Rotation.align_vectors(b - b.mean(0), a - a.mean(0))
    return float(1000 * np.linalg.norm(rotation.apply(a - a.mean(0)) - (b - b.mean(0)), axis=1).mean())


def single(detector: str, folder: Path) -> dict[str, Any]:
    """The real man: reprojection after refinement, and his bodies from pictures against those from the shipped
    keypoints."""
    take = DATA / "pose2sim_balancing/single"
    described = ROOT / "tests/captures/pose2sim_single.yaml"
    fits, reported = {}, {}
    for name, source in (("found", "detector"), ("recorded", "keypoints")):
        looked = json.dumps({"source": source, "detector": detector})
        # The cameras of this take were triggered together: only what people's places say is compared here, not their
        # clocks.
        given = {
            "dataset": str(take),
            "capture_yaml": str(described),
            "scene": name,
            "detect": looked,
            "clocks": '{"sync": "never"}',
        }
        workflow(folder, [f"results/{name}/people/p0.npz"], **given)
        fits[name] = read_person(folder / f"results/{name}/people/p0.npz")
        refined = json.loads((folder / f"results/{name}/cameras/refinement.json").read_text())
        reported[name] = round(refined["after_px"], 2)
    both = fits["found"].valid & fits["recorded"].valid
    return {
        "single_reprojection_px": reported["found"],
        "single_reprojection_of_recorded_keypoints_px": reported["recorded"],
        "single_bodies_mm": round(rigid_mm(fits["found"].joints[both], fits["recorded"].joints[both]), 1),
        "single_people": len(read_people(folder / "results/found/people/people.tsv")),
    }


def multi(detector: str, folder: Path) -> dict[str, Any]:
    """The real man and a woman who was composited in, from pictures alone: no keypoints, no plates. Who is found, in
    which cameras, and how far the man is from himself in ``single`` (whose frames are one earlier), where that was
    run."""
    described = yaml.safe_load((ROOT / "tests/captures/pose2sim_multi.yaml").read_text(encoding="utf-8"))
    kept = {key: value for key, value in described.items() if not key.startswith(("keypoint", "plates"))}
    (folder / "multi.yaml").write_text(yaml.safe_dump(kept), encoding="utf-8")
    given = {
        "dataset": str(DATA / "pose2sim_balancing/multi"),
        "capture_yaml": str(folder / "multi.yaml"),
        "scene": "multi",
        "detect": json.dumps({"source": "detector", "detector": detector}),
        "clocks": '{"sync": "never"}',
    }
    people = folder / "results/multi/people"
    workflow(folder, ["results/multi/people/people.tsv"], **given)
    table = read_table(people / "people.tsv", PEOPLE_COLUMNS)
    found = {row["person"]: row["cameras"] for row in table if row["status"] == "person"}
    workflow(folder, [f"results/multi/people/{name}.npz" for name in found], **given)
    tracks = read_identities(people / "identities.tsv")
    figures: dict[str, Any] = {
        "multi_people": len(found),
        "multi_tracks_of_nobody": f"{sum(not person for person in tracks.values())} of {len(tracks)}",
        "multi_cameras_of_each": found,
        "multi_left_out": {row["person"]: row["reason"] for row in table if row["status"] != "person"},
    }
    alone = folder / "results/found/people/p0.npz"
    if alone.exists():
        man = read_person(alone)
        gaps = {}
        for name in found:
            fitted = read_person(people / f"{name}.npz")
            both = fitted.valid[1:] & man.valid[: len(fitted.valid) - 1]
            joints = fitted.joints[1:][both], man.joints[: len(fitted.valid) - 1][both]
            gaps[name] = round(rigid_mm(*joints), 1)
        figures["multi_man_against_single_mm"] = min(gaps.values())
    return figures


def demo(detector: str, folder: Path) -> dict[str, Any]:
    """The demo's people from its films, against the truth: joints, and the share of tracks in the right person's
    name."""
    targets = [f"results/demo/people/{p}.npz" for p in ("p0", "p1")]
    workflow(folder, targets, detect=json.dumps({"detector": detector}))
    truth = {p.stem: read_person(p) for p in sorted((folder / "results/studio/demo/truth/bodies").glob("*.npz"))}
    errors, whose = {}, {}
    for name in read_people(folder / "results/demo/people/people.tsv"):
        fitted = read_person(folder / f"results/demo/people/{name}.npz")
        gaps = {who: 1000 * np.linalg.norm(fitted.joints - true.joints, axis=-1).mean() for who, true in truth.items()}
        whose[name] = min(gaps, key=lambda who: gaps[who])
        errors[name] = round(float(gaps[whose[name]]), 1)
    tracks = read_identities(folder / "results/demo/people/identities.tsv")
    cameras = {c.name: c for c in read_model(folder / "results/demo/cameras")}
    seen = [read_detections(folder / f"results/demo/people/detections/{name}.npz") for name in cameras]
    scores = score_identities(seen, tracks, cameras, {name: true.joints for name, true in truth.items()})
    return {
        "demo_identities_kept": round(scores["idf1"], 4),
        "demo_identities_right": round(scores["precision"], 4),
        "demo_joints_mm": round(float(np.mean(list(errors.values()))), 1),
        "demo_joints_mm_of_each": errors,
        "demo_people": f"{len(set(whose.values()))} of {len(truth)}, {len(errors)} found",
        "demo_tracks_of_nobody": sum(not person for person in tracks.values()),
    }


PARTS = {"cost": cost, "people": people_in_pictures, "single": single, "multi": multi, "demo": demo}


def main() -> None:
    """Print one line per figure, with its bar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--detector", choices=FILES, default="blazepose_heavy")
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    for part in given.parts:
        figures = PARTS[part](given.detector, folder.resolve())
        stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        stored.setdefault(given.detector, {}).update(figures)
        RESULTS.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n")
        for name, value in figures.items():
            print(f"{given.detector}: {name} {value}" + (f" (bar {BARS[name]})" if name in BARS else ""), flush=True)


if __name__ == "__main__":
    main()
