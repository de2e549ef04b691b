# SPDX-License-Identifier: Apache-2.0
"""What obeying a verdict gains: score and processor time of a scene as decided, less those with one effect forced the
other way.

    python -m tests.bench.gains [SCENE ...] [--cores 2]

Scenes are synthetic studios at half the demo's width and length, one of them plain, in every other one thing planted;
they are filmed and reconstructed as decided, and again with an effect forced to what was not decided: on the plain
scene every effect that can be forced, on the others the one that is planted. A forced run takes over what it shares
with the decided one, and jobs that it does without are not counted. Obeying is on the front unless the other way is
better by more than chance in score (0.05 dB) and no dearer, or cheaper (by 2 %) and no worse. Writes
tests/bench/results/gains.json; scenes that were not asked for stay.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from tests.bench.decisions import OBEYED, SMALL, score_db, spent_s
from tests.workflow.conftest import House, make_house

RESULTS = Path(__file__).parent / "results" / "gains.json"
# What chance does to a score, and to seconds.
CHANCE_DB, CHANCE = 0.05, 0.02
FORCED = tuple(effect for effect in OBEYED if effect != "people")
# Scene → what is planted, and the effects that are forced the other way.
SCENES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "plain": ({}, FORCED),
    "gains": ({"faults": {"exposure": 0.12}}, ("exposure",)),
    "light": ({"effects": {"changing_light": 0.25}}, ("changing_light",)),
    "shadows": ({"effects": {"moving_shadows": True}}, ("moving_shadows",)),
    "ball": ({"effects": {"ball": True}}, ("dynamic_objects",)),
    "specularity": ({"effects": {"glossy_floor": 0.5}}, ("view_dependent_colour",)),
    "arc": (
        {"cameras": {"training": 4, "held_out": 3, "layout": "arc", "arc_deg": 120.0}},
        ("closed_path", "view_synthesis"),
    ),
    "ring of eight": ({"cameras": {"training": 8, "held_out": 4}}, ("view_synthesis",)),
    "empty room": ({"people": 0}, ("view_synthesis", "view_dependent_colour")),
}
# Jobs that are there for one effect alone: without it their old records do not count.
OWN = {
    "view_synthesis": ("views/0*",),
    "closed_path": ("views/0*",),
    "moving_shadows": ("render/light*", "render/shade*"),
    "dynamic_objects": ("objects/*",),
}


def told(house: House, scene: str) -> dict[str, Any]:
    """Seconds, in all and by stage, and score of the run that a house has just finished."""
    stages = spent_s(house, scene)
    parts = {stage: round(seconds, 1) for stage, seconds in stages.items()}
    return {"cpu_s": round(sum(stages.values()), 1), "psnr_db": score_db(house, scene), "stages_cpu_s": parts}


def verdicts(house: House, scene: str) -> dict[str, str]:
    """Effect → verdict, of the survey and of what was trained."""
    files = [house.folder / "results" / scene / name for name in ("survey/decisions.json", "report/audit.json")]
    return {d["effect"]: d["verdict"] for file in files for d in json.loads(file.read_text())["decisions"]}


def on_front(obeyed: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether the other way is not better in one and at least as good in the other."""
    better, worse = other["psnr_db"] - obeyed["psnr_db"], 1 - other["cpu_s"] / obeyed["cpu_s"]
    return not ((better > CHANCE_DB and worse > -CHANCE) or (worse > CHANCE and better > -CHANCE_DB))


def measured(folder: Path, name: str, cores: str) -> dict[str, Any]:
    """One scene as decided and with its effects forced the other way, in a house whose kernels are compiled."""
    scene, (planted, effects) = name.replace(" ", "_"), SCENES[name]
    house = House(folder, f"{scene}.yaml")
    (folder / house.dataset).write_text(yaml.safe_dump(SMALL | planted))
    house.snakemake("--cores", cores)
    decided, obeyed = verdicts(house, scene), told(house, scene)
    rows = {}
    for effect in effects:
        other = "off" if decided[effect] == "on" else "on"
        with tempfile.TemporaryDirectory() as temporary:
            copy = replace(house, folder=Path(temporary) / "house")
            shutil.copytree(house.folder, copy.folder, symlinks=True)
            # A person around whom nothing has changed is not trained again, which costs nothing and says nothing.
            shutil.rmtree(copy.folder / "logs" / scene / "humans", ignore_errors=True)
            for pattern in OWN.get(effect, ()) if other == "off" else ():
                for path in (copy.folder / "benchmarks" / scene).glob(pattern):
                    path.unlink() if path.is_file() else shutil.rmtree(path)
            copy.snakemake("--cores", cores, "--configfile", copy.overlay(survey={"force": {effect: other}}))
            forced = told(copy, scene)
        rows[effect] = {"decided": decided[effect], "forced": other, **forced, "on_front": on_front(obeyed, forced)}
        print(name, effect, rows[effect], "against", obeyed, flush=True)
    return {"as decided": obeyed, "verdicts": decided, "forced": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--cores", default="2")
    options = parser.parse_args()
    if unknown := set(options.scenes) - set(SCENES):
        parser.error(f"there is no scene {sorted(unknown)[0]}; there are {', '.join(SCENES)}")
    table = json.loads(RESULTS.read_text())["scenes"] if RESULTS.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        house = make_house(Path(folder) / "house", "resources/studio/tiny.yaml")
        # Compiles the kernels, which would count as the first scene's.
        house.snakemake("--cores", options.cores)
        for scene in options.scenes or SCENES:
            table[scene] = measured(house.folder, scene, options.cores)
            rows = [row["on_front"] for one in table.values() for row in one["forced"].values()]
            kept = {name: table[name] for name in SCENES if name in table}
            RESULTS.write_text(json.dumps({"on_front": f"{sum(rows)} of {len(rows)}", "scenes": kept}, indent=1) + "\n")
            print(f"obeying is on the front in {sum(rows)} of {len(rows)}", flush=True)


if __name__ == "__main__":
    main()
