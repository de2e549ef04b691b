# SPDX-License-Identifier: Apache-2.0
"""What moves in one camera's pictures: things, but no shadow and no pixel that always changes."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.survey.scene_change import moving_regions

FRAMES, HEIGHT, WIDTH = 12, 68, 120


def disc_that_travels(level: float, colour: float) -> np.ndarray:
    """(T, H, W, 3) log ratio of a disc of 6 px that moves 6 px a picture; red differs by ``colour`` from its level."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    there = np.stack([(rows - 34) ** 2 + (columns - 20 - 6 * t) ** 2 < 36 for t in range(FRAMES)])
    return (there[..., None] * np.array([level + colour, level - colour / 2, level - colour / 2])).astype(np.float32)


@pytest.mark.parametrize(
    ("level", "colour", "wobble", "moves"),
    [
        (0.3, 0.0, 0.0, True),
        (-0.3, 0.2, 0.0, True),
        (-0.3, 0.0, 0.0, False),
        (-0.3, 0.1, 0.0, False),
        (0.3, 0.0, 0.1, False),
    ],
    ids=["brighter", "of another colour", "a shadow", "a tinted shadow", "where everything wobbles"],
)
def test_things_move_but_no_shadows_and_no_wobble(level: float, colour: float, wobble: float, moves: bool) -> None:
    ratio = disc_that_travels(level, colour)
    ratio += wobble * np.random.default_rng(0).choice([-1, 1], (FRAMES, HEIGHT, WIDTH, 1)).astype(np.float32)
    free, usual = np.ones((FRAMES, HEIGHT, WIDTH), bool), np.full((HEIGHT, WIDTH), 120.0)
    assert bool(moving_regions(ratio, free, usual, 1.0, [slice(0, FRAMES)])) == moves
