# SPDX-License-Identifier: Apache-2.0
"""Seconds and memory of the whole demo as a new user runs it: from scratch, repeated, and after one change.

``python -m benchmarks.demo [--description resources/studio/demo.yaml] [--cores 2]`` from the repository's root, on an
idle machine. Works in a temporary folder with an empty kernel cache, so that filming and compiling are part of the
first figure. Prints wall seconds and the peak memory of the whole process tree, and when the first film of the room was
there.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[1]
BARS_S = {
    "from nothing": 240,
    "its first film": 90,
    "nothing to do": 5,
    "one render setting": 60,
    "a step that needs no torch": 1,
}


def tree_rss(process: psutil.Process) -> int:
    """Bytes of private memory of a process and everything it started."""
    total = 0
    for member in [process, *process.children(recursive=True)]:
        try:
            total += member.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return total


def timed(command: list[str], folder: Path, environment: dict[str, str]) -> tuple[float, float]:
    """Wall seconds and peak GiB of a command; raises when it fails."""
    peak = 0
    done = threading.Event()

    def watch(process: psutil.Process) -> None:
        nonlocal peak
        while not done.wait(0.2):
            try:
                peak = max(peak, tree_rss(process))
            except psutil.NoSuchProcess:
                return

    began = time.perf_counter()
    with open(folder / "log.txt", "w") as log:
        running = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=subprocess.STDOUT)
        watcher = threading.Thread(target=watch, args=(psutil.Process(running.pid),))
        watcher.start()
        status = running.wait()
        done.set()
        watcher.join()
    if status:
        raise SystemExit((folder / "log.txt").read_text()[-4000:])
    return time.perf_counter() - began, peak / 2**30


def main() -> None:
    """Print one line per figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--description", default="resources/studio/demo.yaml")
    parser.add_argument("--cores", default="2")
    given = parser.parse_args()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        environment = {**os.environ, "PATH": path, "NUMBA_CACHE_DIR": str(folder / "kernels")}
        overlay = folder / "overlay.yaml"
        overlay.write_text("render:\n  background_rgb: [0.2, 0.2, 0.2]\n")
        snakemake = [sys.executable, "-m", "snakemake", "--cores", given.cores, "--directory", str(folder)]
        dataset = ["--config", f"dataset={given.description}"]
        rendered = [
            f"results/{Path(given.description).stem}/render/{shot}.mkv" for shot in ("orbit", "heldout", "train")
        ]
        step = [sys.executable, "-m", "studiorecon", "people.associate", "--help"]
        runs = {
            "from nothing": [*snakemake, *dataset],
            "nothing to do": [*snakemake, *dataset],
            "one render setting": [*snakemake, *rendered, "--configfile", str(overlay), *dataset],
            "the film after one render setting": [*snakemake, "--configfile", str(overlay), *dataset],
            "a step that needs no torch": step,
        }
        for name, command in runs.items():
            began = time.time()
            seconds, gibibytes = timed(command, folder, environment)
            bar = f"(bar {BARS_S[name]} s)" if name in BARS_S else ""
            print(f"{name:36s} {seconds:8.1f} s   peak {gibibytes:5.2f} GiB {bar}", flush=True)
            if name == "from nothing":
                film = folder / f"results/{Path(given.description).stem}/depth/preview.mp4"
                shown = "its first film"
                print(f"{shown:36s} {film.stat().st_mtime - began:8.1f} s   (bar {BARS_S[shown]} s)", flush=True)


if __name__ == "__main__":
    main()
