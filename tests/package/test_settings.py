# SPDX-License-Identifier: Apache-2.0
"""Settings become typed dataclasses, and mistakes become sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.settings import load


@dataclass(frozen=True)
class Inner:
    sigma: float


@dataclass(frozen=True)
class Outer:
    count: int
    rate: float
    name: str
    on: bool
    inner: Inner
    pair: tuple[float, float]
    several: tuple[int, ...]
    mode: Literal["a", "b"]
    limit: float | None


GOOD = {
    "count": 2,
    "rate": 1,
    "name": "x",
    "on": True,
    "inner": {"sigma": 0.5},
    "pair": [1, 2.5],
    "several": [1, 2, 3],
    "mode": "a",
    "limit": None,
}


def test_values_are_typed() -> None:
    settings = load(Outer, {**GOOD, "ignored": 1}, "depth")
    assert settings == Outer(2, 1.0, "x", True, Inner(0.5), (1.0, 2.5), (1, 2, 3), "a", None)
    assert isinstance(settings.rate, float)
