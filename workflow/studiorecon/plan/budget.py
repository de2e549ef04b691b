# SPDX-License-Identifier: Apache-2.0
"""A budget of minutes chooses the preset: the best-scoring one of those predicted to end in time.

The user's own settings take precedence: those on the command line and in configuration files, even where they repeat a
default, and edits of ``config/config.yaml``.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

import yaml

from studiorecon.configuration.schema import find_schema
from studiorecon.errors import UserError
from studiorecon.home import PRESETS
from studiorecon.plan.decisions import Plan
from studiorecon.plan.prices import (
    Point,
    Prediction,
    PriceList,
    machine_pace,
    predict,
    processor_seconds,
    quoted_seconds,
    read_prices,
)
from studiorecon.plan.workload import Footage, film_pictures, measure_footage, segments_with_views, workload

_PACE = Path("timings") / "pace.json"


@dataclass(frozen=True)
class UserChoices:
    """The user's own settings: ``given`` on the command line and in files, and values that differ from ``schema``."""

    given: Mapping[str, Any] = field(default_factory=dict)
    schema: Mapping[str, Any] = field(default_factory=dict)

    def is_user_value(self, name: str, value: Any) -> bool:
        """Whether the setting of that dotted name, now at ``value``, is the user's own; None means no value."""
        inner: Any = self.given
        for step in name.split("."):
            if not isinstance(inner, Mapping) or step not in inner:
                return value is not None and value != find_schema(self.schema, name).get("default", value)
            inner = inner[step]
        return True


@dataclass(frozen=True)
class Offer:
    """A preset with its predicted time, the processor seconds of that, and the configuration that it makes."""

    point: Point
    prediction: Prediction
    work_s: float
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.point.preset or "the defaults"


@dataclass(frozen=True)
class Choice:
    """The chosen offer, all offers from the cheapest up, and the footage that they are for."""

    minutes: float
    footage: Footage
    chosen: Offer
    offers: tuple[Offer, ...]

    @property
    def fits(self) -> bool:
        """Whether the chosen offer is predicted to end in time."""
        return self.chosen.prediction.seconds <= 60 * self.minutes

    def sentence(self) -> str:
        """The choice and its reason, with the predicted interval and the time of the next better offer."""
        p = self.chosen.prediction
        return (
            f"budget of {self.minutes:g} min: {self.chosen.name}, about {_minutes(p.seconds)} "
            f"({_minutes(p.low_s)} to {_minutes(p.high_s)}) with {_people(self.footage)}; {self.more()}"
        )

    def more(self) -> str:
        """The gain that more time would buy; where nothing fits, the settings that take less."""
        if not self.fits:
            return "over the budget, but no preset is quicker; use fewer frames or films"
        better = [offer for offer in self.offers if gain_db(offer.point, self.chosen.point) > 0]
        if better:
            first = min(better, key=lambda offer: offer.prediction.seconds)
            gains = first.point.gains_db(self.chosen.point)
            span = f" ({min(gains):+.1f} to {max(gains):+.1f} on {len(gains)} scenes)" if len(gains) > 1 else ""
            return f"{first.name} would take {_minutes(first.prediction.seconds)} for {mean(gains):.1f} dB more{span}"
        dearer = [offer.name for offer in self.offers if offer.prediction.seconds > self.chosen.prediction.seconds]
        tried = f", not even {', '.join(dearer)}" if dearer else ""
        return f"no measured preset scores higher{tried}"

    def as_json(self) -> dict[str, Any]:
        """The choice as JSON for the page."""
        p = self.chosen.prediction
        return {
            "minutes": self.minutes,
            "preset": self.chosen.point.preset,
            "predicted_s": round(p.seconds),
            "low_s": round(p.low_s),
            "high_s": round(p.high_s),
            "work_s": round(self.chosen.work_s),
            "more": self.more(),
        }


def choose_preset(
    config: Mapping[str, Any], given: Mapping[str, Any], schema: Mapping[str, Any], plan: Plan, cores: int
) -> Choice:
    """The preset for ``budget_min`` on this machine, whose pace is probed once and kept in ``timings/pace.json``.

    ``given`` holds the settings of command line and configuration files. Raises UserError for unreadable footage.
    """
    prices = read_prices()
    footage = measure_footage(plan, config["capture"]["picture_fps"])
    if plan.networks.selected:
        parts = quoted_seconds(plan, config, film_pictures(footage, config), footage.people, prices.quoted_s)
        each = ", ".join(f"{part} {_minutes(seconds)}" for part, seconds in parts.items())
        cost = f" These settings take about {_minutes(sum(parts.values()))} of one GPU by the paper's table: {each}."
        raise UserError(
            f"budget_min covers only the built-in methods, not {', '.join(plan.networks.selected)}; choose a preset "
            f"instead.{cost if parts else ''}"
        )
    stated = UserChoices(given, schema)
    return choose_offer(config["budget_min"], config, stated, footage, plan, prices, cores, machine_pace(prices, _PACE))


def choose_offer(
    minutes: float,
    config: Mapping[str, Any],
    stated: UserChoices,
    footage: Footage,
    plan: Plan,
    prices: PriceList,
    cores: int,
    pace: float,
) -> Choice:
    """The best offer that fits into ``minutes``; where none does, the quickest, with ``fits`` false."""
    offers = []
    for point in prices.points:
        made = overlay_settings(config, stated, read_preset(point.preset))
        work = workload(footage, made, segments_with_views(plan, made), plan.forced_effects)
        work_s = sum(processor_seconds(work, prices).values()) / pace
        offers.append(Offer(point, predict(work, prices, cores, pace), work_s, made))
    offers.sort(key=lambda offer: offer.prediction.seconds)
    fitting = [offer for offer in offers if offer.prediction.seconds <= 60 * minutes]
    defaults = next(offer.point for offer in offers if not offer.point.preset)
    # Of equal scores the quicker one wins.
    ranked = [(gain_db(offer.point, defaults), -offer.prediction.seconds, k) for k, offer in enumerate(fitting)]
    return Choice(minutes, footage, fitting[max(ranked)[2]] if ranked else offers[0], tuple(offers))


def gain_db(point: Point, over: Point) -> float:
    """Mean gain in dB of one point over another on the scenes where both were measured; -inf when there are none."""
    gains = point.gains_db(over)
    return mean(gains) if gains else float("-inf")


def read_preset(name: str) -> dict[str, Any]:
    """The settings of a preset; none for the defaults."""
    return yaml.safe_load((PRESETS / f"{name}.yaml").read_text(encoding="utf-8")) if name else {}


def overlay_settings(
    config: Mapping[str, Any], stated: UserChoices, over: Mapping[str, Any], above: str = ""
) -> dict[str, Any]:
    """A copy of ``config`` with the values of ``over`` except where the user has ``stated`` one."""
    made = copy.deepcopy(dict(config))
    for name, value in over.items():
        own, full = made.get(name), f"{above}{name}"
        if isinstance(value, Mapping) and isinstance(own, Mapping):
            made[name] = overlay_settings(own, stated, value, f"{full}.")
        elif not stated.is_user_value(full, own):
            made[name] = copy.deepcopy(value)
    return made


def _people(footage: Footage) -> str:
    if not footage.people_known:
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
