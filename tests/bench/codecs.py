# SPDX-License-Identifier: Apache-2.0
"""What keeping every bit of colour costs: ``python -m tests.bench.codecs FILM [FILM …] [--frames 24]``.

The first frames of each film, and a made one that is all noise, written and read back as FFV1 and as working videos
are: processor milliseconds and kilobytes a frame, the least of three rounds in turn. Stops when a bit was lost. Writes
``tests/bench/results/codecs.json``.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
from studiorecon.footage.video import Codec, read_frames, read_stack, write_film
from studiorecon.scene.files import write_json

RESULT = Path(__file__).parent / "results" / "codecs.json"
CODECS = {"ffv1": Codec("ffv1", "rgb24", "bgr0", {"level": "3", "slices": "4", "slicecrc": "1"}), "h264": None}


def spent_ms(job: Callable[[], object], frames: int) -> float:
    """Processor milliseconds a frame of one call, threads included."""
    began = time.process_time()
    job()
    return 1000 * (time.process_time() - began) / frames


def measured(frames: np.ndarray, folder: Path) -> dict[str, dict[str, float]]:
    """codec → write_ms, read_ms and kilobytes a frame of ``frames`` (T, H, W, 3)."""
    found = {name: {"write_ms": np.inf, "read_ms": np.inf, "kilobytes": 0.0} for name in CODECS}
    for _ in range(3):
        for name, codec in CODECS.items():
            film, best = folder / f"{name}.mkv", found[name]
            best["write_ms"] = min(
                best["write_ms"],
                spent_ms(lambda: write_film(film, frames, 30.0, codec), len(frames)),  # noqa: B023
            )
            best["read_ms"] = min(best["read_ms"], spent_ms(lambda: sum(1 for _ in read_frames(film)), len(frames)))  # noqa: B023
            best["kilobytes"] = film.stat().st_size / len(frames) / 1000
            if not np.array_equal(read_stack(film), frames):
                raise SystemExit(f"{name} lost bits of {frames.shape}")
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("films", type=Path, nargs="*")
    parser.add_argument("--frames", type=int, default=24)
    given = parser.parse_args()
    films = {film.stem: np.stack(list(islice(read_frames(film), given.frames))) for film in given.films}
    films["noise"] = np.random.default_rng(0).integers(0, 256, (given.frames, 352, 640, 3), np.uint8)
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "load_before": os.getloadavg()[0]}
    result: dict[str, object] = {"machine": machine, "frames": given.frames}
    with tempfile.TemporaryDirectory() as folder:
        for name, frames in films.items():
            found = measured(frames, Path(folder))
            result[name] = {"wh": [frames.shape[2], frames.shape[1]], **found}
            old, new = found["ffv1"], found["h264"]
            told = ", ".join(f"{kind} {old[kind]:.1f} → {new[kind]:.1f}" for kind in old)
            print(
                f"{name} {frames.shape[2]}×{frames.shape[1]}: {told}; reading ÷ {old['read_ms'] / new['read_ms']:.1f}"
            )
    write_json(RESULT, result)


if __name__ == "__main__":
    main()
