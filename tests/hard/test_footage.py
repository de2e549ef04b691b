# SPDX-License-Identifier: Apache-2.0
"""Hard cases of footage and masks, by their ids."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.capture.sync import lags, motion_energy
from studiorecon.images.regions import dilated


@pytest.mark.parametrize("case", ["still", "steady", "short", "one-sided"], ids=lambda c: f"V07-{c}")
def test_clocks_that_cannot_be_compared_are_undetermined(case: str) -> None:
    # Naive: the best lag of a static scene lies near half a frame, because interpolation averages noise.
    rng = np.random.default_rng(7)
    if case == "still":
        frames = np.clip(100 + rng.normal(0, 2, (30, 32, 48, 3)), 0, 255).astype(np.uint8)
        energies = [motion_energy(frames + np.uint8(k)) for k in range(3)]
    elif case == "steady":
        energies = [5 + rng.normal(0, 0.2, 60) for _ in range(3)]
    elif case == "short":
        energies = [np.abs(rng.normal(size=5)) for _ in range(3)]
    else:
        energies = [np.abs(rng.normal(size=60)), np.zeros(60), np.zeros(60)]
    found = lags(["a", "b", "c"], energies, 10, 0.6, 3.0)
    assert [lag.frames for lag in found] == [0, 0, 0]
    assert not any(lag.valid for lag in found)
    assert all(lag.reason for lag in found)


@pytest.mark.parametrize("size", [21], ids=["U24"])
def test_the_paper_s_dilation_is_a_kernel_of_21(size: int) -> None:
    # Naive: radius 21 (kernel 43) eats four times the floor around the feet.
    region = np.zeros((64, 64), bool)
    region[32, 32] = True
    assert dilated(region, size).sum() == 441
