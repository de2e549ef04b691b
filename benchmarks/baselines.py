# SPDX-License-Identifier: Apache-2.0
"""Two reconstructions without a body model beside ours, from the same photos and the same room.

    snakemake --cores 2 --config dataset=resources/studio/tiny.yaml         # once: makes the inputs
    python -m benchmarks.baselines [--scene results/tiny] [--truth results/studio/tiny/truth] [--iterations 300 100]

*per frame*: at every moment Gaussians of our room and of the people's visual hull are trained on the photos of that
moment alone. *over time*: the same at the first moment, and every later one goes on from the one before, so that
Gaussians move and keep their colours as far as the photos allow; it is our scene with free Gaussians in place of bodies
(Dynamic 3D Gaussians without its rigidity terms). *ours* is the run's own film. Scored at the held-out cameras: whole
frames, the people's own pixels, and change from one frame to the next where nobody is, in levels of 255, which is 0 in
truth. Writes benchmarks/results/baselines.json.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_stack
from studiorecon.images.metrics import psnr
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.discs import make_discs
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import train_still
from studiorecon.splatting.train.targets import Target, scene_extent

RESULTS = Path(__file__).parent / "results" / "baselines.json"
# Points that are tried as the hull's, and how large the kept ones start: half the distance between them.
TRIED, SIZE_M, HEIGHT_M = 400_000, 0.02, 2.3


def visual_hull(
    cameras: Sequence[Camera], photos: Sequence[np.ndarray], masks: Sequence[np.ndarray], rng: np.random.Generator
) -> Gaussians:
    """Gaussians at random points that every camera sees inside a mask, in the mean colour of the photos there."""
    centres = np.array([camera.centre_m for camera in cameras])
    points = rng.uniform([*centres.min(0)[:2], 0.0], [*centres.max(0)[:2], HEIGHT_M], (TRIED, 3))
    inside, colours = np.ones(TRIED, bool), np.zeros((TRIED, 3))
    for camera, photo, mask in zip(cameras, photos, masks):
        pixels, distance_m = camera.project(points)
        shown, within = (part[0] for part in sample(mask > 0, pixels[None], "nearest"))
        inside &= (distance_m > 0) & within & shown
        colours += sample(photo / 255, pixels[None], "nearest")[0][0] / len(cameras)
    up = np.tile([0.0, 0.0, 1.0], (int(inside.sum()), 1))
    return make_discs(points[inside], up, colours[inside], SIZE_M, 1.0, 0.5, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, default=Path("results/tiny"))
    parser.add_argument("--truth", type=Path, default=Path("results/studio/tiny/truth"))
    parser.add_argument("--iterations", type=int, nargs=2, default=(300, 100), help="of a first and of a later moment")
    given = parser.parse_args()
    cameras, held_out = (read_model(given.scene / folder) for folder in ("cameras", "cameras/heldout"))
    photos, masks, wanted = (
        [read_stack(given.scene / f"{kind}/{camera.name}.mkv") for camera in group]
        for kind, group in (("capture", cameras), ("masks", cameras), ("capture", held_out))
    )
    people = [read_stack(given.truth / f"masks/{camera.name}.mkv") > 0 for camera in held_out]
    film = read_stack(given.scene / "render/heldout.mkv").reshape(len(held_out), -1, *wanted[0].shape[1:])
    room, rasteriser = read_ply(given.scene / "background/scene.ply").with_sh_degree(1), Rasteriser(near_m=0.1)
    shown = {"ours": film / np.float32(255)}
    seconds: dict[str, float] = {}
    for name in ("per frame", "over time"):
        rng, scene, moments, began = np.random.default_rng(0), None, [], time.process_time()
        for t in range(film.shape[1]):
            now, shapes = [video[t] for video in photos], [video[t] for video in masks]
            first = scene is None or name == "per frame"
            start = concatenate([room, visual_hull(cameras, now, shapes, rng)]) if first else scene
            settings = replace(TrainingSettings(), iterations=given.iterations[not first], warmup_half_resolution=0.0)
            targets = [Target(camera, photo / np.float32(255)) for camera, photo in zip(cameras, now)]
            scene = train_still(start, targets, settings, rng, extent_m=scene_extent(cameras), label=name).gaussians
            moments.append([rasteriser.forward(scene, camera).rgb.clip(0, 1) for camera in held_out])
        shown[name] = np.array(moments).swapaxes(0, 1)
        seconds[name] = time.process_time() - began
    rows: dict[str, dict[str, float | None]] = {}
    for name, pictures in shown.items():
        places = [(k, t) for k in range(len(held_out)) for t in range(film.shape[1])]
        pairs = [(pictures[k][t], wanted[k][t] / np.float32(255), people[k][t]) for k, t in places]
        still = [
            np.abs(pictures[k][t] - pictures[k][t - 1])[~(people[k][t] | people[k][t - 1])].mean()
            for k, t in places
            if t
        ]
        own = [psnr(picture, photo, mask) for picture, photo, mask in pairs if mask.sum() > 60]
        rows[name] = {
            "psnr_db": float(np.mean([psnr(picture, photo) for picture, photo, _ in pairs])),
            "psnr_people_db": float(np.mean(own)),
            "still_change_levels": 255 * float(np.mean(still)),
            "cpu_s": seconds.get(name),
        }
        print(name, rows[name], flush=True)
    RESULTS.write_text(json.dumps({"scene": given.scene.name, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
