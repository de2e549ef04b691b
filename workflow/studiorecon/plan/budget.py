# SPDX-License-Identifier: Apache-2.0
"""A budget of minutes chooses the preset: of those that are predicted to end in time, the one that scored best.

What the user says still counts: a preset only changes settings that stand at their default.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.errors import UserError
from studiorecon.home import PRESETS
from studiorecon.plan.decisions import Plan
from studiorecon.plan.prices import Predicted, PriceList, pace_here, predict, read_prices, spent
from studiorecon.plan.workload import Footage, footage_of, workload


@dataclass(frozen=True)
class Offer:
    """A preset ("" = the defaults), what it scored where it was measured, how long it will take, the processor seconds
    in that, and the configuration that it makes."""

    preset: str
    psnr_db: float
    predicted: Predicted
    work_s: float
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.preset or "the defaults"


@dataclass(frozen=True)
class Choice:
    """What a budget buys: the chosen offer, all of them, cheapest first, and whether the chosen one fits."""

    minutes: float
    chosen: Offer
    offers: tuple[Offer, ...]

    @property
    def fits(self) -> bool:
        return self.chosen.predicted.seconds <= 60 * self.minutes

    def sentence(self) -> str:
        """What was chosen and why, with its interval and what the next one would take."""
        p = self.chosen.predicted
        said = (
            f"budget of {self.minutes:g} min: {self.chosen.name}, about {_minutes(p.seconds)} "
            f"({_minutes(p.low_s)} to {_minutes(p.high_s)})"
        )
        if not self.fits:
            return f"{said}, more than that: it is the quickest there is; fewer frames or fewer films take less"
        better = [o for o in self.offers if o.psnr_db > self.chosen.psnr_db]
        if better:
            first = min(better, key=lambda o: o.predicted.seconds)
            gain = first.psnr_db - self.chosen.psnr_db
            return f"{said}; {first.name} would take {_minutes(first.predicted.seconds)} for {gain:.1f} dB more"
        return f"{said}; nothing measured scores higher, so more time would buy nothing"

    def as_json(self) -> dict[str, Any]:
        """For the page."""
        p = self.chosen.predicted
        return {
            "minutes": self.minutes,
            "preset": self.chosen.preset,
            "predicted_s": round(p.seconds),
            "low_s": round(p.low_s),
            "high_s": round(p.high_s),
            "work_s": round(self.chosen.work_s),
        }


def bought(config: Mapping[str, Any], home: Path, plan: Plan, cores: int) -> Choice:
    """What ``budget_min`` buys on this machine, whose pace is probed once and kept in ``benchmarks/pace.json``; raises
    UserError where footage cannot be read."""
    if plan.networks.selected:
        raise UserError(
            f"budget_min knows what our own methods cost, not {', '.join(plan.networks.selected)}; choose a preset by "
            "hand where networks are asked for"
        )
    prices = read_prices()
    defaults = yaml.safe_load((home / "config" / "config.yaml").read_text(encoding="utf-8"))
    footage = footage_of(plan, config["capture"]["picture_fps"])
    pace = pace_here(prices, Path("benchmarks") / "pace.json")
    return choose(config["budget_min"], config, defaults, footage, prices, cores, pace)


def choose(
    minutes: float,
    config: Mapping[str, Any],
    defaults: Mapping[str, Any],
    footage: Footage,
    prices: PriceList,
    cores: int,
    pace: float,
) -> Choice:
    """The best that fits into ``minutes``; where nothing does, the quickest, and ``fits`` says so."""
    offers = []
    for point in prices.points:
        made = laid_over(config, defaults, preset(point.preset))
        work = workload(footage, made)
        work_s = sum(spent(work, prices).values()) / pace
        offers.append(Offer(point.preset, point.psnr_db, predict(work, prices, cores, pace), work_s, made))
    offers.sort(key=lambda offer: offer.predicted.seconds)
    fitting = [offer for offer in offers if offer.predicted.seconds <= 60 * minutes]
    # Of equal scores the quicker.
    chosen = max(fitting, key=lambda offer: (offer.psnr_db, -offer.predicted.seconds)) if fitting else offers[0]
    return Choice(minutes, chosen, tuple(offers))


def preset(name: str) -> dict[str, Any]:
    """The settings of a preset; none for the defaults."""
    return yaml.safe_load((PRESETS / f"{name}.yaml").read_text(encoding="utf-8")) if name else {}


def laid_over(config: Mapping[str, Any], defaults: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of ``config`` with the values of ``over`` wherever ``config`` still has the default."""
    made = copy.deepcopy(dict(config))
    for name, value in over.items():
        own, default = made.get(name), defaults.get(name)
        if isinstance(value, Mapping) and isinstance(own, Mapping):
            made[name] = laid_over(own, default if isinstance(default, Mapping) else {}, value)
        elif own == default:
            made[name] = copy.deepcopy(value)
    return made


def _minutes(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 90
        else f"{seconds / 60:.0f} min"
        if seconds < 5400
        else f"{seconds / 3600:.1f} h"
    )
