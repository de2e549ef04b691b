# SPDX-License-Identifier: Apache-2.0
"""Scores of the empty room at held-out cameras: the defaults, one change at a time, and the baselines.

    snakemake --cores 2 results/demo/background/scene.ply results/demo/cameras/heldout/images.txt     # once: makes the
    inputs python -m benchmarks.background [--scene results/demo] [--truth results/studio/demo/truth] [--seeds 0 1]

Every row trains by ``background.train`` with the configuration's settings and its own changes, and is scored at the
held-out cameras against their exact plates: all pixels, those whose surface a training camera sees (by the true depth,
within 5 %) and the others, means over cameras and seeds. The last row trains nothing: photos warped to the held-out
cameras through their depth, holes painted. ``gain_*`` is what the first row has over each. Writes
benchmarks/results/background.json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.background import train
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.stills import read_plate
from studiorecon.images.metrics import psnr, ssim, ssim_map
from studiorecon.report.metrics.truth import is_visible, read_views, true_pixels
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.views import synthesize

from tests.defaults import loaded
from tests.made.steps import call

RESULTS = Path(__file__).parent / "results" / "background.json"
FOUR_PHOTOS = {"views_share": 0.0, "fill_unseen": False}
ROWS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "without views between the photos": {"views_share": 0.0},
    "without discs where nobody sees": {"fill_unseen": False},
    "the four photos alone, from their depth": FOUR_PHOTOS,
    "the four photos alone, from anywhere": {**FOUR_PHOTOS, "start": "random"},
    "with true depth": {"true_depth": True},
}
WARPED = "photos warped and painted, nothing trained"
_SEEN = 0.05


def options_of(scene: Path, threads: int) -> dict[str, Any]:
    """Arguments of ``background.train`` for a finished scene folder."""
    cameras = [camera.name for camera in read_model(scene / "cameras")]
    views = sorted(path for path in (scene / "views").glob("*.mkv") if ".mask" not in path.name)
    return {
        "model": scene / "cameras/images.txt",
        "plates": [scene / f"plates/{c}.png" for c in cameras],
        "depths": [scene / f"depth/{c}.exr" for c in cameras],
        "room_box": scene / "depth/room.json",
        "path": scene / "views/path.json",
        "views": views,
        "supports": [path.with_suffix(".mask.mkv") for path in views],
        "threads": threads,
    }


def inputs_of(scene: Path, truth: Path, true_depth: bool, threads: int, folder: Path) -> dict[str, Any]:
    """Arguments of ``background.train`` for a finished scene, with its own or the true depth and what was warped
    through it."""
    options = options_of(scene, threads) | {"specularity": []}
    if true_depth:
        options["depths"] = [truth / "depth" / path.name for path in options["depths"]]
        warped = {
            "path": options["path"],
            "model": options["model"],
            "plates": options["plates"],
            "depths": options["depths"],
            "gains": [],
        }
        settings = loaded(synthesize.Settings)
        for film in options["views"]:
            support = folder / f"{film.stem}.mask.mkv"
            synthesize.run(settings, film.stem, **warped, views=folder / film.name, support=support)
        options["views"] = [folder / film.name for film in options["views"]]
        options["supports"] = [film.with_suffix(".mask.mkv") for film in options["views"]]
    return options


def wanted(scene: Path, truth: Path) -> list[tuple[Camera, np.ndarray, np.ndarray]]:
    """Held-out cameras with their exact plate (H, W, 3) and (H, W) bool: a training camera sees the surface."""
    known, training, found = read_views(truth), [c.name for c in read_model(scene / "cameras")], []
    for camera in read_model(scene / "cameras/heldout"):
        own = known[camera.name]
        plate, _ = read_plate(truth / f"plates/{camera.name}.png")
        if own.camera.wh != camera.wh:
            raise SystemExit(
                f"{camera.name} was filmed at {own.camera.wh} and is worked on at "
                f"{camera.wh}: take a studio of the working size"
            )
        depth_m = own.room_depth_m
        real = np.isfinite(depth_m) & (depth_m > 0)
        points = own.camera.unproject(true_pixels(camera, own.camera), np.where(real, depth_m, 1.0).astype(np.float64))
        seen = [is_visible(points, real, known[name].camera, known[name].room_depth_m, _SEEN)[0] for name in training]
        found.append((camera, plate, np.any(seen, axis=0)))
    return found


def scored(pictures: list[np.ndarray], views: list[tuple[Camera, np.ndarray, np.ndarray]]) -> dict[str, float]:
    """Means over the held-out cameras."""
    rows = [
        (psnr(p, plate), psnr(p, plate, seen), psnr(p, plate, ~seen), ssim(ssim_map(p, plate)))
        for p, (_, plate, seen) in zip(pictures, views, strict=True)
    ]
    return dict(zip(("psnr_db", "seen_db", "unseen_db", "ssim"), np.mean(rows, axis=0).tolist(), strict=True))


def written(table: dict[str, dict[str, float]], seeds: list[int]) -> None:
    """The file with what is known so far."""
    first, rows = table["as it is"], {}
    for name, row in table.items():
        gains = {f"gain_{key}": first[key] - row[key] for key in ("psnr_db", "seen_db", "ssim")}
        rows[name] = {key: round(value, 3) for key, value in (row | gains).items()}
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    RESULTS.write_text(json.dumps({"machine": machine, "seeds": seeds, "rows": rows}, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, default=Path("results/demo"))
    parser.add_argument("--truth", type=Path, default=Path("results/studio/demo/truth"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    views, rasteriser, table = wanted(options.scene, options.truth), Rasteriser(near_m=0.1), {}
    for name, changes in ROWS.items():
        changes = dict(changes)
        with tempfile.TemporaryDirectory() as place:
            given = inputs_of(
                options.scene, options.truth, changes.pop("true_depth", False), options.threads, Path(place)
            )
            runs, began = [], time.process_time()
            for seed in options.seeds:
                training = {**changes.get("training", {}), "checkpoint_every_s": 0.0}
                settings = loaded(train.Settings, **{**changes, "training": training, "seed": seed})
                made = Path(place) / "scene.ply"
                call(
                    train.run,
                    settings,
                    **given,
                    background=made,
                    provenance=Path(place) / "provenance.npz",
                    working=Path(place),
                )
                gaussians = read_ply(made)
                runs.append(
                    scored([rasteriser.forward(gaussians, camera).rgb.clip(0, 1) for camera, _, _ in views], views)
                )
        spent_s = (time.process_time() - began) / len(options.seeds)
        table[name] = {key: float(np.mean([run[key] for run in runs])) for key in runs[0]} | {"cpu_s": spent_s}
        print(name, {key: round(value, 3) for key, value in table[name].items()}, flush=True)
        written(table, options.seeds)
    settings = loaded(synthesize.Settings)
    given = options_of(options.scene, options.threads)
    photos = synthesize.read_photos(given["model"], given["plates"], given["depths"], [], settings.depth_jump)
    warped = synthesize.synthesize_views([camera for camera, _, _ in views], photos, settings)
    table[WARPED] = scored([picture / np.float32(255) for picture, _ in warped], views)
    print(WARPED, {key: round(value, 3) for key, value in table[WARPED].items()}, flush=True)
    written(table, options.seeds)


if __name__ == "__main__":
    main()
