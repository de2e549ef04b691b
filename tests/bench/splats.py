# SPDX-License-Identifier: Apache-2.0
"""What rasterising and training cost: milliseconds per image and per iteration. Run by hand on an idle machine.

    python -m tests.bench.splats [--threads 2] [--iterations 300] [--full 7000]

Every rasteriser figure is the minimum over interleaved rounds. Bars for two idle cores with AVX-512 (design target): forward and
backward at most 2.4 times forward; 7,000 iterations of 50,000 Gaussians at 320×176 at most 60 s; two threads at least 1.6 times one.
"""

from __future__ import annotations

import argparse
import platform
import resource
import time
from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
from studiorecon.splatting.blocks import block, morton_order
from studiorecon.splatting.losses import Photometric
from studiorecon.splatting.rasterise import Rasteriser
from studiorecon.splatting.targets import Target
from studiorecon.splatting.training import train

from tests.foundations.splatting_scenes import camera, camera_on_ring, room
from tests.foundations.test_splatting_training import SETTINGS

SIZES = [(20_000, 320, 176), (50_000, 320, 176), (100_000, 640, 352), (300_000, 1280, 704)]


def best_ms(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Minimum milliseconds of every call, taken in turns."""
    times = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, function in calls.items():
            began = time.perf_counter()
            function()
            times[name] = min(times[name], 1e3 * (time.perf_counter() - began))
    return times


def bench_rasteriser(count: int, width: int, height: int, threads: int) -> None:
    """One line: forward, forward + backward, loss, and the public calls with their copies."""
    gaussians, view = room(count, 0), camera(width, height)
    blocked = block(gaussians.take(morton_order(gaussians.means_m)))
    rasteriser = Rasteriser(near_m=0.01, threads=threads)
    by_planes = np.random.default_rng(0).normal(size=(5, height, width)).astype(np.float32)
    by_rgb = np.ascontiguousarray(by_planes[:3].transpose(1, 2, 0))
    loss = Photometric((height, width), 0.7, 0.3)
    target = loss.prepare(np.random.default_rng(1).random((height, width, 3), np.float32))
    gradient = np.zeros_like(by_planes)

    def both() -> None:
        rasteriser.draw(blocked, view, (0, 0, 0))
        rasteriser.gather(by_planes)

    calls: dict[str, Callable[[], object]] = {
        "forward": lambda: rasteriser.draw(blocked, view, (0, 0, 0)),
        "forward+backward": both,
        "loss": lambda: loss.evaluate(rasteriser.planes, target, gradient),
        "Rasteriser.forward": lambda: rasteriser.forward(blocked, view),
        "Rasteriser.backward": lambda: rasteriser.backward(by_rgb),
    }
    with rasteriser.own_threads():
        times = best_ms(calls, 40 if count < 200_000 else 15)
    figures = ", ".join(f"{name} {ms:.2f}" for name, ms in times.items())
    ratio = times["forward+backward"] / times["forward"]
    print(f"{count} {width}x{height} {threads} threads, ms: {figures}; (f+b)/f {ratio:.2f}; pairs {rasteriser.pair_count}")


def bench_training(count: int, width: int, height: int, threads: int, iterations: int) -> None:
    """Iterations per second and held-out PSNR of a perturbed room, sixty views."""
    truth, rasteriser, rng = room(count, 0), Rasteriser(near_m=0.01, threads=threads), np.random.default_rng(0)
    views = [camera_on_ring(i, 60, width, height) for i in range(60)]
    held_out = [camera_on_ring(i + 0.5, 12, width, height) for i in range(12)]
    targets = [Target(view, rasteriser.forward(truth, view).rgb.clip(0, 1)) for view in views]
    wanted = [rasteriser.forward(truth, view).rgb.clip(0, 1) for view in held_out]
    begin = replace(
        truth,
        means_m=truth.means_m + rng.normal(0, 0.04, truth.means_m.shape).astype(np.float32),
        quaternions=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scales=np.repeat(truth.log_scales.mean(axis=1, keepdims=True) + 0.5, 3, axis=1),
        logit_opacities=np.full(count, np.log(0.1 / 0.9)),
        sh=np.zeros_like(truth.sh),
    )
    settings = replace(SETTINGS, iterations=iterations, sh_degree=3, warmup_half_resolution=0.0, cap=count)
    train(begin, targets, replace(settings, iterations=3), rng, extent_m=4.0, threads=threads)  # compiles
    began = time.perf_counter()
    trained = train(begin, targets, settings, np.random.default_rng(0), extent_m=4.0, threads=threads)
    seconds = time.perf_counter() - began
    errors = [((rasteriser.forward(trained.gaussians, v).rgb.clip(0, 1) - w) ** 2).mean() for v, w in zip(held_out, wanted, strict=True)]
    psnr_db = np.mean(-10 * np.log10(errors))
    print(
        f"training {count} {width}x{height} {threads} threads: {iterations} iterations {seconds:.1f} s = "
        f"{1e3 * seconds / iterations:.2f} ms/it, {iterations / seconds:.0f} it/s, held-out PSNR {psnr_db:.2f} dB"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=numba.get_num_threads())
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--full", type=int, default=0, help="iterations of a full run at 50,000 Gaussians, 320x176; 0 = none")
    options = parser.parse_args()
    print(f"{platform.machine()} {platform.processor()}, numba {numba.__version__}, {numba.config.NUMBA_NUM_THREADS} cores")
    for size in SIZES:
        bench_rasteriser(*size, options.threads)
    for size in SIZES[:3]:
        bench_training(*size, options.threads, options.iterations)
    if options.full:
        bench_training(*SIZES[1], options.threads, options.full)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
