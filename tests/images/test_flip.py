# SPDX-License-Identifier: Apache-2.0
"""ꟻLIP: 0 for the same picture, larger for what is seen more, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.images import flip as module
from studiorecon.images.flip import flip, is_available
from studiorecon.images.metrics import psnr
from studiorecon.report.metrics.measures import measure_picture

needs_package = pytest.mark.skipif(not is_available(), reason="flip-evaluator has no wheel here")


def photo(hw: tuple[int, int] = (90, 160)) -> np.ndarray:
    """A picture with flat parts and edges."""
    rng = np.random.default_rng(0)
    blocks = rng.integers(40, 215, (hw[0] // 10, hw[1] // 10, 3), dtype=np.uint8)
    return np.kron(blocks, np.ones((10, 10, 1), np.uint8))


@needs_package
def test_the_same_picture_is_0_and_black_on_white_nearly_1() -> None:
    assert flip(photo(), photo()) == 0
    black, white = np.zeros((64, 64, 3), np.uint8), np.full((64, 64, 3), 255, np.uint8)
    opposite = flip(black, white)
    assert opposite is not None
    # The authors' own value for white against black.
    assert opposite == pytest.approx(0.967, abs=0.002)


@needs_package
def test_what_the_eye_sees_more_counts_more_at_the_same_psnr() -> None:
    truth, rng = photo(), np.random.default_rng(1)
    sign = rng.choice([-12, 12], (*truth.shape[:2], 1))
    fine = np.clip(truth + sign, 0, 255).astype(np.uint8)
    # The same squares of errors in patches of 15 pixels, which the eye does not average away.
    coarse = np.kron(rng.choice([-12, 12], (6, 11, 1)), np.ones((15, 15, 1), int))[: truth.shape[0], : truth.shape[1]]
    patches = np.clip(truth + coarse, 0, 255).astype(np.uint8)
    ours, theirs = psnr(fine, truth), psnr(patches, truth)
    assert ours == pytest.approx(theirs, abs=0.1)
    seen, more = flip(fine, truth), flip(patches, truth)
    assert seen is not None
    assert more is not None
    assert more > 1.2 * seen


@needs_package
def test_floats_and_bytes_agree_and_repeat() -> None:
    truth = photo()
    shown = np.clip(truth.astype(int) + 9, 0, 255).astype(np.uint8)
    found = flip(shown, truth)
    assert found == flip(shown.astype(np.float32) / 255, truth) == flip(shown, truth)
    assert flip(shown[:10], truth[:10]) is None
    with pytest.raises(ValueError, match="truth"):
        flip(shown[:50], truth)


@needs_package
def test_a_picture_is_measured_only_where_requested() -> None:
    truth = photo()
    shown = np.clip(truth.astype(int) + 9, 0, 255).astype(np.uint8)
    assert measure_picture(shown, truth, {})["flip"] is None
    assert measure_picture(shown, truth, {}, flipped=True)["flip"] == flip(shown, truth)


def test_without_the_package_there_is_no_number_and_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert not module.is_available()
    with pytest.raises(ImportError):
        flip(photo(), photo())
