# SPDX-License-Identifier: Apache-2.0
"""Rates at which planted effects turn the survey's verdicts, on made scenes: ``python -m benchmarks.effects [--seeds
N]``.

Every effect is planted alone in a scene that has none (``tests/made/studio_world.py``), several times: other textures,
walks and noise, and all effects are decided. The diagonal is the share of seeds in which the planted effect's verdict
turns as it must; every other entry is the share in which another effect's verdict turns though nothing of it was
planted ("undetermined" turns nothing). The first row plants nothing; lens, clock and readout, which other steps
estimate, must turn nothing either. Bar: at least 0.95 on the diagonal and at most 0.05 elsewhere.

Then every two effects that can be planted in one scene are, with three of those seeds each, so that every seed has its
turn: both must be detected, and no third one. An effect that the other one voids, or that no person shows then, must be
undetermined. Bar: every effect is detected in at least 0.95 of its pairs, and turns in at most 0.05 of the others.

It also measures the survey's own processor time on those scenes. What shows only in trained scenes is planted in
tests/report alone. Prints both and writes benchmarks/results/effects.json and, from it, tests/effects/README.md. 10
seconds of processor time a seed alone, ten minutes for the pairs.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections import Counter
from collections.abc import Mapping
from datetime import date
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.scene.files import write_json
from studiorecon.survey.effect_decisions import Settings, decide_effects
from studiorecon.survey.effects import EARLY
from studiorecon.survey.evidence import Evidence

from tests.defaults import loaded
from tests.made.studio_world import OTHERWISE, PLANTED, scene

ROOT = Path(__file__).resolve().parents[1]
RESULT = Path(__file__).resolve().parent / "results" / "effects.json"
PAGE = ROOT / "tests" / "effects" / "README.md"
MIN, MAX = 0.95, 0.05
_VOIDS = {effect.name for effect in EARLY if effect.void_reason}
# Effect → those that void it while they are on.
HIDING = {effect.name: _VOIDS & set(effect.hidden_by) for effect in EARLY}
# Effects that only people show.
OF_PEOPLE = {"moving_shadows", "hands"}
TIMES = 3


def pairs() -> list[tuple[str, str]]:
    """Effects that can be planted together: no two of them set the same of a scene, or where its cameras stand."""
    return [(one, other) for one, other in combinations(PLANTED, 2) if not set(PLANTED[one]) & set(PLANTED[other])]


def left_open(effect: str, beside: str) -> bool:
    """Whether nothing can be said of an effect where another one is planted too."""
    voided = beside in HIDING.get(effect, ())
    return voided or (beside == "people" and effect in OF_PEOPLE)


def in_pairs(seeds: int, settings: Settings, usual: Mapping[str, str]) -> dict[str, Any]:
    """Share of its pairs in which every effect is found, share of the others in which it is invented, and which."""
    found: dict[str, list[bool]] = {effect: [] for effect in PLANTED}
    invented: dict[str, list[bool]] = {effect: [] for effect in usual}
    missed: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    for number, pair in enumerate(pairs()):
        for k in range(TIMES):
            seed = 2000 + (number + 7 * k) % seeds
            reported, _ = verdicts(seed, settings, **PLANTED[pair[0]], **PLANTED[pair[1]])
            for effect, beside in (pair, pair[::-1]):
                right = (
                    reported[effect] == "undetermined"
                    if left_open(effect, beside)
                    else turned(usual[effect], reported[effect])
                )
                found[effect].append(right)
                missed[f"{effect} beside {beside}"] += not right
            for third in set(usual) - set(pair):
                invented[third].append(turned(usual[third], reported[third]))
                wrong[f"{third} of {pair[0]} and {pair[1]}"] += invented[third][-1]
        print(f"{' and '.join(pair):50s} missed {+missed} invented {+wrong}" if missed or wrong else pair, flush=True)
    return {
        "pairs": len(pairs()),
        "scenes": TIMES * len(pairs()),
        "found": {effect: round(float(np.mean(own)), 3) for effect, own in found.items()},
        "invented": {effect: round(float(np.mean(own)), 3) for effect, own in invented.items() if own},
        "missed": {name: count for name, count in missed.items() if count},
        "wrong": {name: count for name, count in wrong.items() if count},
    }


def verdicts(seed: int, settings: Settings, **planted: object) -> tuple[dict[str, str], float]:
    """Effect → verdict, and the processor seconds of the survey."""
    material = scene(seed, **planted)
    begun = time.process_time()
    made = decide_effects(Evidence(material, settings), settings.thresholds)
    return {d.effect: d.verdict for d in made}, time.process_time() - begun


def turned(before: str, after: str) -> bool:
    """A verdict that says the opposite; what cannot be told says nothing."""
    return after != "undetermined" and after != before and not (before == "undetermined" and after == "off")


def page(result: dict[str, Any]) -> str:
    """The result as a page of the docs: effects in rows, decisions in columns, only what is not 0."""
    matrix, scored = result["matrix"], list(result["usual"])
    letters = {e: f"{k + 1}" for k, e in enumerate(scored)}
    lines = [
        "# Which effect turns which decision",
        "",
        f"`python -m benchmarks.effects --seeds {result['seeds']}` printed this on {result['date']}: each effect "
        "planted alone in a made scene that has none of",
        "them, and the share of seeds in which a decision turned. Asked: at least 0.95 on the diagonal, at most 0.05 "
        "beside it.",
        "A dot is 0. Scenes are made (`tests/made/studio_world.py`): no threshold is calibrated on real captures.",
        "",
        "| planted | " + " | ".join(f"{letters[e]}" for e in scored) + " |",
        "|---|" + "---|" * len(scored),
    ]
    for planted in sorted(matrix, key=lambda e: scored.index(e) if e in letters else -1):
        row = matrix[planted]
        name = f"{letters[planted]} {planted.replace('_', ' ')}" if planted in letters else planted
        lines.append(f"| {name} | " + " | ".join("·" if row[e] == 0 else f"{row[e]:.2f}" for e in scored) + " |")
    pairs = result["pairs"]
    lines += [
        "",
        f"Planted in pairs, {pairs['scenes']} scenes of {pairs['pairs']} pairs: the share of its pairs in which an "
        "effect is found",
        "(or left open, where the other voids it or leaves nobody to show it), and of the others in which it turned.",
        "",
        "| | " + " | ".join(letters[e] for e in scored) + " |",
        "|---|" + "---|" * len(scored),
    ]
    for name, word in (("found", "planted: found"), ("invented", "not planted: turned")):
        reported = [("" if e not in pairs[name] else f"{pairs[name][e]:.2f}") for e in scored]
        lines.append(f"| {word} | " + " | ".join("·" if t == "0.00" else t for t in reported) + " |")
    for name, word in (("missed", "Missed"), ("wrong", "Turned")):
        if pairs[name]:
            listed = "; ".join(f"{k.replace('_', ' ')} ({n} of {TIMES})" for k, n in pairs[name].items())
            lines += ["", f"{word}: {listed}."]
    lines += ["", "Decisions about trained scenes are planted in `tests/report/test_report_audit.py`."]
    return "\n".join(lines) + "\n"


def main(seeds: int) -> int:
    settings = loaded(Settings)
    scored = list(verdicts(0, settings)[0])
    plain = [verdicts(seed, settings) for seed in range(seeds)]
    usual = {e: max(("on", "off", "undetermined"), key=[v[e] for v, _ in plain].count) for e in scored}
    rows = {"nothing": {e: float(np.mean([turned(usual[e], v[e]) for v, _ in plain])) for e in scored}}
    seconds = [s for _, s in plain]
    for effect, planted in {**PLANTED, **OTHERWISE}.items():
        found = [verdicts(1000 + seed, settings, **planted)[0] for seed in range(seeds)]
        rows[effect] = {e: float(np.mean([turned(usual[e], v[e]) for v in found])) for e in scored}
        print(f"{effect:22s} " + " ".join(f"{rows[effect][e]:4.2f}" for e in scored), flush=True)
    together = in_pairs(seeds, settings, usual)
    missed = {e: rows[e][e] for e in PLANTED if rows[e][e] < MIN}
    false = {
        f"{planted} → {e}": share
        for planted, row in rows.items()
        for e, share in row.items()
        if e != planted and share > MAX
    }
    result = {
        "date": date.today().isoformat(),
        "machine": platform.processor() or platform.machine(),
        "load": os.getloadavg()[0],
        "seeds": seeds,
        "planted": {k: {n: list(v) if isinstance(v, tuple) else v for n, v in p.items()} for k, p in PLANTED.items()},
        "usual": usual,
        "matrix": rows,
        "missed": missed,
        "false": false,
        "pairs": together,
        "survey_processor_s": {"least": min(seconds), "median": float(np.median(seconds))},
    }
    write_json(RESULT, result)
    PAGE.write_text(page(result), encoding="utf-8")
    below = {e: share for e, share in together["found"].items() if share < MIN}
    above = {e: share for e, share in together["invented"].items() if share > MAX}
    print(f"usual verdicts: {usual}")
    print(f"in pairs, found in less than {MIN}: {below or 'none'}; invented in more than {MAX}: {above or 'none'}")
    print(f"diagonal below {MIN}: {missed or 'none'}; beside it above {MAX}: {false or 'none'}")
    return 0 if not (missed or false or below or above) else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    raise SystemExit(main(parser.parse_args().seeds))
