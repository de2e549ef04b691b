# SPDX-License-Identifier: Apache-2.0
"""A budget of minutes chooses the preset: of those that are predicted to end in time, the one that scored best.

What the user says still counts: settings on the command line and in configuration files of the user's own stay, also
where they repeat a default, and so does what somebody has edited in ``config/config.yaml``.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import yaml

from studiorecon.configuration.schema import part_of
from studiorecon.errors import UserError
from studiorecon.home import PRESETS
from studiorecon.plan.decisions import Plan
from studiorecon.plan.prices import Point, Predicted, PriceList, pace_here, predict, read_prices, spent
from studiorecon.plan.workload import Footage, footage_of, segments_with_views, workload

_PACE = Path("timings") / "pace.json"


@dataclass(frozen=True)
class Stated:
    """What a user has said: ``said`` on the command line and in configuration files, and what differs in the
    configuration from the default that its ``schema`` names."""

    said: Mapping[str, Any] = field(default_factory=dict)
    schema: Mapping[str, Any] = field(default_factory=dict)

    def keeps(self, name: str, value: Any) -> bool:
        """Whether the setting of that dotted name, which has ``value`` now, is the user's own; None is no value."""
        inner: Any = self.said
        for step in name.split("."):
            if not isinstance(inner, Mapping) or step not in inner:
                return value is not None and value != part_of(self.schema, name).get("default", value)
            inner = inner[step]
        return True


@dataclass(frozen=True)
class Offer:
    """A point, how long it will take, the processor seconds in that, and the configuration that it makes."""

    point: Point
    predicted: Predicted
    work_s: float
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.point.preset or "the defaults"


@dataclass(frozen=True)
class Choice:
    """What a budget buys: the chosen offer, all of them, cheapest first, and the footage they are for."""

    minutes: float
    footage: Footage
    chosen: Offer
    offers: tuple[Offer, ...]

    @property
    def fits(self) -> bool:
        """Whether the chosen one is predicted to end in time."""
        return self.chosen.predicted.seconds <= 60 * self.minutes

    def sentence(self) -> str:
        """What was chosen and why, with its interval and what the next one would take."""
        p = self.chosen.predicted
        return (
            f"budget of {self.minutes:g} min: {self.chosen.name}, about {_minutes(p.seconds)} "
            f"({_minutes(p.low_s)} to {_minutes(p.high_s)}) with {_people(self.footage)}; {self.more()}"
        )

    def more(self) -> str:
        """What more time would buy, or what takes less where nothing fits."""
        if not self.fits:
            return "that is more, but the quickest there is; fewer frames or fewer films take less"
        better = [offer for offer in self.offers if gain_db(offer.point, self.chosen.point) > 0]
        if better:
            first = min(better, key=lambda offer: offer.predicted.seconds)
            gains = first.point.gains_db(self.chosen.point)
            span = f" ({min(gains):+.1f} to {max(gains):+.1f} on {len(gains)} scenes)" if len(gains) > 1 else ""
            return f"{first.name} would take {_minutes(first.predicted.seconds)} for {mean(gains):.1f} dB more{span}"
        dearer = [offer.name for offer in self.offers if offer.predicted.seconds > self.chosen.predicted.seconds]
        tried = f", not even {', '.join(dearer)}" if dearer else ""
        return f"nothing that was measured scores higher{tried}"

    def as_json(self) -> dict[str, Any]:
        """For the page."""
        p = self.chosen.predicted
        return {
            "minutes": self.minutes,
            "preset": self.chosen.point.preset,
            "predicted_s": round(p.seconds),
            "low_s": round(p.low_s),
            "high_s": round(p.high_s),
            "work_s": round(self.chosen.work_s),
            "more": self.more(),
        }


def bought(
    config: Mapping[str, Any], said: Mapping[str, Any], schema: Mapping[str, Any], plan: Plan, cores: int
) -> Choice:
    """What ``budget_min`` buys on this machine, whose pace is probed once and kept in ``timings/pace.json``; raises
    UserError where footage cannot be read.

    ``said`` is what command line and configuration files hold, ``schema`` the configuration's.
    """
    if plan.networks.selected:
        raise UserError(
            f"budget_min knows what our own methods cost, not {', '.join(plan.networks.selected)}; choose a preset by "
            "hand where networks are asked for"
        )
    prices = read_prices()
    footage = footage_of(plan, config["capture"]["picture_fps"])
    stated = Stated(said, schema)
    return choose(config["budget_min"], config, stated, footage, plan, prices, cores, pace_here(prices, _PACE))


def choose(
    minutes: float,
    config: Mapping[str, Any],
    stated: Stated,
    footage: Footage,
    plan: Plan,
    prices: PriceList,
    cores: int,
    pace: float,
) -> Choice:
    """The best that fits into ``minutes``; where nothing does, the quickest, and ``fits`` says so."""
    offers = []
    for point in prices.points:
        made = laid_over(config, stated, preset(point.preset))
        work = workload(footage, made, segments_with_views(plan, made), plan.forced)
        work_s = sum(spent(work, prices).values()) / pace
        offers.append(Offer(point, predict(work, prices, cores, pace), work_s, made))
    offers.sort(key=lambda offer: offer.predicted.seconds)
    fitting = [offer for offer in offers if offer.predicted.seconds <= 60 * minutes]
    defaults = next(offer.point for offer in offers if not offer.point.preset)
    # Of equal scores the quicker.
    ranked = [(gain_db(offer.point, defaults), -offer.predicted.seconds, k) for k, offer in enumerate(fitting)]
    return Choice(minutes, footage, fitting[max(ranked)[2]] if ranked else offers[0], tuple(offers))


def gain_db(point: Point, over: Point) -> float:
    """What a point scores more than another in the mean over the scenes where both were measured; -inf for none."""
    gains = point.gains_db(over)
    return mean(gains) if gains else float("-inf")


def preset(name: str) -> dict[str, Any]:
    """The settings of a preset; none for the defaults."""
    return yaml.safe_load((PRESETS / f"{name}.yaml").read_text(encoding="utf-8")) if name else {}


def laid_over(config: Mapping[str, Any], stated: Stated, over: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """A copy of ``config`` with the values of ``over`` wherever the user has not ``stated`` one."""
    made = copy.deepcopy(dict(config))
    for name, value in over.items():
        own, full = made.get(name), f"{above}{name}"
        if isinstance(value, Mapping) and isinstance(own, Mapping):
            made[name] = laid_over(own, stated, value, f"{full}.")
        elif not stated.keeps(full, own):
            made[name] = copy.deepcopy(value)
    return made


def _people(footage: Footage) -> str:
    if not footage.counted:
        return f"{footage.people} people assumed"
    return "one person" if footage.people == 1 else f"{footage.people or 'no'} people"


def _minutes(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 90
        else f"{seconds / 60:.0f} min"
        if seconds < 5400
        else f"{seconds / 3600:.1f} h"
    )
