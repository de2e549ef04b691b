# SPDX-License-Identifier: Apache-2.0
"""Which effects the survey names in plain scenes that have none: ``python -m benchmarks.plain_scenes [--seeds N]``.

Every seed is a made studio of its own: room, clothes, walks and places of cameras; straight lenses, steady light, equal
cameras, no shadows, nothing loose, keypoints off by half a pixel. The workflow runs up to the survey's decisions.
Prints what is on or undetermined beside what such a scene calls for; asked: nothing is on. Half a minute of processor
time a seed.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import yaml
from studiorecon.scene.decisions import read_decisions
from studiorecon.survey.effects import EARLY

from tests.workflow.conftest import House, make_house

# Depth is what takes the time, and is rough enough to look where cameras share the room.
ROUGH = {"primitives": 0, "sweep_width": 120, "refine_width": 160}
# Four cameras around people who walk.
CALLED_FOR = {"people", "closed_path", "view_synthesis"}


def plain(seed: int) -> dict[str, Any]:
    """The description of a plain studio."""
    return {
        "seed": seed,
        "frames": 18,
        "fps": 15.0,
        "size": [240, 136],
        "people": 1 + seed % 3,
        "cameras": {"held_out": 0},
        "detections": {"noise_px": 0.5, "shuffled": True},
    }


def named(house: House, seed: int) -> dict[str, list[str]]:
    """Verdict → effects of one scene that are neither off nor called for."""
    scene = f"plain{seed}"
    house = House(house.folder, f"{scene}.yaml")
    (house.folder / house.dataset).write_text(yaml.safe_dump(plain(seed)))
    decisions = f"results/{scene}/survey/decisions.json"
    house.snakemake("--cores", "2", decisions, "--configfile", house.overlay(depth=ROUGH))
    made = read_decisions(house.folder / decisions)
    judged = {effect.name: made[effect.name].verdict for effect in EARLY}
    missed = [f"no {effect}" for effect in sorted(CALLED_FOR) if judged[effect] != "on"]
    return {
        "on": [e for e, verdict in judged.items() if verdict == "on" and e not in CALLED_FOR],
        "undetermined": [e for e, verdict in judged.items() if verdict == "undetermined"],
        "missed": missed,
    }


def main(seeds: int) -> int:
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        house = make_house(Path(folder) / "house", "")
        for seed in range(seeds):
            found = named(house, seed)
            wrong += bool(found["on"])
            print(f"{seed:3d} " + "; ".join(f"{k}: {', '.join(v)}" for k, v in found.items() if v), flush=True)
    print(f"{wrong} of {seeds} plain scenes with an effect that is not there")
    return int(wrong > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    raise SystemExit(main(parser.parse_args().seeds))
