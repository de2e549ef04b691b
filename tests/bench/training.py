# SPDX-License-Identifier: Apache-2.0
"""What training buys in time: held-out PSNR of the synthetic studio's background against seconds, for every density
control.

    snakemake --cores 2 results/demo/background/scene.ply          # once: makes the inputs
    python -m tests.bench.training [--scene results/demo] [--truth results/studio/demo/truth] [--threads 2] [--only none
    relocate] python -m tests.bench.training --lpips | --loop                # cost of the perceptual term; of the loop
    beside its kernels

Every variant trains by ``background.train`` with the configuration's settings and its own changes. Seconds are of
processor time over all threads, less those of a run of one step (reading, seeding): a busy machine stretches the
wall's. Held-out plates are the exact ones of cameras that no step reads. Table and machine go to
tests/bench/results/training.json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path

import numba
import numpy as np
from studiorecon.background import train
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.stills import read_plate
from studiorecon.images.metrics import psnr
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.defaults import default_settings, loaded

RESULTS = Path(__file__).parent / "results" / "training.json"
VARIANTS = {
    "none": {"densify": "none"},
    "relocate": {
        "densify": "relocate",
        "densify_every": 100,
        "densify_from": 200,
        "densify_until": 1200,
        "prune_opacity": 0.05,
    },
    "relocate, sparse opacities": {
        "densify": "relocate",
        "densify_every": 100,
        "densify_from": 200,
        "densify_until": 1200,
        "prune_opacity": 0.05,
    },
    "gradient, the paper's": {"densify": "gradient", "densify_every": 500},
    "gradient, early": {
        "densify": "gradient",
        "densify_every": 100,
        "densify_from": 200,
        "densify_until": 600,
        "cap": 120000,
    },
}


def options_of(scene: Path, threads: int) -> dict:
    """Arguments of ``background.train`` for a finished scene folder."""
    cameras = [camera.name for camera in read_model(scene / "cameras")]
    segments = sorted(path for path in (scene / "views").glob("*.mkv") if ".mask" not in path.name)
    return {
        "model": scene / "cameras/images.txt",
        "plates": [scene / f"plates/{c}.png" for c in cameras],
        "depths": [scene / f"depth/{c}.exr" for c in cameras],
        "room_box": scene / "depth/room.json",
        "path": scene / "views/path.json",
        "views": segments,
        "supports": [path.with_suffix(".mask.mkv") for path in segments],
        "threads": threads,
    }


def trained(options: dict, changes: dict, folder: Path) -> tuple[float, float]:
    """Processor and wall seconds of one training; the result lies in ``folder``."""
    settings = loaded(train.Settings, training={"checkpoint_every_s": 0.0, **changes})
    began = time.process_time(), time.perf_counter()
    train.run(
        settings,
        **options,
        background=folder / "scene.ply",
        provenance=folder / "provenance.npz",
        working=folder / "working",
    )
    return time.process_time() - began[0], time.perf_counter() - began[1]


def held_out(scene: Path, truth: Path, folder: Path) -> tuple[float, int]:
    """Mean PSNR of the background from the held-out cameras against their exact plates, dB, and the number of
    Gaussians."""
    gaussians, rasteriser = read_ply(folder / "scene.ply"), Rasteriser(near_m=0.1)
    scores = []
    for camera in read_model(scene / "cameras/heldout"):
        rgb, _ = read_plate(truth / f"plates/{camera.name}.png")
        scores.append(psnr(rasteriser.forward(gaussians, camera).rgb, rgb))
    return float(np.mean(scores)), gaussians.count


def density_control(scene: Path, truth: Path, threads: int, only: list[str], equal_time: bool) -> None:
    """The table of all variants; with ``equal_time`` each is run again with the steps that the seconds of ``none``
    allow."""
    options, rows = options_of(scene, threads), []
    iterations = default_settings("background")["training"]["iterations"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trained(options, {"iterations": 1}, folder)  # compiles
        overhead_s, _ = trained(options, {"iterations": 1}, folder)
        for variant in only or list(VARIANTS):
            steps = [iterations]
            while steps:
                cpu_s, wall_s = trained(options, VARIANTS[variant] | {"iterations": steps[0]}, folder)
                score, count = held_out(scene, truth, folder)
                row = {
                    "variant": variant,
                    "iterations": steps.pop(),
                    "cpu_s": round(cpu_s - overhead_s, 1),
                    "wall_s": round(wall_s, 1),
                    "psnr_db": round(score, 3),
                    "gaussians": count,
                }
                rows.append(row)
                print(row, flush=True)
                _write(rows, scene.name, threads)
                allowed = round(iterations * rows[0]["cpu_s"] / row["cpu_s"])
                if equal_time and row["iterations"] == iterations and abs(allowed - iterations) > 0.03 * iterations:
                    steps = [allowed]


def _write(rows: list[dict], scene: str, threads: int) -> None:
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.0f}, numba {numba.__version__}"
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(
        json.dumps({"machine": machine, "threads": threads, "scene": scene, "rows": rows}, indent=1) + "\n"
    )


def lpips_cost() -> None:
    """Processor time of one evaluation with gradient, random weights, by picture size."""
    import torch
    from studiorecon.models.adapters.lpips import Lpips

    from tests.made.vgg import random_weights

    network, rng = Lpips(*random_weights(torch.float32)), np.random.default_rng(0)
    for height, width in ((96, 96), (128, 128), (176, 320), (272, 480)):
        pair = rng.random((2, height, width, 3), np.float32)
        seconds = []
        for _ in range(4):
            began = time.process_time()
            network(*pair)
            seconds.append(time.process_time() - began)
        print(
            f"LPIPS {width}x{height}: {1e3 * min(seconds):.0f} ms of processor time "
            f"on {torch.get_num_threads()} threads"
        )


def loop_cost(threads: int, iterations: int = 300) -> None:
    """A training step of 50,000 Gaussians at 320×176 beside forward and backward alone, in turns, fastest of each."""
    from dataclasses import replace

    from studiorecon.splatting.train.blocked_set import BlockedSet
    from studiorecon.splatting.train.targets import Target
    from studiorecon.splatting.train.terms import terms_of

    from tests.made.gaussians import camera_on_ring, room
    from tests.made.splatting_settings import SETTINGS

    truth, rasteriser = room(50_000, 0), Rasteriser(near_m=0.01, threads=threads)
    views = [camera_on_ring(i, 60, 320, 176) for i in range(60)]
    targets = [Target(view, rasteriser.forward(truth, view).rgb.clip(0, 1)) for view in views]
    settings = replace(SETTINGS, iterations=7000, sh_degree=3, warmup_half_resolution=0.0)
    run, terms = BlockedSet(truth, targets, settings, np.random.default_rng(0), 4.0, threads), terms_of(settings)
    by_planes = np.random.default_rng(0).normal(size=(5, 176, 320)).astype(np.float32)
    times = {"step": [], "kernels": []}
    for i in range(iterations):
        began = time.perf_counter()
        with run.threads():
            view = run.draw(i)
            run.step(i, view, view.total(terms))
        middle = time.perf_counter()
        with rasteriser.own_threads():
            rasteriser.draw(run.state.blocked, views[i % 60], (0, 0, 0))
            rasteriser.gather(by_planes)
        times["step"].append(middle - began)
        times["kernels"].append(time.perf_counter() - middle)
    step_ms, kernels_ms = (1e3 * float(np.quantile(times[name][10:], 0.05)) for name in ("step", "kernels"))
    print(
        f"50000 320x176, {threads} threads: step {step_ms:.2f} ms, forward and "
        f"backward alone {kernels_ms:.2f} ms, ratio "
        f"{step_ms / kernels_ms:.2f}; 7,000 steps at that pace {7 * step_ms:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, default=Path("results/demo"))
    parser.add_argument("--truth", type=Path, default=Path("results/studio/demo/truth"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], choices=list(VARIANTS))
    parser.add_argument(
        "--equal-time",
        action="store_true",
        help="each variant again with the steps that the seconds of the first allow",
    )
    parser.add_argument("--lpips", action="store_true")
    parser.add_argument("--loop", action="store_true")
    options = parser.parse_args()
    if options.lpips:
        lpips_cost()
    elif options.loop:
        loop_cost(options.threads)
    else:
        density_control(options.scene, options.truth, options.threads, options.only, options.equal_time)


if __name__ == "__main__":
    main()
