# SPDX-License-Identifier: Apache-2.0
"""Hard cases of recursive enhancement: numerics rows E01–E05, E08, E11, E13, E14. (E06, E07 belong to the warp, E09, E10 to the flow.)"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.enhance.enhancer import check_gain
from studiorecon.enhance.injection import Injection, confidence, history_weights, inject
from studiorecon.errors import Refusal
from studiorecon.images.blur import gaussian_blur
from studiorecon.images.warp import warp

PAPER = Injection(
    history=3,
    strength=0.3,
    decay=0.5,
    error="mean",
    error_threshold=30.0,
    blurred="confidence",
    blur_px=11,
    blur_sigma_px=2.0,
    form="residual",
    flow="direct",
    check=True,
)
SHAPE = (24, 32, 3)


def fixed_point(level: float, trust: float, injection: Injection, rounds: int = 80) -> float:
    """Brightness an identity enhancer ends at when a constant picture is fed through the recursion."""
    render = np.full(SHAPE, level, np.float32)
    history: list[np.ndarray] = []
    for _ in range(rounds):
        share = [np.full(SHAPE[:2], trust, np.float32)] * len(history)
        history = [inject(render, history, share, injection)[0], *history][: injection.history]
    return float(history[0].mean())


@pytest.mark.parametrize("trust", [1.0, 0.8, 0.5, 0.2, 0.0])
def test_a_constant_picture_stays_as_bright_as_it_is(trust: float) -> None:
    """E01. Literal form: darker by 0, 12.1, 27.0, 39.1, 45.9 levels of 153."""
    assert fixed_point(0.6, trust, PAPER) == pytest.approx(0.6, abs=0.5 / 255)


def test_the_literal_form_is_available_and_darkens_as_computed() -> None:
    """E01, U01: the fixed point of the printed formula is (1 - w) / (1 - w c)."""
    literal = replace(PAPER, form="literal")
    assert fixed_point(0.6, 0.5, literal) == pytest.approx(0.6 * (1 - 0.3) / (1 - 0.3 * 0.5), abs=1e-4)
    assert fixed_point(0.6, 1.0, literal) == pytest.approx(0.6, abs=1e-4)


def test_noise_is_steadied_without_a_drift_of_the_mean() -> None:
    """E02. Literal form: mean -36 levels; residual form 0.0 and flicker -15 %."""
    rng = np.random.default_rng(0)
    steady = replace(PAPER, error_threshold=60.0)
    renders = [np.clip(0.6 + rng.normal(0, 10 / 255, SHAPE), 0, 1).astype(np.float32) for _ in range(60)]
    history: list[np.ndarray] = []
    outputs = []
    for render in renders:
        trust = [confidence(render, past, np.ones(SHAPE[:2], bool), steady) for past in history]
        history = [inject(render, history, trust, steady)[0], *history][:3]
        outputs.append(history[0])
    assert abs(np.mean(outputs[10:]) - np.mean(renders[10:])) < 0.5 / 255
    flicker = np.abs(np.diff(outputs[10:], axis=0)).mean() / np.abs(np.diff(renders[10:], axis=0)).mean()
    assert flicker < 0.85


@pytest.mark.parametrize("existing", [0, 1, 2, 3])
def test_the_first_frames_are_weighted_over_existing_ones_only(existing: int) -> None:
    """E03. Missing history as black: 0.523, 0.574 for 0.6."""
    weights = history_weights(existing, 0.5)
    assert weights.sum() == pytest.approx(1.0 if existing else 0.0)
    render = np.full(SHAPE, 0.6, np.float32)
    blended, shares = inject(render, [render] * existing, [np.ones(SHAPE[:2], np.float32)] * existing, PAPER)
    np.testing.assert_allclose(blended, 0.6, atol=1e-6)
    np.testing.assert_allclose(shares, 0.3 if existing else 0.0, atol=1e-6)


def test_the_weights_of_a_full_history_are_the_papers() -> None:
    """U03: 4/7, 2/7, 1/7."""
    np.testing.assert_allclose(history_weights(3, 0.5), [4 / 7, 2 / 7, 1 / 7])


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_one_bad_pixel_of_history_is_no_confidence_and_spreads_nowhere(poison: float) -> None:
    """E04, E13. Blurred after the fact: 121 NaN pixels."""
    render = np.full(SHAPE, 0.5, np.float32)
    past = render.copy()
    past[10, 10] = poison
    trust = confidence(render, past, np.ones(SHAPE[:2], bool), PAPER)
    assert np.isfinite(trust).all()
    assert trust[10, 10] < 1
    assert trust[0, 0] == pytest.approx(1, abs=1e-6)
    invalid = np.ones(SHAPE[:2], bool)
    invalid[10, 10] = False
    blended, _ = inject(render, [past], [confidence(render, past, invalid, PAPER)], PAPER)
    np.testing.assert_allclose(blended, 0.5, atol=1e-6)


def test_the_blur_keeps_constants_up_to_the_corners() -> None:
    """E05. Zero padding: 0.60 at edges, 0.36 in corners."""
    np.testing.assert_allclose(gaussian_blur(np.ones((20, 30)), 11, 2.0), 1.0, atol=1e-6)
    with pytest.raises(ValueError, match="odd"):
        gaussian_blur(np.ones((20, 30)), 10, 2.0)


def test_validity_is_applied_after_the_blur() -> None:
    """E10, U05: confidence must not creep back into uncovered pixels."""
    render = np.full(SHAPE, 0.5, np.float32)
    valid = np.ones(SHAPE[:2], bool)
    valid[:, 10:12] = False
    trust = confidence(render, render, valid, PAPER)
    assert (trust[:, 10:12] == 0).all()
    assert (trust[:, 9] < 1).all()


def test_a_stored_picture_is_warped_once_and_keeps_its_contrast() -> None:
    """E08. Ten half-pixel bilinear warps in sequence: contrast 0.41; one warp by five pixels loses nothing."""
    columns = np.arange(64, dtype=np.float32)
    picture = np.repeat((0.5 + 0.4 * np.sin(columns * 1.2))[None], 32, axis=0).astype(np.float32)
    half = np.full((32, 64, 2), 0, np.float32)
    half[..., 0] = 0.5
    chained = picture
    for _ in range(10):
        chained, _ = warp(chained, half)
    direct, _ = warp(picture, 10 * half)
    inner = (slice(None), slice(0, 50))
    assert chained[inner].std() < 0.6 * picture.std()
    assert direct[inner].std() > 0.9 * picture.std()


@pytest.mark.parametrize(("difference_levels", "expected"), [(0, 1.0), (15, 0.5), (20, 1 / 3), (30, 0.0), (200, 0.0)])
def test_the_error_is_in_levels_of_255_as_a_mean_over_channels(difference_levels: int, expected: float) -> None:
    """E11. uint8 subtraction wraps to 246; floats with tau 30 give c ≥ 0.967 always."""
    render = np.full(SHAPE, 10 / 255, np.float32)
    trust = confidence(render, render + np.float32(difference_levels / 255), np.ones(SHAPE[:2], bool), PAPER)
    np.testing.assert_allclose(trust, expected, atol=1e-4)


@pytest.mark.parametrize(("gain", "strength"), [(1.05, 0.3), (1.2, 0.9), (0.9, 1.2), (float("nan"), 0.3)])
def test_an_enhancer_that_amplifies_is_refused_inside_the_recursion(gain: float, strength: float) -> None:
    """E14. Gain 1.05: +7.3 % at w 0.3, +91 % at 0.9, diverges at 1."""
    with pytest.raises(Refusal, match="flat field"):
        check_gain(gain, strength)


def test_an_enhancer_of_gain_one_passes() -> None:
    check_gain(1.0, 0.3)
    check_gain(1.3, 0.0)


def test_the_blur_is_opencvs_with_replicated_borders() -> None:
    picture = np.random.default_rng(0).random((30, 40)).astype(np.float32)
    padded = np.pad(picture, 5, mode="edge")
    expected = cv2.GaussianBlur(padded, (11, 11), 2.0)[5:-5, 5:-5]
    np.testing.assert_allclose(gaussian_blur(picture, 11, 2.0), expected, atol=1e-6)
