# SPDX-License-Identifier: Apache-2.0
"""Whether the price list is one scene's: the knobs that cost or buy most, on a second made scene and on a real take.

    STUDIORECON_REAL_DATA=... python -m tests.bench.knobs --work DIR [--scenes made real] [--frames 30] [--cores 2]

Rows of ``config/sweeps/one_at_a_time.tsv``, one knob turned at a time from its light base: on three people in another
room than the demo's, scored at held-out cameras, and on ``pose2sim_balancing/single``, scored at the camera that was
left out. DIR keeps the runs; an interrupted one goes on. Writes tests/bench/results/knobs.json: PSNR and seconds of
every row, and what each knob changes beside what it changed on the demo (``results/sweep/sweep.csv``).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
from pathlib import Path
from typing import Any

import yaml
from studiorecon.sweep.records import OK, read_records

from tests.bench.ablations import studios, sweep
from tests.bench.captures import TAKE

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results"
WHOLE = ROOT / "config/sweeps/one_at_a_time.tsv"
ROWS = ("base", "width-160", "width-320", "views-6", "synthesis-none", "bg-200", "bg-1500", "stride-fine")
ROWS += ("human-2k", "human-1000", "fit-1", "smooth-none", "seed-1")
LEFT_OUT = "cam03"


def table(folder: Path) -> Path:
    """The chosen rows as a table of their own."""
    lines = WHOLE.read_text(encoding="utf-8").splitlines()
    chosen = [line for line in lines if line.split("\t")[0] in ("name", *ROWS)]
    path = folder / "knobs.tsv"
    path.write_text("\n".join(chosen) + "\n", encoding="utf-8")
    return path


def described(scene: str, folder: Path, frames: int) -> list[str]:
    """What Snakemake is told of a scene, as ``--config`` takes it."""
    if scene == "made":
        path = folder / "made.yaml"
        path.write_text(yaml.safe_dump(studios(frames, (320, 180))["three_in_a_ring"]), encoding="utf-8")
        return [f"dataset={path}"]
    told = yaml.safe_load((ROOT / f"tests/captures/{TAKE.replace('_balancing/', '_')}.yaml").read_text("utf-8"))
    path = folder / "real.yaml"
    path.write_text(yaml.safe_dump(told | {"held_out": [LEFT_OUT], "frames": {"first": 0, "count": frames}}), "utf-8")
    take = Path(os.environ.get("STUDIORECON_REAL_DATA", "../shared/data")).resolve() / TAKE
    return [f"dataset={take}", f"capture_yaml={path}", "scene=real"]


def swept(scene: str, folder: Path, frames: int, cores: str) -> dict[str, dict[str, float]]:
    """Row → PSNR, and seconds from nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder, table(folder), described(scene, folder, frames), cores)
    records = read_records(folder / "results" / scene / "sweep/knobs/records.jsonl")[1]
    return {
        record.name: {"psnr": round(psnr, 3), "from_nothing_s": round(record.seconds["from_nothing"], 1)}
        for record in records
        if record.verdict == OK and (psnr := record.metrics["psnr"]) is not None
    }


def of_the_demo() -> dict[str, dict[str, float]]:
    """The same rows as they were on the demo."""
    with (RESULTS / "sweep/sweep.csv").open(encoding="utf-8", newline="") as file:
        return {
            row["name"]: {
                "psnr": round(float(row["psnr"]), 3),
                "from_nothing_s": round(float(row["from_nothing_s"]), 1),
            }
            for row in csv.DictReader(file)
            if row["name"] in ROWS
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--scenes", nargs="+", choices=("made", "real"), default=["made", "real"])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--cores", default="2")
    given = parser.parse_args()
    path = RESULTS / "knobs.json"
    scenes: dict[str, Any] = json.loads(path.read_text())["scenes"] if path.is_file() else {}
    scenes["demo"] = of_the_demo()
    for scene in given.scenes:
        scenes[scene] = swept(scene, given.work.resolve() / scene, given.frames, given.cores)
        changes = {
            row: {name: round(own[row]["psnr"] - own["base"]["psnr"], 2) for name, own in scenes.items() if row in own}
            for row in ROWS[1:]
        }
        path.write_text(json.dumps({"change_db": changes, "scenes": scenes}, indent=1) + "\n")
    names = list(scenes)
    print(f"| knob | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for row in ROWS[1:]:
        print(f"| {row} | " + " | ".join(f"{changes[row][n]:+.2f} dB" if n in changes[row] else "–" for n in names))


if __name__ == "__main__":
    main()
