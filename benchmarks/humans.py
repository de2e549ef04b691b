# SPDX-License-Identifier: Apache-2.0
"""Held-out PSNR of a person's own pixels: as trained, and with one change at a time (paper, robustness).

    snakemake --cores 2 results/demo/humans/p0.ply                 # once: makes the inputs
    python -m benchmarks.humans [--scene results/demo] [--truth results/studio/demo/truth] [--people p0] [--only full
    "no network"]

Every row trains by ``humans.train`` with the configuration's settings and one change: masks eroded, fitted bodies
turned at random (one turn per joint for the whole clip, so that no average hides it), keypoints off by normal noise
before the body is fitted to them, poses not refined, no temporal network, no fingers. Pixels are those of photos 1280
wide, as the paper's are. Scores are of cameras no step reads, on every fifth frame: the PSNR on the pixels that the
truth calls the person's, also of those near head and hands, where a mask that is too small or a body beside itself
costs most, and as in the paper's table the PSNR of whole frames, with the room and everybody else as they were trained.
Losses are against the first row; seconds are of processor time. Table and machine go to
benchmarks/results/humans.json after every row; others stay.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person, write_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.geometry import rotations
from studiorecon.humans import train
from studiorecon.people import fit
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import concatenate
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.people import Detections, Person, read_detections, read_people, write_detections
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.defaults import loaded

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results" / "humans.json"
BODY = ROOT / "resources" / "body.npz"
STEP = 5


PHOTO_WIDTH = 1280
"""Of the paper's pixels."""


def eroded(photo_px: float) -> Callable[[np.ndarray], np.ndarray]:
    """Masks whose people have lost so much on every side, in whole pixels of the masks but at least one."""

    def change(labels: np.ndarray) -> np.ndarray:
        pixels = max(1, round(photo_px * labels.shape[1] / PHOTO_WIDTH))
        kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
        kept = np.zeros_like(labels)
        for label in np.unique(labels[labels > 0]):
            kept[cv2.erode((labels == label).astype(np.uint8), kernel) > 0] = label
        return kept

    return change


def turned(degrees: float) -> Callable[[Person], Person]:
    """Bodies with every joint but the root turned about a random axis by a normal angle of this deviation."""

    def change(person: Person) -> Person:
        rng = np.random.default_rng(0)
        noise = rotations.exp(rng.normal(0, np.deg2rad(degrees), (23, 3)) / np.sqrt(3))
        local = rotations.exp(person.poses.reshape(-1, 24, 3))
        local[:, 1:] = local[:, 1:] @ noise
        return replace(person, poses=rotations.log(local).reshape(-1, 72))

    return change


def off(photo_px: float) -> Callable[[Detections, int], Detections]:
    """Keypoints of a camera, whose pictures are so wide, with normal noise of this deviation on each coordinate, anew
    in every frame."""

    def change(seen: Detections, width: int) -> Detections:
        rng = np.random.default_rng([7, *seen.camera.encode()])
        noise = rng.normal(0, photo_px * width / PHOTO_WIDTH, (*seen.keypoints.shape[:2], 2))
        return replace(
            seen, keypoints=np.concatenate([seen.keypoints[..., :2] + noise, seen.keypoints[..., 2:]], axis=2)
        )

    return change


def without_fingers(person: Person) -> Person:
    """The person as of a fit that saw no hands."""
    return replace(person, hand_poses=None, hand_joints=None, hand_sigma=None, hand_scale=None)


# Joints about which parts are, and their radius.
PARTS: dict[str, tuple[list[int], float]] = {"head": ([15], 0.18), "hands": ([22, 23], 0.11)}

ROWS: dict[str, dict[str, Any]] = {
    "full": {},
    "no network": {"temporal": {"use": "never"}},
    "network of the paper's size": {"temporal": {"use": "always", "width": 256}},
    "poses as fitted": {"rates": {"pose_rad": 0.0}},
    "masks eroded by 5 px": {"masks": eroded(5)},
    "masks eroded by 10 px": {"masks": eroded(10)},
    "keypoints off by 3 px": {"keypoints": off(3)},
    "keypoints off by 5 px": {"keypoints": off(5)},
    "keypoints off by 12 px": {"keypoints": off(12)},
    "bodies turned by 3 degrees": {"body": turned(3.0)},
    "bodies turned by 5 degrees": {"body": turned(5.0)},
    "bodies turned by 5 degrees, poses as fitted": {"body": turned(5.0), "rates": {"pose_rad": 0.0}},
    "no fingers": {"body": without_fingers},
    "harmonics of degree 0": {"sh_degree": 0},
    "the paper's weight grid": {"skinning": "grid"},
}


def trained(scene: Path, person: str, changes: dict[str, Any], folder: Path) -> tuple[Path, Path, float]:
    """Files of one training and its processor seconds."""
    names = [camera.name for camera in read_model(scene / "cameras")]
    masks, fitted = [scene / f"masks/{name}.mkv" for name in names], scene / f"people/{person}.npz"
    changes = dict(changes)
    if change := changes.pop("masks", None):
        for k, (name, path) in enumerate(zip(names, masks)):
            masks[k] = folder / f"{name}.mkv"
            write_lossless(masks[k], [change(labels) for labels in read_frames(path, 0, None)], 30.0)
    if change := changes.pop("keypoints", None):
        fitted = refitted(scene, person, change, folder)
    if change := changes.pop("body", None):
        fitted = folder / f"fit/{person}.npz"
        fitted.parent.mkdir()
        write_person(fitted, change(read_person(scene / f"people/{person}.npz")))
    ply, npz, settings = folder / f"{person}.ply", folder / f"{person}.npz", loaded(train.Settings, **changes)
    begin = time.process_time()
    train.run(
        settings,
        person,
        train.Sources(
            scene / "cameras/images.txt",
            scene / "capture/manifest.json",
            scene / "people/people.tsv",
            [scene / f"capture/{name}.mkv" for name in names],
            masks,
            fitted,
            BODY,
        ),
        1,
        ply,
        npz,
        folder / "working",
    )
    return ply, npz, time.process_time() - begin


