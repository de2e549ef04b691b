# SPDX-License-Identifier: Apache-2.0
"""What acting on a verdict gains and costs: ``python -m tests.bench.exposure [--scenes gained lit ...] [--seeds N]
[--folder DIR]``.

A small synthetic studio is filmed plain, with gains of ±12 % (and a white balance of ±5 %) between the cameras, with
lamps that swing by 30 %, and with a glossy floor. On each, the effect's verdict is forced on, forced off, and left to
the survey (the regret test: what is decided must be within the better branch's spread, at no more cost). All films are
scored at the held-out cameras against the
*plain* studio's photos, where nothing is planted, after one gain per channel for the whole film: which exposure is the
common one is a convention. ``colour`` is the same PSNR of pictures averaged in blocks of 8×8 pixels, which texture that
is out of place does not hide; ``steps`` is how much the room's mean brightness departs from the photos' from picture to
picture, one standard deviation. Seconds are processor time of the steps whose work depends on the verdict. Writes
tests/bench/results/exposure.json; 3 to 5 minutes a scene and seed.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path

import numpy as np
import yaml
from studiorecon.footage.video import read_frames, to_float
from studiorecon.images.metrics import decibels
from studiorecon.scene.files import read_json, read_table, write_json
from studiorecon.scene.path import read_path

from tests.workflow.conftest import House, make_house, over

RESULT = Path(__file__).resolve().parent / "results" / "exposure.json"
STUDIO = {
    "frames": 12,
    "fps": 15.0,
    "size": [240, 136],
    "people": 2,
    "plates": True,
    "cameras": {"held_out": 2},
    "detections": {"noise_px": 0.5},
}
QUICK = {
    "depth": {"primitives": 0},
    "background": {"training": {"iterations": 600}},
    "humans": {"iterations": 400, "gaussians": 4000},
    "survey": {"force": {"view_synthesis": "on"}},
}
# scene → what is planted, and the effect whose verdict is turned.
SCENES: Mapping[str, tuple[dict, str]] = {
    "plain": ({}, "exposure"),
    "gained": ({"faults": {"exposure": 0.12, "white_balance": 0.05}}, "exposure"),
    "lit": ({"effects": {"changing_light": 0.3}}, "changing_light"),
    "matt": ({}, "view_dependent_colour"),
    "glossy": ({"effects": {"glossy_floor": 0.8}}, "view_dependent_colour"),
}
STEPS = ("survey/decide", "views", "background", "masks", "humans", "render", "enhance")
# A difference below this is none: what another seed of the same scene changes is more (evaluation §1.5).
SPREAD_DB = 0.1
BLOCK_PX = 8


def seconds(house: House, scene: str) -> float:
    """Processor seconds of the steps that depend on the verdict."""
    folder = house.folder / "benchmarks" / scene
    found = [
        p
        for step in STEPS
        for p in ([folder / f"{step}.tsv"] if "/" in step else sorted((folder / step).rglob("*.tsv")))
    ]
    return sum(float(row["cpu_time"]) for path in found if path.is_file() for row in read_table(path, ("cpu_time",)))


def pairs(house: House, scene: str, plain: str, film: str) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Every held-out picture of a film, the plain studio's photo there and where people are in it."""
    folder, truth = house.folder / "results" / scene, house.folder / "results/studio" / plain / "truth"
    shown = read_frames(folder / film / "heldout.mkv")
    steps, _ = read_path(folder / "render/heldout.json")
    for camera in dict.fromkeys(step.segment for step in steps):
        count = sum(step.segment == camera for step in steps)
        for photo, labels, _ in zip(
            read_frames(truth / "frames" / f"{camera}.mkv"),
            read_frames(truth / "masks" / f"{camera}.mkv"),
            range(count),
        ):
            yield to_float(next(shown)), to_float(photo), labels > 0


def score(house: House, scene: str, plain: str, film: str) -> dict[str, float]:
    """PSNR of all, of the room and of people, after one gain per channel for the whole film; flicker of the room over
    time."""
    made, photos, people = (np.stack(part) for part in zip(*pairs(house, scene, plain, film)))
    gain = (made * photos).sum(axis=(0, 1, 2)) / (made * made).sum(axis=(0, 1, 2))
    error = np.square(np.clip(made * gain, 0, 1) - photos).mean(axis=-1)
    per_frame = {"all": np.ones_like(people), "room": ~people, "people": people}
    found = {
        name: float(np.mean([decibels(float(e[m].mean())) for e, m in zip(error, where) if m.any()]))
        for name, where in per_frame.items()
    }
    soft = [np.square(in_blocks(np.clip(m * gain, 0, 1)) - in_blocks(p)).mean() for m, p in zip(made, photos)]
    step = [np.log(float(m[~who].mean()) / float(p[~who].mean())) for m, p, who in zip(made, photos, people)]
    found |= {"colour": float(np.mean([decibels(float(e)) for e in soft])), "steps": float(np.std(step))}
    return found | {"gain": [round(float(g), 4) for g in gain]}


