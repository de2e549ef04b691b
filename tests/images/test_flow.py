# SPDX-License-Identifier: Apache-2.0
"""Optical flow: planted motion, direction, where it can be trusted, and that it does not depend on the machine."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.images import flow
from studiorecon.images.warp import warp

from tests.made.enhance_limits import textured


@pytest.mark.parametrize("shift", [(5, 0), (-3, 4)])
def test_flow_finds_a_planted_motion(shift: tuple[int, int]) -> None:
    first = textured((96, 128), 1)
    second = np.roll(first, shift[::-1], axis=(0, 1))
    with flow.one_thread():
        found = flow.dis_flow(first, second, "medium")
    assert np.abs(np.median(found[16:-16, 16:-16], axis=(0, 1)) - shift).max() < 0.1


def test_flow_is_the_same_with_one_core_and_with_many() -> None:
    first, second = textured((96, 128), 1), textured((96, 128), 2)
    before = cv2.getNumThreads()
    results = []
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        with flow.one_thread():
            results.append(flow.dis_flow(first, second, "medium"))
    cv2.setNumThreads(before)
    np.testing.assert_array_equal(*results)


def test_uncovered_background_is_inconsistent_and_the_rest_is_not() -> None:
    """A textured square moves by 10 pixels over a textured background (E10)."""
    background, square = textured((96, 160), 3), textured((40, 40), 4)
    previous, current = background.copy(), background.copy()
    previous[30:70, 50:90] = square
    current[30:70, 60:100] = square
    with flow.one_thread():
        backward = flow.dis_flow(current, previous, "medium")
        forward = flow.dis_flow(previous, current, "medium")
    trusted = flow.is_flow_consistent(backward, forward)
    assert trusted[34:66, 50:60].mean() < 0.1
    far = np.ones_like(trusted)
    far[20:80, 40:110] = False
    assert trusted[far].mean() > 0.99
    assert trusted[36:64, 68:96].mean() > 0.95


def test_exact_flow_marks_every_uncovered_pixel_and_nothing_else() -> None:
    """Numerics E10: a quarter of the uncovered strip looks right by its colours alone."""
    backward, forward = np.zeros((96, 160, 2), np.float32), np.zeros((96, 160, 2), np.float32)
    backward[30:70, 60:100, 0], forward[30:70, 50:90, 0] = -10, 10
    trusted = flow.is_flow_consistent(backward, forward)
    uncovered = np.zeros((96, 160), bool)
    uncovered[30:70, 50:60] = True
    np.testing.assert_array_equal(trusted, ~uncovered)


def test_flow_that_leaves_the_picture_or_is_not_finite_is_inconsistent() -> None:
    zero = np.zeros((40, 40, 2), np.float32)
    planted = zero.copy()
    planted[0, 0], planted[1, 1], planted[2, 2] = (np.nan, 0), (1e30, 0), (-30, 0)
    trusted = flow.is_flow_consistent(planted, zero)
    assert not trusted[[0, 1, 2], [0, 1, 2]].any()
    assert trusted.sum() == 1600 - 3
    unknown = zero.copy()
    unknown[5, 5] = np.inf
    assert not flow.is_flow_consistent(zero, unknown)[5, 5]


def test_pictures_that_cannot_be_compared_are_refused() -> None:
    with pytest.raises(UserError, match="one size"):
        flow.dis_flow(np.zeros((40, 40), np.uint8), np.zeros((40, 41), np.uint8), "medium")
    with pytest.raises(UserError, match="at least 24"):
        flow.dis_flow(np.zeros((40, 16), np.uint8), np.zeros((40, 16), np.uint8), "medium")


def test_e09_the_backward_flow_brings_the_previous_picture_onto_the_current_one() -> None:
    """Numerics E09: a forward flow used as a backward one is worse than no warp at all."""
    previous = textured((96, 128), 5, 3.0)
    current = np.roll(previous, (2, 6), axis=(0, 1))
    with flow.one_thread():
        backward, forward = flow.dis_flow(current, previous, "medium"), flow.dis_flow(previous, current, "medium")
    inner = (slice(20, -20), slice(20, -20))

    def error(field: np.ndarray) -> float:
        moved, _ = warp(previous.astype(np.float32), field)
        return float(np.abs(moved - current)[inner].mean())

    assert error(backward) < 1.0 < error(np.zeros_like(backward)) < error(forward)
