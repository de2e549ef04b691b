# SPDX-License-Identifier: Apache-2.0
"""Prices of work, from finished runs: ``python -m tests.bench.prices --run FOLDER SCENE PRESET DATASET [--run ...]``

FOLDER is where Snakemake was started, SCENE the name of its results, PRESET a preset's name or ``default``, DATASET
what was reconstructed. Prints predicted beside spent processor seconds of every run, and its time from start to end
where FOLDER's Snakemake log tells it; ``--write`` writes ``resources/prices.json``. A point of the list is a preset,
with the scores that it reached on every DATASET (called by its name) where it was run; ``--check`` prints how far the
list as it is bundled is off on runs that it was not made from, and writes tests/bench/results/budget.json.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import nnls
from studiorecon.configuration.schema import typed
from studiorecon.home import HOME, SCHEMA
from studiorecon.plan.budget import Stated, laid_over, preset
from studiorecon.plan.foreseen import foreseen
from studiorecon.plan.make import make_plan
from studiorecon.plan.prices import PRICES, Point, Price, PriceList, predict, probe_s, read_prices, spent
from studiorecon.plan.workload import Work, footage_of, workload
from studiorecon.report.sections.cost import cost
from studiorecon.scene.files import read_json, write_json

CORES = 2
CHECKED = Path(__file__).parent / "results" / "budget.json"


@dataclass(frozen=True)
class Run:
    """One finished run: its work, the least and the most that it might have been for all that was known before,
    processor seconds of every job by rule, seconds from start to end, its score."""

    name: str
    preset: str
    dataset: str
    work: dict[str, Work]
    ends: tuple[dict[str, Work], dict[str, Work]]
    jobs_s: dict[str, list[float]]
    wall_s: float | None
    psnr_db: float | None


def run_of(folder: Path, scene: str, name: str, dataset: str, capture_yaml: str = "") -> Run:
    """What a finished run asked for and took."""
    defaults, schema = yaml.safe_load((HOME / "config/config.yaml").read_text()), yaml.safe_load(SCHEMA.read_text())
    config = laid_over(defaults, Stated({}, schema), preset("" if name == "default" else name))
    config = typed(config | {"dataset": dataset, "capture_yaml": capture_yaml, "scene": scene}, schema)
    plan = make_plan(config, HOME)
    # What it has decided is known now.
    gaps = foreseen(plan, config | {"survey": config["survey"] | {"earlier": str(folder / "results" / scene)}})
    footage = footage_of(plan, config["capture"]["picture_fps"])
    least, work, most = (workload(replace(footage, people=people), config, gaps.likely) for people in footage.counts)
    jobs: dict[str, list[float]] = {}
    for stage, steps in cost(folder / "benchmarks" / scene)["stages"].items():
        for step, entry in steps["rules"].items():
            taken = [job["cpu_seconds"] for job in entry["jobs"].values() if job["cpu_seconds"] is not None]
            jobs.setdefault(_rule(stage, step), []).extend(taken)
    metrics = folder / "results" / scene / "report" / "metrics.json"
    pictures: Any = read_json(metrics)["pictures"] if metrics.is_file() else {}
    score = pictures.get("enhanced", {}).get("psnr", {}).get("value")
    return Run(
        scene, "" if name == "default" else name, dataset, work, (least, most), jobs, _wall_s(folder, scene), score
    )


def fit(runs: Sequence[Run]) -> dict[str, Price]:
    """Rule → its price, by non-negative least squares over the mean job of every run, each run weighing alike."""
    prices = {}
    for rule in sorted({name for run in runs for name in run.work}):
        units, took = [], []
        for run in runs:
            if rule in run.work and run.jobs_s.get(rule):
                units.append(run.work[rule].units)
                took.append(sum(run.jobs_s[rule]) / len(run.jobs_s[rule]))
        if not took:
            continue
        seconds = np.array(took)
        rows = np.stack([np.ones(len(units)), np.array(units)], axis=1) / np.maximum(seconds, 0.5)[:, None]
        scale = np.abs(rows).max(axis=0) + 1e-12
        found = nnls(rows / scale, seconds / np.maximum(seconds, 0.5))[0] / scale
        prices[rule] = Price(float(f"{found[0]:.3g}"), float(f"{found[1]:.3g}"))
    return prices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", nargs="+", action="append", required=True, metavar="WORD")
    parser.add_argument("--start-s", type=float, default=10.0, help="seconds the workflow takes by itself")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    runs = [run_of(Path(words[0]), *words[1:]) for words in options.run]
    scored: dict[str, dict[str, float]] = {}
    for run in runs:
        if run.psnr_db:
            scored.setdefault(run.preset, {})[Path(run.dataset).stem] = round(run.psnr_db, 2)
    made = PriceList(
        probe_s(), options.start_s, (1.0, 1.0), fit(runs), tuple(Point(name, own) for name, own in scored.items())
    )
    held = read_prices() if options.check else made
    pace = held.probe_s / made.probe_s if options.check else 1.0
    print(f"{'run':10} {'predicted':>10} {'spent':>8} ratio   {'predicted':>10} {'took':>8}  PSNR")
    ratios, rows = [], []
    for run in runs:
        guessed = sum(spent(run.work, held).values()) / pace
        real = sum(sum(run.jobs_s.get(rule, [])) for rule in run.work)
        ratios.append(real / guessed)
        told = predict(run.work, held, CORES, pace, *run.ends)
        whole = told.seconds
        rows.append(
            {"run": run.name, "preset": run.preset, "predicted_cpu_s": round(guessed), "spent_cpu_s": round(real)}
            | {"predicted_s": round(whole), "between_s": [round(told.low_s), round(told.high_s)]}
            | {"took_s": round(run.wall_s) if run.wall_s else None}
        )
        took = f"{run.wall_s:8.0f}" if run.wall_s else "        "
        score = f"{run.psnr_db:.2f} dB" if run.psnr_db else ""
        print(f"{run.name:10} {guessed:8.0f} s {real:6.0f} s {real / guessed:5.2f} {whole:8.0f} s {took} s  {score}")
    if options.check:
        write_json(CHECKED, {"pace": round(pace, 3), "runs": rows})
    if options.write:
        # Never narrower than what other work on the machine does to a run.
        spread = [round(min(0.8, *ratios), 2), round(max(1.25, *ratios), 2)]
        points = sorted(
            held.points, key=lambda p: next(sum(spent(r.work, held).values()) for r in runs if r.preset == p.preset)
        )
        write_json(
            PRICES,
            {
                "probe_s": round(held.probe_s, 3),
                "start_s": held.start_s,
                "spread": spread,
                "rules": {rule: asdict(price) for rule, price in held.rules.items()},
                "points": [asdict(point) for point in points],
            },
        )
        print(f"wrote {PRICES.relative_to(HOME)}")


def _rule(stage: str, step: str) -> str:
    """The rule that a benchmark's folders mean: new views have one file per segment, and are called by its number."""
    return {"people_first": "people_first_associate"}.get(
        f"{stage}_{step}", "views_synthesize" if stage == "views" and step.isdigit() else f"{stage}_{step}"
    )


def _wall_s(folder: Path, scene: str) -> float | None:
    for log in sorted((folder / ".snakemake" / "log").glob("*.log"), reverse=True):
        text = log.read_text(encoding="utf-8", errors="replace")
        elapsed = re.search(r"Elapsed time: (\d+):(\d+):([\d.]+)", text)
        if elapsed and f"results/{scene}/report/index.html" in text:
            hours, minutes, seconds = elapsed.groups()
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    return None


if __name__ == "__main__":
    main()
