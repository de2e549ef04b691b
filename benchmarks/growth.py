# SPDX-License-Identifier: Apache-2.0
"""Growth of every step with the length of the film: seconds per camera and frame, and peak memory.

    python -m benchmarks.growth [--frames 60 240] [--cameras 4] [--people 2] [--size 240 136] [--until all] [--scale 1]

Films a made studio twice, once as long as each number says, and runs the workflow on it in a temporary folder, with
compiled kernels. Reads Snakemake's own records (``timings/``): processor seconds, so that other work counts little, and
the largest resident memory of a job. A rule's slope is what one more camera-frame costs: the difference of the two runs
over that of their camera-frames; twice the slope of the first run alone would be a step that grows faster than the
film. ``exponent`` is log(seconds) over log(frames) between the two, 0 for constant time, 1 for time proportional to the
film, 2 for comparisons of every frame with every other. Table and machine go to benchmarks/results/growth.json, one
entry per number of cameras.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).parent / "results" / "growth.json"
MEMORY_BAR_MB = 2000


def description(frames: int, cameras: int, people: int, size: tuple[int, int]) -> dict:
    """A plain studio of that length; nobody recorded keypoints' faults, so that the same people are found in all."""
    plain = {"seed": 3, "effects": {"contact_shading": 0.5}, "cameras": {"training": cameras, "held_out": 1}}
    return plain | {"frames": frames, "size": list(size), "people": people}


def recorded(folder: Path) -> dict[str, dict[str, float]]:
    """Rule → processor seconds of all its jobs, and the peak memory of one, megabytes."""
    found: dict[str, dict[str, float]] = defaultdict(lambda: {"cpu_s": 0.0, "peak_mb": 0.0, "jobs": 0})
    for path in sorted((folder / "timings").rglob("*.tsv")):
        parts = path.relative_to(folder / "timings").with_suffix("").parts
        rule = ".".join(parts[1:3]) if parts[0] != "studio" else "studio.capture"
        for row in csv.DictReader(path.read_text().splitlines(), delimiter="\t"):
            numbers = {key: float(row[key]) if row[key] not in ("-", "NA") else 0.0 for key in ("cpu_time", "max_rss")}
            found[rule]["cpu_s"] += numbers["cpu_time"]
            found[rule]["peak_mb"] = max(found[rule]["peak_mb"], numbers["max_rss"])
            found[rule]["jobs"] += 1
    return dict(found)


def run(made: dict, until: list[str], cores: int, scale: int) -> dict[str, dict[str, float]]:
    """The records of one run of the workflow on a made studio."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "long.yaml").write_text(yaml.safe_dump(made))
        overlay = {"humans": {"iterations": 1500 // scale}, "background": {"training": {"iterations": 1500 // scale}}}
        (folder / "overlay.yaml").write_text(yaml.safe_dump(overlay))
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", str(cores)]
        command += ["--directory", str(folder), *until, "--configfile", str(folder / "overlay.yaml")]
        command += ["--config", f"dataset={folder / 'long.yaml'}"]
        environment = {**os.environ, "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])}
        environment["PYTHONPATH"] = str(ROOT / "workflow")
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            # What came before the failure is no measurement of a run.
            print((done.stdout + done.stderr)[-3000:], file=sys.stderr)
            raise SystemExit(f"the run of {made['frames']} frames failed; nothing is recorded")
        return recorded(folder)


def table(short: dict, long: dict, frames: tuple[int, int], cameras: int) -> dict[str, dict[str, float]]:
    """Per rule of both runs: seconds and memory of each, seconds per camera-frame more, and the exponent."""
    rows = {}
    for rule in [name for name in long if name in short]:
        a, b = short[rule], long[rule]
        more = (b["cpu_s"] - a["cpu_s"]) / (cameras * (frames[1] - frames[0]))
        grown = math.log(max(b["cpu_s"], 0.01) / max(a["cpu_s"], 0.01)) / math.log(frames[1] / frames[0])
        rows[rule] = {
            "cpu_s": [round(a["cpu_s"], 1), round(b["cpu_s"], 1)],
            "peak_mb": [round(a["peak_mb"]), round(b["peak_mb"])],
            "ms_per_camera_frame": round(1000 * more, 1),
            "exponent": round(grown, 2),
        }
    return dict(sorted(rows.items(), key=lambda row: -row[1]["ms_per_camera_frame"]))


def main() -> None:
    """Print the table and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs=2, default=(60, 240))
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--size", type=int, nargs=2, default=(240, 136))
    parser.add_argument("--until", nargs="*", default=["all"], help="targets; all = everything")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--scale", type=int, default=1, help="divides the steps of trainings, which do not grow")
    given = parser.parse_args()
    until = [] if given.until == ["all"] else given.until
    short, long = (
        run(description(f, given.cameras, given.people, tuple(given.size)), until, given.cores, given.scale)
        for f in given.frames
    )
    rows = table(short, long, tuple(given.frames), given.cameras)
    length = f"{given.frames[0]} and {given.frames[1]} frames of {given.size}"
    print(f"{given.cameras} cameras, {length}, {given.people} people")
    print(f"{'step':28s} {'cpu s':>15s} {'peak MB':>13s} {'ms / camera-frame':>18s} {'exponent':>9s}")
    for rule, row in rows.items():
        over = "  over 2 GB" if max(row["peak_mb"]) > MEMORY_BAR_MB else ""
        seconds, memory = (f"{row[key][0]:>7} {row[key][1]:>7}" for key in ("cpu_s", "peak_mb"))
        print(f"{rule:28s} {seconds} {memory} {row['ms_per_camera_frame']:14.1f} {row['exponent']:9.2f}{over}")
    machine = {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    requested = {
        "frames": list(given.frames),
        "cameras": given.cameras,
        "people": given.people,
        "size": list(given.size),
    }
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    kept[f"{given.cameras} cameras"] = {"machine": machine, "asked": requested, "rows": rows}
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
