# SPDX-License-Identifier: Apache-2.0
"""Where a step of training spends its time, beside the design's numba sketch, part by part.

    python -m tests.bench.parts --prototype DIR [--iterations 1500] [--rounds 3] [--threads 2]

50,000 Gaussians on sixty views of 320×176, all harmonics from the start. The two run in turns, each in processes of its
own; a part's figure is the least of its rounds, milliseconds of wall time per step. Writes
tests/bench/results/splats_parts.json.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results" / "splats_parts.json"
PARTS = {
    "project": "project",
    "sort": "sort",
    "bin": "bin",
    "blend": "fwd",
    "loss": "loss",
    "gather": "bwd",
    "project back": "proj bwd",
    "Adam": "adam",
}
"""Our name of a part → the sketch's."""
WARM = 30
"""Steps before the clock starts: they compile, or read kernels from the cache."""


def ours(iterations: int, threads: int) -> dict[str, float]:
    """Milliseconds per step of every part, and of the whole."""
    import numpy as np
    from studiorecon.splatting.cpu import backward, projection_gradient, rasterise, tiles
    from studiorecon.splatting.train import photometric
    from studiorecon.splatting.train.targets import DrawOrder

    from tests.bench.splats import SIZES, VIEWS, perturbed_run
    from tests.made.training import one_step

    spent: Counter[str] = Counter()

    def timed(owner: Any, name: str, part: str) -> None:
        function = getattr(owner, name)

        def measured(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter()
            result = function(*arguments, **named)
            spent[part] += time.perf_counter() - began
            return result

        setattr(owner, name, measured)

    run, terms = perturbed_run(*SIZES[1], threads, iterations)
    timed(rasterise, "project", "project")
    timed(tiles, "depth_order", "sort")
    timed(tiles, "scatter_into_tiles", "bin")
    timed(rasterise, "blend", "blend")
    timed(photometric.Photometric, "evaluate", "loss")
    timed(backward, "gather", "gather")
    timed(projection_gradient, "project_gradient", "project back")
    timed(run, "descend", "Adam")
    order, began = DrawOrder([1.0] * VIEWS, np.random.default_rng(0)), 0.0
    for iteration in range(-WARM, iterations):
        if iteration == 0:
            spent.clear()
            began = time.perf_counter()
        one_step(run, terms, max(iteration, 0), order.draw())
    return {"step": 1e3 * (time.perf_counter() - began) / iterations} | {p: 1e3 * spent[p] / iterations for p in PARTS}


def theirs(folder: Path, iterations: int, threads: int) -> dict[str, float]:
    """The same of the sketch, which says it in its last line."""
    command = [sys.executable, "train.py", str(iterations), "50000", "320", "176", str(threads), "vis"]
    said = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()[-1]
    return {"step": float(re.search(r"= ([\d.]+) ms/it", said)[1])} | {
        part: float(re.search(rf"[;,] {name} ([\d.]+)", said)[1]) for part, name in PARTS.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--prototype", type=Path, help="folder of the design's numba sketches")
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--ours", action="store_true", help="one run of ours, printed as JSON")
    options = parser.parse_args()
    if options.ours:
        print(json.dumps(ours(options.iterations, options.threads)))
        return
    if options.prototype is None:
        parser.error("--prototype is needed")
    rounds: dict[str, list[dict[str, float]]] = {"ours": [], "sketch": []}
    command = [
        sys.executable,
        "-m",
        "tests.bench.parts",
        "--ours",
        "--iterations",
        str(options.iterations),
        "--threads",
        str(options.threads),
    ]
    with tempfile.TemporaryDirectory() as cache:
        os.environ |= {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": f"{ROOT / 'workflow'}:{ROOT}"}
        for _ in range(options.rounds):
            rounds["sketch"].append(theirs(options.prototype, options.iterations, options.threads))
            answer = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
            rounds["ours"].append(json.loads(answer.splitlines()[-1]))
    table = {}
    for part in ("step", *PARTS):
        mine, other = (min(round_[part] for round_ in rounds[who]) for who in ("ours", "sketch"))
        table[part] = {"ours_ms": round(mine, 3), "sketch_ms": round(other, 3), "share": round(mine / other, 3)}
        print(f"{part}: {mine:.2f} ms, the sketch {other:.2f} ms ({mine / other:.2f})")
    RESULTS.write_text(
        json.dumps({"threads": options.threads, "iterations": options.iterations, "parts": table}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
