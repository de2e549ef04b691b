# SPDX-License-Identifier: Apache-2.0
"""What the survey's decisions save: whole runs as decided, and again with everything that plans and steps obey forced
on.

    python -m benchmarks.decisions [CASE ...] [--cores 2]

Cases are an empty room, a ring of eight cameras around one person, and the demo, all at half the demo's width and
length; the smallest studio comes first, which compiles the kernels. Both runs are of one house, so that the second does
again only what the force changes, and every job's processor seconds (Snakemake's benchmarks, without the filming of the
studio) are counted in full for both. Held-out PSNR says what the savings cost. Writes
benchmarks/results/decisions.json; cases not asked for stay.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from tests.workflow.conftest import ROOT, House, make_house

RESULTS = Path(__file__).parent / "results" / "decisions.json"
DEMO = yaml.safe_load((ROOT / "resources/studio/demo.yaml").read_text(encoding="utf-8"))
# At this size nobody could be found in the films: keypoints are recorded, as a detector would report them in larger
# ones.
SMALL = {**DEMO, "size": [240, 136], "frames": 30, "detections": {"noise_px": 1.5, "drop_outs": 0.03, "shuffled": True}}
CASES: dict[str, dict[str, Any]] = {
    "empty room": {**SMALL, "people": 0},
    "ring of eight": {**SMALL, "people": 1, "cameras": {"training": 8, "held_out": 4}},
    "demo": SMALL,
}
OBEYED = (
    "people",
    "exposure",
    "changing_light",
    "closed_path",
    "view_synthesis",
    "view_dependent_colour",
    "temporal_appearance",
    "moving_shadows",
    "dynamic_objects",
    "enhancement",
    "injection",
)
"""Effects that add work where they are called for; people are looked for also where the dataset says that nobody is."""


def spent_s(house: House, scene: str) -> Counter[str]:
    """Processor seconds of every stage's jobs."""
    found: Counter[str] = Counter()
    folder = house.folder / "timings" / scene
    for path in sorted(folder.rglob("*.tsv")):
        with path.open(encoding="utf-8", newline="") as file:
            (row,) = csv.DictReader(file, delimiter="\t")
        # Snakemake has nothing to say of jobs shorter than its first look.
        found[path.relative_to(folder).parts[0]] += 0.0 if row["cpu_time"] == "NA" else float(row["cpu_time"])
    return found


def score_db(house: House, scene: str) -> float:
    """PSNR at the held-out cameras of the run that a house has just finished."""
    metrics = json.loads((house.folder / "results" / scene / "report/metrics.json").read_text())
    return round(metrics["pictures"]["enhanced"]["psnr"]["value"], 3)


def told(house: House, scene: str) -> dict[str, Any]:
    """Seconds, score, and what was on, of the run that a house has just finished."""
    results = house.folder / "results" / scene
    stages = spent_s(house, scene)
    decided = json.loads((results / "survey/decisions.json").read_text())["decisions"]
    return {
        "cpu_s": round(sum(stages.values()), 1),
        "stages_cpu_s": {stage: round(seconds, 1) for stage, seconds in stages.items()},
        "heldout_psnr_db": score_db(house, scene),
        "on": [d["effect"] for d in decided if d["verdict"] == "on" and d["effect"] in OBEYED],
    }


def measured(folder: Path, case: str, cores: str) -> dict[str, Any]:
    """Both runs of one case in a house whose kernels are compiled."""
    scene = case.replace(" ", "_")
    house = House(folder, f"{scene}.yaml")
    (folder / house.dataset).write_text(yaml.safe_dump(CASES[case]))
    house.snakemake("--cores", cores)
    decided = told(house, scene)
    house.snakemake("--cores", cores, "--configfile", house.overlay(survey={"force": dict.fromkeys(OBEYED, "on")}))
    everything = told(house, scene)
    return {
        "saved_share": round(1 - decided["cpu_s"] / everything["cpu_s"], 3),
        "as decided": decided,
        "everything on": everything,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--cores", default="2")
    options = parser.parse_args()
    if unknown := set(options.cases) - set(CASES):
        parser.error(f"there is no case {sorted(unknown)[0]}; there are {', '.join(CASES)}")
    table = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        house = make_house(Path(folder) / "house", "resources/studio/tiny.yaml")
        house.snakemake("--cores", options.cores)
        for case in options.cases or CASES:
            table[case] = measured(house.folder, case, options.cores)
            print(f"{case}: {table[case]}", flush=True)
            RESULTS.write_text(json.dumps({name: table[name] for name in CASES if name in table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
