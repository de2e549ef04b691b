# SPDX-License-Identifier: Apache-2.0
"""Checks of array arguments, with messages that name the argument; evenly spread indices; means of what is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import EllipsisType
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Integer, Shaped

Extent = int | str | EllipsisType


def require(
    name: str,
    array: Shaped[np.ndarray, " ..."],
    shape: tuple[Extent, ...],
    known: Mapping[str, int] | None = None,
    *,
    finite: bool = False,
) -> dict[str, int]:
    """The sizes of the letters of ``shape`` in ``array``, together with those already ``known``.

    ``shape`` lists numbers, letters and at most one ``...`` for any number of axes; a letter means one size at every
    place, so ``sizes = require("pixels", pixels, ("V", "N", 2))`` and then ``require("weights", weights, ("V", "N"),
    sizes)`` ties two arguments together. Raises ValueError that names the argument and its shape, or with ``finite``
    how many of its values are not finite and where the first one is. Takes a microsecond; ``finite`` reads the array
    once.
    """
    actual = np.shape(array)
    sizes = dict(known or {})
    if not _fits(actual, shape, sizes):
        known_sizes = ", ".join(f"{letter} = {size}" for letter, size in (known or {}).items() if letter in shape)
        raise ValueError(
            f"{name} has shape {actual}, expected {_written(shape)}" + (f" with {known_sizes}" if known_sizes else "")
        )
    if finite and not (good := np.isfinite(array)).all():
        first = tuple(int(i) for i in np.argwhere(~good)[0])
        raise ValueError(
            f"{name} of shape {actual} has {int((~good).sum())} values that are not finite, the first at {first}"
        )
    return sizes


def spread_indices(count: int, wanted: int, *, below: bool = False) -> Integer[np.ndarray, " N"]:
    """At most ``wanted`` indices of ``count`` items, ascending, evenly spread from the first to the last.

    Each is the index nearest to its exact position, with ``below`` the one before it.
    """
    places = np.linspace(0, count - 1, min(wanted, count))
    return np.unique((places if below else places.round()).astype(int))


def _fits(actual: tuple[int, ...], shape: tuple[Extent, ...], sizes: dict[str, int]) -> bool:
    if ... in shape:
        at = shape.index(...)
        behind = len(shape) - at - 1
        if len(actual) < at + behind:
            return False
        actual, shape = actual[:at] + actual[len(actual) - behind :], shape[:at] + shape[at + 1 :]
    if len(actual) != len(shape):
        return False
    return all(
        size == (extent if isinstance(extent, int) else sizes.setdefault(str(extent), size))
        for size, extent in zip(actual, shape)
    )


def _written(shape: tuple[Extent, ...]) -> str:
    return (
        "("
        + ", ".join("..." if extent is ... else str(extent) for extent in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )


def mean_of_measured(values: Iterable[float | None]) -> float | None:
    """Mean of the measured values: None and values that are not finite are left out; None when none remains (V06)."""
    used = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(used)) if used else None
