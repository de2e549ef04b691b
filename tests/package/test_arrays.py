# SPDX-License-Identifier: Apache-2.0
"""The border check that functions on arrays share."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.arrays import require


def test_letters_stand_for_one_size_in_all_arguments() -> None:
    sizes = require("pixels", np.zeros((4, 7, 2)), ("V", "N", 2))
    assert sizes == {"V": 4, "N": 7}
    assert require("weights", np.zeros((4, 7)), ("V", "N"), sizes) == sizes
    with pytest.raises(ValueError, match=r"weights has shape \(4, 6\), expected \(V, N\) with V = 4, N = 7"):
        require("weights", np.zeros((4, 6)), ("V", "N"), sizes)


@pytest.mark.parametrize(
    ("actual", "shape"),
    [
        ((3, 4), ("V", "N", 2)),
        ((4, 3), (..., 2)),
        ((3, 4), ("N", "N")),
        ((), ("N",)),
        ((3,), (..., 3, 3)),
        ((2, 3, 4), ("N", 3)),
    ],
)
def test_other_shapes_are_refused_by_name(actual: tuple, shape: tuple) -> None:
    with pytest.raises(ValueError, match="points_m has shape"):
        require("points_m", np.zeros(actual), shape)


@pytest.mark.parametrize(
    ("actual", "shape", "sizes"),
    [
        ((5, 6, 3), (..., 3), {}),
        ((3,), (..., 3), {}),
        ((), (), {}),
        ((0, 3), ("N", 3), {"N": 0}),
        ((2, 9, 2), ("A", ..., "A"), {"A": 2}),
    ],
)
def test_fitting_shapes_pass(actual: tuple, shape: tuple, sizes: dict) -> None:
    assert require("x", np.zeros(actual), shape) == sizes


def test_finite_says_how_many_and_where() -> None:
    values = np.zeros((4, 3))
    require("x", values, ("N", 3), finite=True)
    values[1, 2], values[3, 0] = np.nan, np.inf
    require("x", values, ("N", 3))
    with pytest.raises(
        ValueError, match=r"x of shape \(4, 3\) has 2 values that are not finite, the first at \(1, 2\)"
    ):
        require("x", values, ("N", 3), finite=True)
