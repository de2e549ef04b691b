# SPDX-License-Identifier: Apache-2.0
"""A hard case that is drawn: an input that gets harder, and the errors of two formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """One family's plot.

    Attributes:
        name: of its picture.
        ids: rows of docs/hard-cases.md that it stands for.
        title, breaks, ours: what is computed, what the textbook does, what we do.
        along: what x is, with its unit; ``xs``: its values, hardest last.
        error: what y is, with its unit; ``textbook`` and ``kept``: the errors of both formulas at x.
        bar: the largest error of ours that is right.
        log_x: whether x is drawn in powers of ten.
    """

    name: str
    ids: str
    title: str
    breaks: str
    ours: str
    along: str
    xs: Sequence[float]
    error: str
    textbook: Callable[[float], float]
    kept: Callable[[float], float]
    bar: float
    log_x: bool = True