def in_blocks(picture: np.ndarray) -> np.ndarray:
    """(h, w, 3) means of blocks of pixels of a picture (H, W, 3)."""
    height, width = (n // BLOCK_PX * BLOCK_PX for n in picture.shape[:2])
    return (
        picture[:height, :width].reshape(height // BLOCK_PX, BLOCK_PX, width // BLOCK_PX, BLOCK_PX, 3).mean(axis=(1, 3))
    )


def description(house: House, name: str, planted: dict, seed: int) -> str:
    path = house.folder / "resources/studio" / f"{name}.yaml"
    path.write_text(yaml.safe_dump({**STUDIO, "seed": seed, **planted}))
    return str(path.relative_to(house.folder))


def filmed(house: House, dataset: str, force: Mapping[str, str], cores: int) -> House:
    """The house with the scene made, some verdicts forced."""
    own = House(house.folder, dataset)
    overlay = own.overlay(survey={"force": {**QUICK["survey"]["force"], **force}})
    scene = Path(dataset).stem
    films = (f"results/{scene}/{film}/heldout.mkv" for film in ("render", "enhance"))
    own.snakemake(*films, "--cores", str(cores), "--configfile", overlay)
    return own


def measured(house: House, name: str, seed: int, cores: int) -> dict:
    """The scene's three runs: forced on, forced off, decided."""
    planted, effect = SCENES[name]
    plain = f"plain{seed}"
    scene = f"{name}{seed}" if planted else plain
    if not (house.folder / "results/studio" / plain / "truth").is_dir():
        filmed(house, description(house, plain, {}, seed), {}, cores)
    dataset = description(house, scene, planted, seed)
    result: dict = {"scene": name, "seed": seed, "effect": effect, "planted": planted}
    for branch in ("decided", "on", "off"):
        filmed(house, dataset, {} if branch == "decided" else {effect: branch}, cores)
        entry = {film: score(house, scene, plain, film) for film in ("render", "enhance")} | {
            "seconds": seconds(house, scene)
        }
        decided = {
            d["effect"]: d for d in read_json(house.folder / "results" / scene / "survey/decisions.json")["decisions"]
        }[effect]
        result[branch] = entry | {"verdict": decided["verdict"], "value": decided["value"], "detail": decided["detail"]}
        told = ", ".join(
            f"{k} {v:.2f}" for k, v in entry["enhance"].items() if k in ("all", "room", "people", "colour")
        )
        told += f" dB, steps {entry['enhance']['steps']:.2%}; {entry['seconds']:.0f} s"
        print(f"{name}{seed} {effect} {branch}: {told}; {decided['verdict']}", flush=True)
    best = max(result["on"]["enhance"]["all"], result["off"]["enhance"]["all"])
    result["regret_db"] = best - result["decided"]["enhance"]["all"]
    return result


def main(scenes: list[str], seeds: int, folder: Path, cores: int) -> int:
    house = House(folder, "") if (folder / "Snakefile").is_file() else make_house(folder, "")
    settings = folder / "config/config.yaml"
    settings.write_text(yaml.safe_dump(over(yaml.safe_load(settings.read_text()), QUICK), sort_keys=False))
    found = [measured(house, name, seed, cores) for seed in range(1, seeds + 1) for name in scenes]
    made = {(r["scene"], r["seed"]) for r in found}
    kept = [r for r in read_json(RESULT)["runs"] if (r["scene"], r["seed"]) not in made] if RESULT.is_file() else []
    write_json(
        RESULT,
        {
            "date": date.today().isoformat(),
            "machine": platform.processor() or platform.machine(),
            "load": os.getloadavg()[0],
            "spread_db": SPREAD_DB,
            "runs": kept + found,
        },
    )
    regretted = [f"{r['scene']}{r['seed']}" for r in found if r["regret_db"] > SPREAD_DB]
    print(f"regret over {SPREAD_DB} dB: {', '.join(regretted) or 'none'}")
    return 1 if regretted else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("--cores", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        raise SystemExit(main(given.scenes, given.seeds, given.folder or Path(temporary) / "house", given.cores))
