# SPDX-License-Identifier: Apache-2.0
"""Decisions turn where they say they do, and say when they cannot tell; intervals hold what they promise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.geometry.statistics import NOTHING, largest_estimate, median_estimate, share_estimate
from studiorecon.scene.decisions import read_decisions, write_decisions
from studiorecon.scene.effects import INJECTION, TRAINED


@pytest.mark.parametrize(
    ("interval", "verdict"), [((1.1, 1.3), "on"), ((0.7, 0.9), "off"), ((0.9, 1.2), "undetermined")]
)
@pytest.mark.parametrize("on_above", [True, False], ids=["above", "below"])
def test_a_verdict_needs_the_whole_interval(interval: tuple[float, float], verdict: str, on_above: bool) -> None:
    low, high = interval if on_above else (2 - interval[1], 2 - interval[0])
    effect = replace(INJECTION, on_above=on_above, threshold=1.0)
    made = effect.decide((low + high) / 2, (low, high), "why")
    assert made.verdict == verdict
    assert made.is_on == (verdict == "on")
    assert ("cheaper" in made.reason) == (verdict == "undetermined")


@pytest.mark.parametrize(("value", "interval"), [(None, None), (np.nan, (0.0, 1.0)), (2.0, (1.0, np.inf)), (2.0, None)])
def test_without_information_nothing_is_decided(value: float | None, interval: tuple[float, float] | None) -> None:
    made = INJECTION.decide(value, interval, "nobody moved")
    assert (made.verdict, made.value, made.interval) == ("undetermined", None, None)
    assert made.reason == "nobody moved"


def test_a_value_outside_of_its_interval_is_refused() -> None:
    with pytest.raises(ValueError, match="outside its interval"):
        INJECTION.decide(3.0, (0.0, 2.0), "why")


def test_decisions_survive_their_file(tmp_path: Path) -> None:
    made = [effect.undecided("report/audit.json") for effect in TRAINED]
    write_decisions(tmp_path / "decisions.json", made)
    assert list(read_decisions(tmp_path / "decisions.json").values()) == made


def test_intervals_cover_what_they_estimate() -> None:
    rng = np.random.default_rng(0)
    covered = {"share": 0, "median": 0, "largest": 0}
    rounds = 400
    for _ in range(rounds):
        low, high = share_estimate(int((rng.random(200) < 0.07).sum()), 200).interval
        covered["share"] += low <= 0.07 <= high
        low, high = median_estimate(rng.normal(3.0, 2.0, 150), 5).interval
        covered["median"] += low <= 3.0 <= high
        truth = np.array([0.02, 0.05, -0.2, 0.1])
        low, high = largest_estimate(truth + rng.normal(0, 0.02, 4), np.full(4, 0.02)).interval
        covered["largest"] += low <= 0.2 <= high
    assert covered["share"] >= 0.93 * rounds
    assert covered["median"] >= 0.93 * rounds
    assert covered["largest"] >= 0.98 * rounds


def test_nothing_measured_is_no_number() -> None:
    assert share_estimate(0, 0) is NOTHING
    assert median_estimate(np.array([np.nan, 1.0]), 5) is NOTHING
    assert largest_estimate([np.nan], [1.0]) is NOTHING
    assert largest_estimate([np.nan, 0.5], [1.0, 0.1]).which == 1
    assert share_estimate(0, 10).interval[0] == 0
    assert share_estimate(10, 10).interval[1] == 1
