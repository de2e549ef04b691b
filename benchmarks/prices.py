# SPDX-License-Identifier: Apache-2.0
"""Prices of work, from finished runs: ``python -m benchmarks.prices --run FOLDER SCENE PRESET DATASET [--run ...]``

FOLDER is where Snakemake was started, SCENE the name of its results, PRESET a preset's name or ``default``, DATASET
what was reconstructed. Runs ``--run`` make the prices, runs ``--against`` do not; of every one it prints predicted
beside spent processor seconds, and its time from start to end where FOLDER's Snakemake log holds it. ``--write`` writes
``resources/prices.json``, and of the runs ``--against`` benchmarks/results/budget.json. A point of the list is a
preset, with the scores that it reached on every DATASET (called by its name) where it was run.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import nnls
from studiorecon.configuration.schema import coerce_types
from studiorecon.home import HOME, SCHEMA
from studiorecon.humans.result_cache import UP_TO_DATE
from studiorecon.plan.budget import UserChoices, overlay_settings, read_preset
from studiorecon.plan.make import make_plan
from studiorecon.plan.prices import PRICES, Point, Price, PriceList, predict, probe_s, processor_seconds, read_prices
from studiorecon.plan.workload import ON_DEMAND, Work, measure_footage, segments_with_views, workload
from studiorecon.report.sections.cost import cost
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.files import read_json, write_json

CORES = 2
# Measured over predicted time of runs whose people and effects were not known before, at the ends.
SPREAD = (0.7, 1.5)
# Seconds of a run for one of its rules one after the other: within 16 % of a schedule of the jobs on 1 to 16 cores.
STRETCH = 1.05
_TELLING = 2.0
CHECKED = Path(__file__).parent / "results" / "budget.json"


@dataclass(frozen=True)
class Run:
    """One finished run: its work, processor seconds of every job by rule, seconds from start to end, its score."""

    name: str
    preset: str
    dataset: str
    work: dict[str, Work]
    jobs_s: dict[str, list[float]]
    wall_s: float | None
    psnr_db: float | None


def run_of(folder: Path, scene: str, name: str, dataset: str, capture_yaml: str = "") -> Run:
    """What a finished run asked for and took."""
    defaults, schema = yaml.safe_load((HOME / "config/config.yaml").read_text()), yaml.safe_load(SCHEMA.read_text())
    config = overlay_settings(defaults, UserChoices({}, schema), read_preset("" if name == "default" else name))
    config = coerce_types(config | {"dataset": dataset, "capture_yaml": capture_yaml, "scene": scene}, schema)
    plan = make_plan(config, HOME)
    # What it has decided is known now.
    made = read_decisions(folder / "results" / scene / "survey/decisions.json")
    verdicts = {effect: made[effect].verdict for effect in ("view_synthesis", *ON_DEMAND.values())}
    known = replace(
        plan, forced_effects={**{e: "on" if v == "on" else "off" for e, v in verdicts.items()}, **plan.forced_effects}
    )
    log, wall_s = _log(folder, scene)
    footage = measure_footage(plan, config["capture"]["picture_fps"])
    footage = replace(footage, synthetic="(Rule: studio_capture)" in log)
    work = workload(footage, config, segments_with_views(known, config), known.forced_effects)
    for reported in sorted((folder / "logs" / scene / "humans/train").glob("*.log")):
        if UP_TO_DATE in reported.read_text(encoding="utf-8"):
            raise SystemExit(f"{reported}: this person was trained before; take logs/{scene} away too before the run")
    jobs: dict[str, list[float]] = {}
    stages = dict(cost(folder / "timings" / scene)["stages"])
    if footage.synthetic:
        stages["studio"] = {
            "rules": {"capture": cost(folder / "timings/studio" / plan.studio)["stages"]["run"]["rules"]["capture"]}
        }
    for stage, steps in stages.items():
        for step, entry in steps["rules"].items():
            taken = [job for job in entry["jobs"].values() if job["cpu_seconds"] is not None]
            jobs.setdefault(_rule(stage, step), []).extend(job["cpu_seconds"] for job in taken)
    metrics = folder / "results" / scene / "report" / "metrics.json"
    pictures: Any = read_json(metrics)["pictures"] if metrics.is_file() else {}
    score = pictures.get("enhanced", {}).get("psnr", {}).get("value")
    return Run(scene, "" if name == "default" else name, dataset, work, jobs, wall_s, score)


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
        # Jobs of about one size do not tell what a larger one would take beside what every job takes.
        every = float(max(units) > _TELLING * min(units))
        rows = np.stack([np.full(len(units), every), np.array(units)], axis=1) / np.maximum(seconds, 0.5)[:, None]
        scale = np.abs(rows).max(axis=0) + 1e-12
        found = nnls(rows / scale, seconds / np.maximum(seconds, 0.5))[0] / scale
        prices[rule] = Price(float(f"{found[0]:.3g}"), float(f"{found[1]:.3g}"))
    return prices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", nargs="+", action="append", required=True, metavar="WORD")
    parser.add_argument("--against", nargs="+", action="append", default=[], metavar="WORD")
    parser.add_argument("--start-s", type=float, default=10.0, help="seconds the workflow takes by itself")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    own, others = ([run_of(Path(words[0]), *words[1:]) for words in given] for given in (options.run, options.against))
    scored: dict[str, dict[str, float]] = {}
    for run in own:
        if run.psnr_db:
            scored.setdefault(run.preset, {})[Path(run.dataset).stem] = round(run.psnr_db, 2)
    # A scene that was run with one preset compares nothing.
    often = Counter(scene for scores in scored.values() for scene in scores)
    points = tuple(Point(name, {s: db for s, db in scores.items() if often[s] > 1}) for name, scores in scored.items())
    quoted_s = read_prices().quoted_s
    made = PriceList(probe_s(), options.start_s, STRETCH, SPREAD, fit(own), points, quoted_s)
    print(f"{'run':10} {'predicted':>10} {'spent':>8} ratio   {'predicted':>10} {'took':>8}  PSNR")
    ratios, rows = [], []
    for run in (*own, *others):
        reported, guessed = predict(run.work, made, CORES, 1.0), sum(processor_seconds(run.work, made).values())
        real = sum(sum(run.jobs_s.get(rule, [])) for rule in run.work)
        ratios.append(run.wall_s / reported.seconds if run.wall_s else real / guessed)
        rows.append(
            {"run": run.name, "preset": run.preset, "predicted_cpu_s": round(guessed), "spent_cpu_s": round(real)}
            | {"predicted_s": round(reported.seconds), "between_s": [round(reported.low_s), round(reported.high_s)]}
            | {"took_s": round(run.wall_s) if run.wall_s else None}
        )
        took = f"{run.wall_s:8.0f}" if run.wall_s else "        "
        score = f"{run.psnr_db:.2f} dB" if run.psnr_db else ""
        ratio = f"{real / guessed:5.2f}"
        print(f"{run.name:10} {guessed:8.0f} s {real:6.0f} s {ratio} {reported.seconds:8.0f} s {took} s  {score}")
    if options.write:
        write_json(CHECKED, {"runs": rows[len(own) :]})
        spread = [round(min(SPREAD[0], *ratios), 2), round(max(SPREAD[1], *ratios), 2)]
        cost_of = {run.preset: sum(processor_seconds(run.work, made).values()) for run in reversed(own)}
        write_json(
            PRICES,
            {
                "probe_s": round(made.probe_s, 3),
                "start_s": made.start_s,
                "stretch": round(made.stretch, 2),
                "quoted_s": quoted_s,
                "spread": spread,
                "rules": {rule: asdict(price) for rule, price in made.rules.items()},
                "points": [asdict(point) for point in sorted(points, key=lambda point: cost_of[point.preset])],
            },
        )
        print(f"wrote {PRICES.relative_to(HOME)}")


def _rule(stage: str, step: str) -> str:
    """The rule that a benchmark's folders mean: new views have one file per segment, and are called by its number."""
    return {"people_first": "people_first_associate"}.get(
        f"{stage}_{step}", "views_synthesize" if stage == "views" and step.isdigit() else f"{stage}_{step}"
    )


def _log(folder: Path, scene: str) -> tuple[str, float | None]:
    """What Snakemake said of the last whole run of a scene, and its seconds from start to end."""
    for log in sorted((folder / ".snakemake" / "log").glob("*.log"), reverse=True):
        text = log.read_text(encoding="utf-8", errors="replace")
        elapsed = re.search(r"Elapsed time: (\d+):(\d+):([\d.]+)", text)
        if elapsed and f"results/{scene}/report/index.html" in text:
            hours, minutes, seconds = elapsed.groups()
            return text, int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    return "", None


if __name__ == "__main__":
    main()
