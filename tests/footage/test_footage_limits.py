# SPDX-License-Identifier: Apache-2.0
"""Hard cases of footage and masks, by their ids."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.clocks.motion_clock import compare, motion_energy
from studiorecon.images.regions import dilate


@pytest.mark.parametrize("case", ["still", "steady", "short", "one-sided"], ids=lambda c: f"V07-{c}")
def test_clocks_that_cannot_be_compared_are_undetermined(case: str) -> None:
    # Naive: the best lag of a static scene lies near half a frame, because interpolation averages noise.
    rng = np.random.default_rng(7)
    if case == "still":
        frames = np.clip(100 + rng.normal(0, 1, (3, 60, 32, 48)), 0, 255).astype(np.uint8)
        energies = [motion_energy(f) for f in frames]
    elif case == "steady":
        energies = [5 + rng.normal(0, 0.2, 60) for _ in range(3)]
    elif case == "short":
        energies = [np.abs(rng.normal(size=5)) for _ in range(3)]
    else:
        energies = [np.abs(rng.normal(size=60)), np.zeros(60), np.zeros(60)]
    for a, b in ((0, 1), (1, 2)):
        found = compare(energies[a], energies[b], 30.0)
        assert (found.rows, found.valid) == (0, False)
        assert found.reason


@pytest.mark.parametrize("size", [21], ids=["U24"])
def test_the_paper_s_dilation_is_a_kernel_of_21(size: int) -> None:
    # Naive: radius 21 (kernel 43) eats four times the floor around the feet.
    region = np.zeros((64, 64), bool)
    region[32, 32] = True
    assert dilate(region, size).sum() == 441
