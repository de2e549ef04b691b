# SPDX-License-Identifier: Apache-2.0
"""``python -m tests.bench.films``: what a picture costs beside the rasteriser alone, on made scenes; and, where a
finished demo is there (``--scene results/demo``), what enhancement buys and costs.

Writes ``tests/bench/results/films_pictures.json`` and ``films.json``.
"""

from __future__ import annotations

import argparse
import os
import platform
from pathlib import Path

from studiorecon.scene.files import write_json

from tests.bench.films import enhancement, pictures

ROOT = Path(__file__).parents[3]
RESULT = Path(__file__).parents[1] / "results" / "films_pictures.json"


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=ROOT / "results/demo")
    parser.add_argument("--truth", type=Path, default=ROOT / "results/studio/demo/truth")
    parser.add_argument("--pictures", type=int, default=60, help="of every held-out camera; twice as many of the orbit")
    parser.add_argument("--orbit-truth", type=Path)
    given = parser.parse_args()
    load = os.getloadavg()[0]
    found = pictures.measured(ROOT)
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "load_before": load}
    write_json(RESULT, {"machine": machine, "bar": pictures.BAR, "scenes": found})
    if (given.scene / "render/heldout.mkv").is_file():
        enhancement.measure(given.scene, given.truth, given.pictures, given.orbit_truth)
    else:
        print(f"{given.scene} is no finished scene: enhancement is not measured")


if __name__ == "__main__":
    main()
