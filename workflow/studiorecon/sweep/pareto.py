# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs, as arithmetic on points of seconds and quality: the front, steps along it, budgets, orders of
configurations."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np


def usable(seconds: float | None, quality: float | None) -> bool:
    """Whether a point counts: both measured and finite. Zero is a value like any other."""
    return seconds is not None and quality is not None and isfinite(seconds) and isfinite(quality)


def _usable_points(seconds: Sequence[float | None], quality: Sequence[float | None]) -> dict[int, tuple[float, float]]:
    return {
        i: (s, q) for i, (s, q) in enumerate(zip(seconds, quality)) if s is not None and q is not None and usable(s, q)
    }


def front(seconds: Sequence[float | None], quality: Sequence[float | None]) -> list[int]:
    """Indices of the points that no other point dominates, cheapest first; greater ``quality`` is better.

    A point is dominated when another costs no more and is no worse, and differs. Equal points do not dominate each
    other, so all of them stay. Points that are not usable are on no front.
    """
    known = _usable_points(seconds, quality)
    order = sorted(known, key=lambda i: (known[i][0], -known[i][1], i))
    found: list[int] = []
    for i in order:
        if not found or known[i][1] > known[found[-1]][1] or known[i] == known[found[-1]]:
            found.append(i)
    return found


def best_within(seconds: Sequence[float | None], quality: Sequence[float | None], budget_s: float) -> int | None:
    """Index of the best point that costs at most ``budget_s``, the cheaper of equals; None when none does."""
    known = _usable_points(seconds, quality)
    affordable = [i for i in front(seconds, quality) if known[i][0] <= budget_s]
    return max(affordable, key=lambda i: (known[i][1], -known[i][0], -i)) if affordable else None


def cheapest_reaching(seconds: Sequence[float | None], quality: Sequence[float | None], wanted: float) -> int | None:
    """Index of the cheapest point whose quality is at least ``wanted``; None when none is."""
    known = _usable_points(seconds, quality)
    return next((i for i in front(seconds, quality) if known[i][1] >= wanted), None)


def kendall_tau(first: Sequence[float], second: Sequence[float]) -> float | None:
    """Kendall's tau-b of two rankings of the same things: 1 = the same order, -1 = reversed; None below two things or
    without any order.

    M. G. Kendall, The treatment of ties in ranking problems, Biometrika 33 (1945).
    """
    a, b = np.asarray(first, float), np.asarray(second, float)
    upper = np.triu_indices(len(a), 1)
    signs_a, signs_b = np.sign(a[:, None] - a)[upper], np.sign(b[:, None] - b)[upper]
    norm = np.sqrt(float((signs_a != 0).sum()) * float((signs_b != 0).sum()))
    return float((signs_a * signs_b).sum() / norm) if norm > 0 else None
