# SPDX-License-Identifier: Apache-2.0
"""How long scoring takes, and what exact structural similarity costs: ``python -m tests.bench.report [--frames 121]
[--cameras 4]``.

Scores made films of 1280×704 as ``report.score`` does, masks included, from files to the result; the bar is 60 s for 4
cameras of 121 frames on 2 cores. Then compares, interleaved, the exact similarity map with the float32 one, and the
efforts of the flow, by processor time. Writes ``tests/bench/results/report.json``.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from studiorecon.footage.video import write_lossless
from studiorecon.images import metrics
from studiorecon.images.flow import PRESETS, dis_flow, grey_levels, one_thread
from studiorecon.report.score import score
from studiorecon.scene.files import write_json

WH = (1280, 704)
BAR_S = 60.0
RESULT = Path(__file__).parent / "results" / "report.json"


def photo(frame: int, seed: int) -> np.ndarray:
    """(704, 1280, 3) uint8: a smooth texture that drifts, with a block that moves against it."""
    rng = np.random.default_rng(seed)
    base = cv2.GaussianBlur(rng.integers(0, 256, (WH[1], WH[0], 3), dtype=np.uint8), (0, 0), 3)
    moved = np.roll(base, frame % 7, axis=1)
    left = 100 + 5 * frame
    moved[200:600, left : left + 200] = base[200:600, 700:900]
    return moved


def write_films(folder: Path, cameras: int, frames: int) -> None:
    """``truth``, ``renders`` and ``masks`` of every camera."""
    mask = np.zeros((WH[1], WH[0]), np.uint8)
    mask[200:600, 400:600] = 1
    noise = np.random.default_rng(0).integers(-12, 13, (WH[1], WH[0], 3), dtype=np.int16)
    for camera in range(cameras):
        photos = [photo(frame, camera) for frame in range(min(frames, 14))]
        shown = [photos[frame % len(photos)] for frame in range(frames)]
        write_lossless(folder / f"truth/c{camera}.mkv", shown, 30.0)
        renders = (np.clip(p + np.roll(noise, k, axis=0), 0, 255).astype(np.uint8) for k, p in enumerate(shown))
        write_lossless(folder / f"renders/c{camera}.mkv", renders, 30.0)
        write_lossless(folder / f"masks/c{camera}.mkv", [mask] * frames, 30.0)


def interleaved(jobs: dict[str, Callable[[], object]], rounds: int = 5) -> dict[str, float]:
    """Smallest processor seconds of each job over rounds that run all of them in turn."""
    best = dict.fromkeys(jobs, float("inf"))
    for _ in range(rounds + 1):
        for name, job in jobs.items():
            began = time.thread_time()
            job()
            best[name] = min(best[name], time.thread_time() - began)
    return best


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=121)
    parser.add_argument("--cameras", type=int, default=4)
    given = parser.parse_args()
    photos = [photo(frame, 0) for frame in range(2)]
    render = np.clip(photos[1] + np.random.default_rng(0).normal(0, 8, photos[1].shape), 0, 255).astype(np.uint8)
    before, after = (grey_levels(p) for p in photos)
    with one_thread():
        maps = interleaved(
            {t.__name__: lambda t=t: metrics.ssim_map(render, photos[1], t) for t in (np.float64, np.float32)}
        )
        flows = interleaved({preset: lambda preset=preset: dis_flow(before, after, preset) for preset in PRESETS})
        exact, cheap = (metrics.ssim(metrics.ssim_map(render, photos[1], t)) for t in (np.float64, np.float32))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_films(folder, given.cameras, given.frames)
        load, began, worked = os.getloadavg()[0], time.perf_counter(), time.process_time()
        result = score(folder / "renders", folder / "truth", folder / "masks")
        wall_s, cpu_s = time.perf_counter() - began, time.process_time() - worked
    measured = {
        "machine": {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "load_before": load,
            "python": platform.python_version(),
        },
        "scoring": {
            "cameras": given.cameras,
            "frames": given.frames,
            "wh": WH,
            "wall_s": wall_s,
            "cpu_s": cpu_s,
            "bar_s": BAR_S,
            "cpu_ms_per_frame": 1000 * cpu_s / (given.cameras * given.frames),
            "psnr": result["pictures"]["renders"]["psnr"]["value"],
        },
        "similarity_cpu_ms": {name: 1000 * seconds for name, seconds in maps.items()},
        "similarity_float32_error": cheap - exact,
        "flow_cpu_ms": {name: 1000 * seconds for name, seconds in flows.items()},
    }
    write_json(RESULT, measured)
    films, load_told = f"{given.cameras} cameras × {given.frames} frames", f"load {load:.1f}"
    print(f"{films}: {wall_s:.1f} s wall, {cpu_s:.1f} s processor (bar {BAR_S:.0f} s), {load_told}")
    print(
        f"similarity: {1000 * maps['float64']:.0f} ms exact, "
        f"{1000 * maps['float32']:.0f} ms float32 ({cheap - exact:+.1e})"
    )
    print("flow: " + ", ".join(f"{name} {1000 * seconds:.0f} ms" for name, seconds in flows.items()))


if __name__ == "__main__":
    main()