def refitted(scene: Path, person: str, change: Callable[[Detections, int], Detections], folder: Path) -> Path:
    """The person's body fitted to changed keypoints, who is who unchanged."""
    detections = []
    for camera in read_model(scene / "cameras"):
        detections.append(folder / f"{camera.name}.npz")
        write_detections(
            detections[-1], change(read_detections(scene / f"people/detections/{camera.name}.npz"), camera.wh[0])
        )
    settings, who, path = loaded(fit.Settings), scene / f"people/who/{person}.tsv", folder / f"fit/{person}.npz"
    path.parent.mkdir()
    fit.run(
        settings,
        person,
        scene / "cameras/images.txt",
        scene / "capture/manifest.json",
        detections,
        [who],
        [scene / "people/who/readouts.json"],
        BODY,
        path,
    )
    return path


def held_out_db(scene: Path, truth: Path, person: str, avatar: Avatar) -> dict[str, list[float]]:
    """PSNR of the person's pixels, those of their ``PARTS``, and whole frames, in every ``STEP``-th frame of every
    held-out camera that shows 60 of them."""
    rasteriser = Rasteriser(near_m=0.05, threads=1)
    room, model = read_ply(scene / "background/scene.ply"), BodyModel.load(BODY)
    joints_m = read_person(truth / f"bodies/{person}.npz").joints
    others = [
        read_avatar(scene / f"humans/{p}.ply", scene / f"humans/{p}.npz", model)
        for p in read_people(scene / "people/people.tsv")
        if p != person
    ]
    label = json.loads((truth / "truth.json").read_text())["people"].index(person) + 1
    found: dict[str, list[float]] = {name: [] for name in ("person", "frame", *PARTS)}
    for camera in read_model(scene / "cameras" / "heldout"):
        pictures, labels = (
            read_frames(truth / kind / f"{camera.name}.mkv", 0, avatar.frames) for kind in ("frames", "masks")
        )
        for frame, (photo, mask) in enumerate(zip(pictures, labels)):
            if frame % STEP or np.count_nonzero(mask == label) < 60:
                continue
            seen = camera.resized(photo.shape[1::-1])
            everything = concatenate([room, *(one.posed(frame) for one in (avatar, *others))])
            error, whole = (
                ((rasteriser.forward(drawn, seen, colour).rgb - photo / 255) ** 2).mean(-1)
                for drawn, colour in ((avatar.posed(frame), (0.3, 0.3, 0.3)), (everything, (0.0, 0.0, 0.0)))
            )
            parts = {"person": np.ones(mask.shape, bool)} | {
                n: near(seen, joints_m[frame], *p) for n, p in PARTS.items()
            }
            for name, part in parts.items():
                if np.count_nonzero(part & (mask == label)) >= 60:
                    found[name].append(float(-10 * np.log10(error[part & (mask == label)].mean())))
            found["frame"].append(float(-10 * np.log10(whole.mean())))
    return found


def near(camera: Camera, joints_m: np.ndarray, joints: list[int], radius_m: float) -> np.ndarray:
    """(H, W) where a picture shows what is within a radius of some joints."""
    pixels, depth_m = camera.project(joints_m[joints])
    rows, columns = np.indices(camera.hw)
    off = np.hypot(columns + 0.5 - pixels[:, 0, None, None], rows + 0.5 - pixels[:, 1, None, None])
    return (off < (radius_m * camera.focal_px[0] / depth_m)[:, None, None]).any(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, default=Path("results/demo"))
    parser.add_argument("--truth", type=Path, default=Path("results/studio/demo/truth"))
    parser.add_argument("--people", nargs="+", default=["p0"])
    parser.add_argument("--only", nargs="+", choices=list(ROWS), default=list(ROWS))
    options = parser.parse_args()
    stored = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    table: dict[str, dict[str, float]] = stored.get("rows", {}) if stored.get("people") == options.people else {}
    for name in options.only:
        scores: dict[str, list[float]] = {}
        seconds = 0.0
        for person in options.people:
            with tempfile.TemporaryDirectory() as folder:
                ply, npz, spent = trained(options.scene, person, ROWS[name], Path(folder))
                avatar = read_avatar(ply, npz, BodyModel.load(BODY))
                for part, own in held_out_db(options.scene, options.truth, person, avatar).items():
                    scores.setdefault(part, []).extend(own)
                seconds += spent
        means = {f"{part}_db": np.mean(own) for part, own in scores.items() if own}
        means["worst_person_db"] = np.min(scores["person"])
        table[name] = {key: round(float(value), 3) for key, value in means.items()} | {"cpu_s": round(seconds, 1)}
        for row in table.values() if "full" in table else ():
            row |= {
                f"{kind}_loss_db": round(table["full"][f"{kind}_db"] - row[f"{kind}_db"], 3)
                for kind in ("person", "frame")
            }
        print(f"{name}: {table[name]}", flush=True)
        machine = {
            "processor": platform.processor(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "numpy": np.__version__,
        }
        rows = {row: table[row] for row in ROWS if row in table}
        RESULTS.write_text(json.dumps({"machine": machine, "people": options.people, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
