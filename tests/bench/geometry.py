# SPDX-License-Identifier: Apache-2.0
"""What geometry costs and what accuracy costs: milliseconds, microseconds a point, and centimetres. Run by hand.

    python -m tests.bench.geometry [--rounds 5] [--points 100000]

Prints a table and writes tests/bench/results/geometry.json. Times are the minimum over interleaved rounds on one
thread; the thread's own processor time is given beside wall time, because other work on the machine counts in the
latter. The per-point loop is the same robust triangulation written for one point in plain numpy: what a batch saves.
Bars: robust triangulation of 4 views ≤ 15 µs a point, ≥ 20 times the loop, 100,000 points ≤ 0.8 GB; a million points
projected, unprojected, undistorted ≤ 60 ms each; 481 poses ≤ 5 ms; smoothing 121 frames × 24 rotations × 4 people ≤ 50
ms.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import time
from collections.abc import Callable
from datetime import date
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.geometry.camera_path import between
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.rotations import exp
from studiorecon.geometry.smoothing import smooth_rotations
from studiorecon.geometry.triangulation import triangulate, unit_px
from studiorecon.scene.camera import Camera

from tests.made.cameras import LIMITS, ring, seen

RESULT = Path(__file__).parent / "results" / "geometry.json"
MILLION = 1_000_000
LENSES = {
    "radial": ("opencv", np.array([-0.3, 0.1, 0, 0, 0.01])),
    "tangential": ("opencv", np.array([-0.3, 0.1, 1e-3, -1e-3, 0.01])),
    "fisheye": ("fisheye", np.array([-0.03, 0.01, -0.004, 0.001])),
}


def interleaved(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, tuple[float, float]]:
    """Minimum seconds (wall, processor) of every call, taken in turns after one unmeasured call."""
    best = dict.fromkeys(calls, (np.inf, np.inf))
    for function in calls.values():
        function()
    for _ in range(rounds):
        for name, function in calls.items():
            wall, own = time.perf_counter(), time.thread_time()
            function()
            taken = time.perf_counter() - wall, time.thread_time() - own
            best[name] = (min(best[name][0], taken[0]), min(best[name][1], taken[1]))
    return best


def one_point(pixels: np.ndarray, cameras: list[Camera]) -> np.ndarray:
    """Robust triangulation of one point (V, 2) in plain numpy: pairs by SVD, truncated cost, Gauss-Newton on the
    agreeing views."""
    units = unit_px(cameras, LIMITS)
    matrices = [c.intrinsics @ c.camera_from_world[:3] for c in cameras]

    def errors(point: np.ndarray) -> np.ndarray:
        return np.array([np.linalg.norm(c.project(point)[0] - p) for c, p in zip(cameras, pixels)]) / units

    best, lowest = np.full(3, np.nan), np.inf
    for pair in combinations(range(len(cameras)), 2):
        rows = np.concatenate(
            [[p[0] * m[2] - m[0], p[1] * m[2] - m[1]] for m, p in ((matrices[v], pixels[v]) for v in pair)]
        )
        solution = np.linalg.svd(rows)[2][-1]
        point = solution[:3] / solution[3]
        cost = (np.minimum(np.nan_to_num(errors(point), nan=np.inf) / LIMITS.outlier_units, 1) ** 2).sum()
        if cost < lowest:
            best, lowest = point, cost
    inliers = np.flatnonzero(errors(best) < LIMITS.outlier_units)
    for _ in range(4):
        matrix, side = np.zeros((3, 3)), np.zeros(3)
        for v in inliers:
            x, y, z = cameras[v].camera_from_world[:3, :3] @ best + cameras[v].camera_from_world[:3, 3]
            (fx, fy), (cx, cy) = cameras[v].focal_px, cameras[v].principal_px
            rows = (
                np.array([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]])
                @ cameras[v].camera_from_world[:3, :3]
            )
            matrix += rows.T @ rows
            side += rows.T @ (np.array([fx * x / z + cx, fy * y / z + cy]) - pixels[v])
        best = best - np.linalg.solve(matrix, side)
    return best


def made(count: int, wrong: int) -> tuple[np.ndarray, np.ndarray, list[Camera]]:
    """Truth (N, 3) within a metre of the middle, pixels (4, N, 2) with 1 px noise and ``wrong`` views 200 px off,
    cameras on a 4 m ring."""
    rng = np.random.default_rng(wrong)
    cameras = ring()
    truth = rng.uniform(-1, 1, (count, 3)) + np.array([0, 0, 1])
    pixels = seen(cameras, truth, 1.0, rng)
    for view in np.argsort(rng.random((4, count)), axis=0)[:wrong]:
        angle = rng.uniform(0, 2 * np.pi, count)
        pixels[view, np.arange(count)] += 200 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return truth, pixels, cameras


def triangulation(count: int, rounds: int) -> list[dict[str, float | str]]:
    """Cost and accuracy of every solver, and of the per-point loop, with 0, 1 and 2 wrong views of 4."""
    found = []
    for wrong in range(3):
        truth, pixels, cameras = made(count, wrong)
        ones, few = np.ones((4, count)), max(count // 1000, 20)
        calls: dict[str, Callable[[], Any]] = {
            solver: (lambda s=solver, p=pixels, c=cameras, w=ones: triangulate(p, w, c, LIMITS, 1.0, s))
            for solver in ("robust", "huber", "dlt")
        }
        calls["loop"] = lambda p=pixels, c=cameras, n=few: [one_point(p[:, i], c) for i in range(n)]
        for name, (wall, own) in interleaved(calls, rounds).items():
            number = few if name == "loop" else count
            points = np.array(calls[name]()) if name == "loop" else calls[name]().points_m
            error_cm = 100 * np.linalg.norm(points - truth[:number], axis=-1)
            found.append(
                {
                    "solver": name,
                    "wrong": wrong,
                    "wall_us": 1e6 * wall / number,
                    "own_us": 1e6 * own / number,
                    "median_cm": float(np.nanmedian(error_cm)),
                    "p95_cm": float(np.nanquantile(error_cm, 0.95)),
                    "within_3cm": float((np.nan_to_num(error_cm, nan=np.inf) < 3).mean()),
                }
            )
    return found


def others(rounds: int) -> dict[str, tuple[float, float]]:
    """Seconds of projecting, unprojecting and undistorting a million points, of a path of 481 poses, and of
    smoothing."""
    rng = np.random.default_rng(0)
    cameras = ring()
    points = rng.uniform(-1, 1, (MILLION, 3)) + np.array([0, 0, 1])
    pixels, depth_m = cameras[0].project(points)
    flat = rng.uniform(-0.5, 0.5, (MILLION, 2))
    turns = exp(np.cumsum(0.05 * rng.normal(size=(121, 4 * 24, 3)), axis=0))

    def path() -> None:
        for k, count in enumerate((121, 120, 120, 120)):
            between(
                cameras[k],
                cameras[(k + 1) % 4],
                count,
                np.array([0, 0, 1.0]),
                rotations="slerp",
                clearance=0.6,
            )

    calls: dict[str, Callable[[], object]] = {
        "project 1 M": lambda: cameras[0].project(points),
        "unproject 1 M": lambda: cameras[0].unproject(pixels, depth_m),
    }
    for name, lens in LENSES.items():
        distorted = distort(flat, *lens)
        calls[f"undistort 1 M, {name}"] = lambda d=distorted, lens=lens: undistort(d, *lens)
    calls["path of 481 poses"] = path
    calls["smooth 121 × 24 × 4"] = lambda: smooth_rotations(turns, 0.5, 1.0)
    return interleaved(calls, rounds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--points", type=int, default=100_000)
    given = parser.parse_args()
    machine = f"{platform.processor() or platform.machine()}, one thread, {platform.system()}"
    print(f"{date.today()} {machine}")
    frontier = triangulation(given.points, given.rounds)
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"triangulation, 4 views, {given.points} points (peak {peak_gb:.2f} GB)")
    print("solver  wrong  µs/point (own)    median   95 %   within 3 cm")
    for row in frontier:
        print(
            f"{row['solver']:7} {row['wrong']}      {row['wall_us']:7.1f} ({row['own_us']:.1f})  "
            f"{row['median_cm']:7.2f} {row['p95_cm']:7.2f} cm  {row['within_3cm']:.1%}"
        )
    cost = {(r["solver"], r["wrong"]): r["own_us"] for r in frontier}
    ratio = min(cost["loop", w] / cost["robust", w] for w in range(3))
    print(f"the batch is at least {ratio:.0f} times as fast as the loop over points")
    times = others(given.rounds)
    for name, (wall, own) in times.items():
        print(f"{name:26} {1e3 * wall:7.1f} ms ({1e3 * own:.1f} own)")
    RESULT.parent.mkdir(exist_ok=True)
    milliseconds = {name: {"wall_ms": 1e3 * wall, "own_ms": 1e3 * own} for name, (wall, own) in times.items()}
    result = {
        "date": str(date.today()),
        "machine": machine,
        "points": given.points,
        "peak_gb": peak_gb,
        "times_the_loop": ratio,
        "triangulation": frontier,
        "others": milliseconds,
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
