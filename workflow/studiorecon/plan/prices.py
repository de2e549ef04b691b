# SPDX-License-Identifier: Apache-2.0
"""The price list of rules (``resources/prices.json``, measured), and the run time that it predicts on this machine."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.home import RESOURCES
from studiorecon.plan.workload import Work
from studiorecon.scene.files import read_json, write_json

if TYPE_CHECKING:
    from studiorecon.plan.decisions import Plan

PRICES = RESOURCES / "prices.json"


@dataclass(frozen=True)
class Price:
    """Processor seconds of a rule on the machine of the list: ``job_s`` per job, ``unit_s`` per unit."""

    job_s: float
    unit_s: float


@dataclass(frozen=True)
class Point:
    """A preset ("" = the defaults) and its scores on every scene where it was measured."""

    preset: str
    psnr_db: Mapping[str, float]

    def gains_db(self, over: Point) -> list[float]:
        """Differences in dB between this point and another, one per scene where both were measured."""
        return [self.psnr_db[scene] - over.psnr_db[scene] for scene in self.psnr_db if scene in over.psnr_db]


@dataclass(frozen=True)
class PriceList:
    """Prices of all rules, and the constants of the prediction.

    Attributes:
        probe_s: result of ``probe_s()`` on the machine of the list.
        start_s: seconds that the workflow itself takes before, between and after jobs.
        stretch: seconds of a run per second of its rules in sequence (below 1 where rules overlap, above where jobs
            slow each other down).
        spread: (low, high) measured over predicted time, at the extremes; includes all that is unknown before a run.
        rules: rule → price. points: the presets, cheapest first.
        quoted_s: seconds of networks and of training on one GPU, from the paper's table (an NVIDIA A6000; appendix
            "Runtime Analysis") until they are measured: a synthesised view and an enhanced picture; the poses, room and
            first person of a scene at the paper's steps; each further person.
    """

    probe_s: float
    start_s: float
    stretch: float
    spread: tuple[float, float]
    rules: Mapping[str, Price]
    points: tuple[Point, ...]
    quoted_s: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Prediction:
    """Seconds from start to page: the likeliest, and the ends of the interval of measured runs."""

    seconds: float
    low_s: float
    high_s: float


def read_prices(path: Path = PRICES) -> PriceList:
    """The price list in the file ``path``."""
    held = json.loads(path.read_text(encoding="utf-8"))
    rules = {rule: Price(**price) for rule, price in held.pop("rules").items()}
    points = tuple(Point(**point) for point in held.pop("points"))
    return PriceList(**held | {"spread": tuple(held["spread"])}, rules=rules, points=points)


def processor_seconds(work: Mapping[str, Work], prices: PriceList) -> dict[str, float]:
    """Rule → processor seconds of all its jobs on the machine of the list; rules without a price are omitted."""
    return {
        rule: part.jobs * (price.job_s + price.unit_s * part.units)
        for rule, part in work.items()
        if (price := prices.rules.get(rule)) is not None
    }


def quoted_seconds(
    plan: Plan, config: Mapping[str, Any], pictures: int, people: int, quoted_s: Mapping[str, float]
) -> dict[str, float]:
    """Part of a run on a GPU → its seconds, one after the other; ``pictures`` of all films."""
    networks, room, human = plan.networks, config["background"], config["humans"]
    views = (
        0 if networks.views in ("warp", "precomputed") else len(plan.segments) * config["views"]["views_per_segment"]
    )
    repaired = room["refinement"]["views"] + pictures if networks.enhance else 0
    trains = bool(networks.rasteriser_gpus)
    trained = (quoted_s["people"] + quoted_s["person"] * (people - 1)) * human["iterations"] / 10_000
    seconds = {
        "poses": quoted_s["poses"] * bool(people and set(networks.selected) & {"comotion", "sam3"}),
        "views": quoted_s["view"] * views,
        "the room": quoted_s["room"] * trains * room["training"]["iterations"] / 7_000,
        "people": trained * trains * bool(people),
        "films": quoted_s["picture"] * repaired,
    }
    return {part: spent for part, spent in seconds.items() if spent}


def predict(work: Mapping[str, Work], prices: PriceList, cores: int, pace: float) -> Prediction:
    """The time of a run on ``cores``, ``pace`` times as fast as the list's: rules in sequence, their jobs in
    parallel."""
    one_by_one_s = sum(
        taken_s / min(cores, work[rule].jobs) for rule, taken_s in processor_seconds(work, prices).items()
    )
    seconds = prices.start_s + prices.stretch * one_by_one_s / pace
    return Prediction(seconds, seconds * prices.spread[0], seconds * prices.spread[1])


def probe_s(rounds: int = 5, size: int = 400_000) -> float:
    """Seconds of a fixed piece of work like the workflow's (sorting, indexing, adding): the best of a few runs."""
    rng = np.random.default_rng(0)
    values, places = rng.random(size), rng.integers(0, size, size)
    took = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(4):
            order = np.argsort(values[places], kind="stable")
            np.exp(-values[order]).cumsum()
            np.add.at(np.zeros(1000), places % 1000, values)
        took.append(time.perf_counter() - begin)
    return min(took)


def machine_pace(prices: PriceList, remembered: Path) -> float:
    """The speed of this machine relative to the list's, probed once and kept in the file ``remembered``."""
    if not remembered.is_file():
        write_json(remembered, {"probe_s": probe_s()})
    return prices.probe_s / read_json(remembered)["probe_s"]
