# SPDX-License-Identifier: Apache-2.0
"""What the exact and the cheap form of each solver cost and lose, in one table: ``python -m benchmarks.solvers
[--rounds 9]``.

Measures the similarity map, the flow's efforts and the warp's filters here, interleaved, by processor time on one
thread, against planted truth; takes triangulation, the body's fit, skinning weights and association from what their own
benches wrote (benchmarks/results). Writes ``resources/solvers.tsv``, which the page shows.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from studiorecon.images import metrics
from studiorecon.images.flow import PRESETS, dis_flow, grey_levels, one_thread
from studiorecon.images.warp import warp
from studiorecon.scene.files import write_table

ROOT = Path(__file__).resolve().parents[1]
RESULTS, TABLE = ROOT / "benchmarks/results", ROOT / "resources/solvers.tsv"
COLUMNS = ("solver", "form", "setting", "cost", "cost unit", "error", "error unit", "default")
HW = (704, 1280)
WAVES = 60


def texture(pixels: np.ndarray, seed: int = 0) -> np.ndarray:
    """(h, w, 3) float32 in [0, 1]: a sum of waves no shorter than 6 pixels, known at every fractional pixel (h, w,
    2)."""
    rng = np.random.default_rng(seed)
    total = np.zeros((*pixels.shape[:2], 3))
    for _ in range(WAVES):
        length, turn = np.exp(rng.uniform(np.log(6), np.log(120))), rng.uniform(0, np.pi)
        along = (pixels[..., 0] * np.cos(turn) + pixels[..., 1] * np.sin(turn)) * (2 * np.pi / length)
        total += np.sin(along + rng.uniform(0, 2 * np.pi))[..., None] * rng.uniform(0.2, 1.0, 3) * np.sqrt(length)
    return (0.5 + 0.15 * total / total.std()).clip(0, 1).astype(np.float32)


def grid() -> np.ndarray:
    """(704, 1280, 2): centre of every pixel."""
    return np.stack(np.meshgrid(np.arange(HW[1]) + 0.5, np.arange(HW[0]) + 0.5), axis=-1)


def planted_flow() -> np.ndarray:
    """(704, 1280, 2) float32: up to 12 pixels, smooth, nowhere whole."""
    x, y = np.moveaxis(grid(), -1, 0)
    return np.stack([6 * np.sin(y / 140) + 0.02 * (x - 640) * 0.4, 4 * np.cos(x / 180)], axis=-1).astype(np.float32)


def interleaved(jobs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Smallest processor milliseconds of each job over rounds that run all of them in turn."""
    best = dict.fromkeys(jobs, float("inf"))
    for _ in range(rounds + 1):
        for name, job in jobs.items():
            began = time.thread_time()
            job()
            best[name] = min(best[name], 1000 * (time.thread_time() - began))
    return best


def measured_here(rounds: int) -> list[tuple]:
    """Similarity, flow and warp at 1280×704."""
    pixels, flow = grid(), planted_flow()
    first = texture(pixels)
    # The second picture at p is the first at p + flow(p): what a backward warp makes, and what a search from second to
    # first finds.
    second = texture(pixels + flow)
    inside = np.s_[40:-40, 40:-40]
    eight = [np.round(255 * picture).astype(np.uint8) for picture in (first, second)]
    noisy = np.clip(eight[0] + np.random.default_rng(1).normal(0, 8, eight[0].shape), 0, 255).astype(np.uint8)
    greys = [grey_levels(picture) for picture in eight]
    with one_thread():
        maps = interleaved(
            {t.__name__: lambda t=t: metrics.ssim_map(noisy, eight[0], t) for t in (np.float64, np.float32)}, rounds
        )
        flows = interleaved({p: lambda p=p: dis_flow(greys[1], greys[0], p) for p in PRESETS}, rounds)
        warps = interleaved(
            {how: lambda how=how: warp(first, flow, how) for how in ("nearest", "linear", "cubic")}, rounds
        )
        exact, cheap = (metrics.ssim(metrics.ssim_map(noisy, eight[0], t)) for t in (np.float64, np.float32))
        lost = {p: np.linalg.norm(dis_flow(greys[1], greys[0], p) - flow, axis=-1)[inside] for p in PRESETS}
        wrong = {how: 255 * np.abs(warp(first, flow, how)[0] - second)[inside] for how in warps}
    rows = [
        ("similarity map", "float64", "in the code", maps["float64"], "ms per picture", 0.0, "off, SSIM", "yes"),
        (
            "similarity map",
            "float32",
            "in the code",
            maps["float32"],
            "ms per picture",
            abs(cheap - exact),
            "off, SSIM",
            "",
        ),
    ]
    used = {"medium": "yes", "linear": "yes"}
    rows += [
        ("flow", p, "enhance.flow_preset", flows[p], "ms per pair", lost[p].mean(), "off, mean px", used.get(p, ""))
        for p in PRESETS
    ]
    rows += [
        (
            "warp",
            how,
            "in the code",
            warps[how],
            "ms per picture",
            wrong[how].mean(),
            "off, mean levels",
            used.get(how, ""),
        )
        for how in warps
    ]
    return rows


def from_other_benches() -> list[tuple]:
    """Triangulation, fit, skinning weights and association, as their own benches last measured them."""
    read = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in ("geometry", "bodies", "association")}
    rows = []
    for entry in read["geometry"]["triangulation"]:
        if entry["wrong"] == 1 and entry["solver"] != "loop":
            default = "yes" if entry["solver"] == "robust" else ""
            rows.append(
                (
                    "triangulation, 1 of 4 views wrong",
                    entry["solver"],
                    "people.triangulation.solver",
                    entry["own_us"],
                    "µs per point",
                    entry["median_cm"],
                    "off, median cm",
                    default,
                )
            )
    for form, entry in read["bodies"]["fit"].items():
        default = "yes" if form == "levenberg_marquardt" else ""
        rows.append(
            (
                "body fit",
                form,
                "people.fit.solver",
                entry["ms_per_frame"],
                "ms per frame",
                entry["joints_mm"],
                "off, mean mm",
                default,
            )
        )
    for form, entry in read["bodies"]["skinning weights"].items():
        default = "yes" if form.startswith("surface") else ""
        rows.append(
            (
                "skinning weights",
                form,
                "humans.skinning",
                entry["query_ms"],
                "ms per query",
                entry["mean_mm"],
                "off, mean mm",
                default,
            )
        )
    for form, entry in read["association"]["methods"].items():
        default = "yes" if form == "tracks, rays, keypoints alone (default)" else ""
        rows.append(
            (
                "association",
                form,
                "people.association",
                1000 * entry["seconds"],
                "ms per clip",
                1 - entry["accuracy"],
                "pairs missed, share",
                default,
            )
        )
    return rows


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    rows = [*measured_here(given.rounds), *from_other_benches()]
    write_table(
        TABLE,
        COLUMNS,
        [
            (s, f, where, f"{cost:.4g}", unit, f"{off:.3g}", kind, default)
            for s, f, where, cost, unit, off, kind, default in rows
        ],
    )
    print(f"{platform.machine()}, OpenCV {cv2.__version__}")
    for solver, form, _, cost, unit, off, kind, default in rows:
        print(f"{solver:36s} {form:44s} {cost:9.3f} {unit:15s} {off:9.3g} {kind:20s} {'default' if default else ''}")


if __name__ == "__main__":
    main()
