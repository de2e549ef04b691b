# SPDX-License-Identifier: Apache-2.0
"""Settings become typed dataclasses, and mistakes become sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import pytest
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError


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


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("count", "2", "whole number"),
        ("count", True, "whole number"),
        ("count", 2.5, "whole number"),
        ("rate", "1e-4", "write 1.0e-4"),
        ("on", "yes", "true or false"),
        ("inner", 3, "section"),
        ("inner", {}, "depth.inner.sigma is missing"),
        ("pair", [1], "2 entries"),
        ("mode", "c", "one of a, b"),
        ("limit", "high", "a number"),
        ("several", 3, "a list"),
    ],
)
def test_mistakes_are_sentences(key: str, value: Any, words: str) -> None:
    with pytest.raises(UserError, match=words) as caught:
        load(Outer, {**GOOD, key: value}, "depth")
    assert f"depth.{key}" in str(caught.value)


def test_a_missing_key_names_itself() -> None:
    with pytest.raises(UserError, match=r"depth\.count is missing"):
        load(Outer, {k: v for k, v in GOOD.items() if k != "count"}, "depth")
