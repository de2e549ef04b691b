# SPDX-License-Identifier: Apache-2.0
"""What work costs: the price list that was measured (``resources/prices.json``), and the time it predicts here."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.home import RESOURCES
from studiorecon.plan.schedule import finished_s
from studiorecon.plan.workload import Work
from studiorecon.scene.files import read_json, write_json

PRICES = RESOURCES / "prices.json"
_ROUNDS, _SIZE = 5, 400_000


@dataclass(frozen=True)
class Price:
    """Processor seconds of a rule on the machine of the list: ``job_s`` for every job, ``unit_s`` for every unit."""

    job_s: float
    unit_s: float


@dataclass(frozen=True)
class Point:
    """A preset ("" = the defaults) and what it reached on every scene where it was measured."""

    preset: str
    psnr_db: Mapping[str, float]

    def gains_db(self, over: Point) -> list[float]:
        """What it scores more than another point, on every scene where both were measured."""
        return [self.psnr_db[scene] - over.psnr_db[scene] for scene in self.psnr_db if scene in over.psnr_db]


@dataclass(frozen=True)
class PriceList:
    """Prices of all rules and what is known of them.

    Attributes:
        probe_s: what ``probe_s()`` said on that machine.
        start_s: seconds that the workflow takes by itself, before, between and after jobs.
        stretch: seconds that a job takes beside others for each of its processor seconds.
        spread: (low, high) measured over predicted time on the runs it was made from, at the ends.
        rules: rule → price. points: the presets, cheapest first.
    """

    probe_s: float
    start_s: float
    stretch: float
    spread: tuple[float, float]
    rules: Mapping[str, Price]
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Predicted:
    """Seconds from start to page: the likeliest, and the ends between which such runs lay."""

    seconds: float
    low_s: float
    high_s: float


def read_prices(path: Path = PRICES) -> PriceList:
    """The price list as it is bundled."""
    held = json.loads(path.read_text(encoding="utf-8"))
    return PriceList(
        held["probe_s"],
        held["start_s"],
        held["stretch"],
        tuple(held["spread"]),
        {rule: Price(**price) for rule, price in held["rules"].items()},
        tuple(Point(**point) for point in held["points"]),
    )


def spent(work: Mapping[str, Work], prices: PriceList) -> dict[str, float]:
    """Rule → processor seconds of all its jobs, on the machine of the list; rules without a price are left out."""
    return {
        rule: asked.jobs * (price.job_s + price.unit_s * asked.units)
        for rule, asked in work.items()
        if (price := prices.rules.get(rule)) is not None
    }


def predict(
    work: Mapping[str, Work],
    prices: PriceList,
    cores: int,
    pace: float,
    least: Mapping[str, Work] | None = None,
    most: Mapping[str, Work] | None = None,
) -> Predicted:
    """How long it takes on ``cores``, each ``pace`` times as fast as those of the list, where every job waits for what
    it needs (``schedule``); from ``least`` to ``most`` work where it is not known how much there will be."""
    shortest, likeliest, longest = (_seconds(one, prices, cores, pace) for one in (least or work, work, most or work))
    low, high = prices.spread
    return Predicted(likeliest, min(shortest, likeliest) * low, max(longest, likeliest) * high)


def _seconds(work: Mapping[str, Work], prices: PriceList, cores: int, pace: float) -> float:
    jobs_s = {rule: [took_s / work[rule].jobs] * work[rule].jobs for rule, took_s in spent(work, prices).items()}
    return prices.start_s + prices.stretch * finished_s(jobs_s, cores) / pace


def probe_s() -> float:
    """Seconds of one fixed piece of work like the workflow's own, the best of a few: sorting, looking up, adding up."""
    rng = np.random.default_rng(0)
    values, places = rng.random(_SIZE), rng.integers(0, _SIZE, _SIZE)
    took = []
    for _ in range(_ROUNDS):
        begin = time.perf_counter()
        for _ in range(4):
            order = np.argsort(values[places], kind="stable")
            np.exp(-values[order]).cumsum()
            np.add.at(np.zeros(1000), places % 1000, values)
        took.append(time.perf_counter() - begin)
    return min(took)


def pace_here(prices: PriceList, remembered: Path, run: str, finished: Sequence[Path] = ()) -> float:
    """How much faster this machine is than the list's, told by runs that a budget chose here before, or else by the
    probe; remembered for ``run``, so that a run planned again is planned alike.

    ``finished`` are the costs of runs (``report/cost.json``), in which stand the processor seconds that were predicted
    for the machine of the list and those that their jobs took here.
    """
    held: dict[str, Any] = read_json(remembered) if remembered.is_file() else {}
    if run in held.get("runs", {}):
        return held["runs"][run]
    told = [entry for path in finished if (entry := read_json(path).get("budget")) and entry["spent_s"]]
    if told:
        pace = sum(entry["listed_s"] for entry in told) / sum(entry["spent_s"] for entry in told)
    else:
        held["probe_s"] = held.get("probe_s") or probe_s()
        pace = prices.probe_s / held["probe_s"]
    write_json(remembered, held | {"runs": held.get("runs", {}) | {run: pace}})
    return pace
