# SPDX-License-Identifier: Apache-2.0
"""Milliseconds of our rasteriser, and seconds of a whole training; writes results/splats.json.

    python -m benchmarks.splats [--threads 2] [--iterations 7000]

Calls take turns in one process; each figure is the minimum of its rounds, because other processes can only add to it.
A training is wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
from studiorecon.render.composite import Composite
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.splatting.cpu.blocks import block, morton_order
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train import state
from studiorecon.splatting.train.blocked_set import BlockedSet
from studiorecon.splatting.train.targets import DrawOrder, Target
from studiorecon.splatting.train.terms import active_terms

from tests.made.gaussians import camera, camera_on_ring, room
from tests.made.splatting_settings import SETTINGS
from tests.made.training import one_step

RESULTS = Path(__file__).resolve().parent / "results" / "splats.json"
SIZES = [(20_000, 320, 176), (50_000, 320, 176), (100_000, 640, 352), (300_000, 1280, 704)]
VIEWS = 60


def min_ms(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Least processor milliseconds of every call, taken in turns."""
    ms = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, function in calls.items():
            spent = time.process_time()
            function()
            ms[name] = min(ms[name], 1e3 * (time.process_time() - spent))
    return ms


def on_one_thread(rounds: int) -> dict[str, float]:
    """Milliseconds of 50,000 Gaussians at 320×176 on one thread."""
    scene, view = room(50_000, 0), camera(320, 176)
    blocked = block(scene.take(morton_order(scene.means_m)))
    by = np.random.default_rng(0).normal(size=(5, *view.hw)).astype(np.float32)
    ours = Rasteriser(near_m=0.01, threads=1)

    def both() -> None:
        ours.draw(blocked, view, (0, 0, 0))
        ours.gather(by)

    with ours.own_threads():
        both()
        ms = min_ms({"forward": lambda: ours.draw(blocked, view, (0, 0, 0)), "forward + backward": both}, rounds)
    return {f"{name}, ms": value for name, value in ms.items()}


def by_size(threads: int) -> dict[str, float]:
    """Milliseconds of forward and backward by number of Gaussians and pixels, and of one film frame."""
    table = {}
    for count, width, height in SIZES:
        scene, view, rasteriser = room(count, 0), camera(width, height), Rasteriser(near_m=0.01, threads=threads)
        blocked, by = block(scene.take(morton_order(scene.means_m))), np.ones((5, height, width), np.float32)
        calls = {
            "forward": lambda: rasteriser.draw(blocked, view, (0, 0, 0)),  # noqa: B023
            "backward": lambda: rasteriser.gather(by),  # noqa: B023
        }
        with rasteriser.own_threads():
            ms = min_ms(calls, 40 if count < 200_000 else 15)
        table |= {f"{count} at {width}×{height}, {name}, ms": value for name, value in ms.items()}
    numba.set_num_threads(threads)
    large = room(300_000, 0)
    classes = np.random.default_rng(0).integers(0, 3, large.count).astype(np.uint8)
    canvas, film = (
        CompositeRenderer(Composite(large.take(morton_order(large.means_m)), classes, []), 0.01),
        camera(1280, 704),
    )
    frame = min_ms({"frame": lambda: canvas.draw(film, 0.0, (0, 0, 0))}, 15)["frame"]
    return table | {"300,000 at 1280×704, a film's frame, ms": frame}


def training(count: int, width: int, height: int, threads: int, iterations: int) -> dict[str, float]:
    """Seconds of training a perturbed room on sixty views, and PSNR at twelve views between them."""
    truth, rasteriser, rng = room(count, 0), Rasteriser(near_m=0.01, threads=threads), np.random.default_rng(0)
    views = [camera_on_ring(i, VIEWS, width, height) for i in range(VIEWS)]
    targets = [Target(view, rasteriser.forward(truth, view).rgb.clip(0, 1)) for view in views]
    start = replace(
        truth,
        means_m=truth.means_m + rng.normal(0, 0.04, truth.means_m.shape).astype(np.float32),
        quaternions=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        logit_opacities=np.full(count, np.log(0.1 / 0.9)),
        log_scales=np.repeat(truth.log_scales.mean(axis=1, keepdims=True) + 0.5, 3, axis=1),
        sh=np.zeros_like(truth.sh),
    )
    settings = replace(SETTINGS, iterations=iterations, sh_degree=3, warmup_half_resolution=0.0, cap=count)
    run, terms = BlockedSet(start, targets, settings, rng, 4.0, threads), active_terms(settings)
    order = DrawOrder([1.0] * VIEWS, np.random.default_rng(0))
    began, processor = time.perf_counter(), time.process_time()
    for iteration in range(iterations):
        one_step(run, terms, iteration, order.draw())
    wall_s, processor_s = time.perf_counter() - began, time.process_time() - processor
    trained, errors = state.state_gaussians(run.state), []
    for view in (camera_on_ring(i + 0.5, 12, width, height) for i in range(12)):
        drawn, wanted = (rasteriser.forward(g, view).rgb.clip(0, 1) for g in (trained, truth))
        errors.append(float(((drawn - wanted) ** 2).mean()))
    psnr_db = float(np.mean(-10 * np.log10(errors)))
    return {"steps": iterations, "wall_s": wall_s, "processor_s": processor_s, "validation_psnr_db": psnr_db}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--iterations", type=int, default=7000, help="steps of the whole training")
    parser.add_argument("--rounds", type=int, default=20)
    options = parser.parse_args()
    figures = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, numba {numba.__version__}",
        "load": os.getloadavg()[0],
        "one_thread": on_one_thread(options.rounds),
        "by_size": by_size(options.threads),
        "training": training(*SIZES[1], options.threads, options.iterations),
    }
    print(json.dumps(figures, indent=1, ensure_ascii=False))
    RESULTS.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
