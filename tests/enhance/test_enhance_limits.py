# SPDX-License-Identifier: Apache-2.0
"""Hard cases E01 to E14 of recursive enhancement, warps and flow, by their ids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.images.blur import gaussian_blur
from studiorecon.images.flow import dis_flow, is_flow_consistent, one_thread
from studiorecon.images.warp import warp
from studiorecon.models.adapters import raft
from studiorecon.recursive.injection import Injection, confidence, history_weights, inject, whole_levels
from studiorecon.recursive.sequence import check_gain

from tests.made.enhance_limits import PAPER, textured

SHAPE = (24, 32, 3)


def fixed_point(level: float, trust: float, injection: Injection, rounds: int = 80) -> float:
    """Brightness an identity enhancer ends at when a constant picture is fed through the recursion."""
    render = np.full(SHAPE, level, np.float32)
    history: list[np.ndarray] = []
    for _ in range(rounds):
        share = [np.full(SHAPE[:2], trust, np.float32)] * len(history)
        history = [inject(render, history, share, injection)[0], *history][: injection.history]
    return float(history[0].mean())


@pytest.mark.parametrize("trust", [1.0, 0.8, 0.5, 0.2, 0.0], ids=lambda c: f"E01-{c}")
def test_a_constant_picture_stays_as_bright_as_it_is(trust: float) -> None:
    """E01. Literal form: darker by 0, 12.1, 27.0, 39.1, 45.9 levels of 153."""
    assert fixed_point(0.6, trust, PAPER) == pytest.approx(0.6, abs=1e-5)


@pytest.mark.parametrize(
    ("trust", "darker_levels"),
    [(1.0, 0.0), (0.8, 12.1), (0.5, 27.0), (0.2, 39.1), (0.0, 45.9)],
    ids=lambda v: f"E01-literal-{v}",
)
def test_the_literal_form_is_available_and_darkens_as_computed(trust: float, darker_levels: float) -> None:
    """U01: the fixed point of the printed formula is (1 - w) / (1 - w c)."""
    found = fixed_point(0.6, trust, replace(PAPER, form="literal"))
    assert found == pytest.approx(0.6 * (1 - 0.3) / (1 - 0.3 * trust), abs=1e-5)
    assert 153 - 255 * found == pytest.approx(darker_levels, abs=0.06)


@pytest.mark.parametrize("existing", [0, 1, 2, 3], ids=lambda k: f"E03-{k}")
def test_the_first_frames_are_weighted_over_existing_ones_only(existing: int) -> None:
    """E03. Missing history as black: 0.523, 0.574 for 0.6."""
    weights = history_weights(existing, 0.5)
    assert weights.sum() == pytest.approx(1.0 if existing else 0.0)
    render = np.full(SHAPE, 0.6, np.float32)
    blended, shares = inject(render, [render] * existing, [np.ones(SHAPE[:2], np.float32)] * existing, PAPER)
    np.testing.assert_allclose(blended, 0.6, atol=1e-6)
    np.testing.assert_allclose(shares, 0.3 if existing else 0.0, atol=1e-6)


def test_e02_eight_bit_feedback_forgets_what_has_moved_on() -> None:
    # A bright patch of ten frames on a constant wall. Rounded to nearest, strength 0.9 keeps five levels of it for
    # ever.
    steady = replace(PAPER, strength=0.9, error_threshold=300.0, history=1)
    wall = np.full(SHAPE, 100 / 255, np.float32)
    left = {}
    for whole in (False, True):
        output = None
        for render in [wall + np.float32(40 / 255)] * 10 + [wall] * 60:
            past = [] if output is None else [output]
            trust = [np.ones(SHAPE[:2], np.float32)] * len(past)
            blended, _ = inject(render, past, trust, replace(steady, whole_levels=whole))
            output = np.rint(255 * blended).astype(np.float32) / 255
        left[whole] = float(np.abs(255 * (output - wall)).max())
    assert left[True] < 1e-3
    assert 3 < left[False] < 6


def test_e02_a_change_of_whole_levels_is_injected_whole() -> None:
    levels = np.arange(-40, 41, dtype=np.float32)
    render = np.full((1, 81, 3), 0.5, np.float32)
    changes = whole_levels(render + levels[None, :, None] / np.float32(255) - render)
    np.testing.assert_allclose(255 * changes[0, :, 0], levels, atol=1e-4)
    np.testing.assert_allclose(
        255 * whole_levels((levels + np.sign(levels) * np.float32(0.9)) / np.float32(255)), levels, atol=1e-4
    )


def test_the_weights_of_a_full_history_are_the_papers() -> None:
    """U03: 4/7, 2/7, 1/7."""
    np.testing.assert_allclose(history_weights(3, 0.5), [4 / 7, 2 / 7, 1 / 7])


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf], ids=lambda v: f"E04-E13-{v}")
def test_one_bad_pixel_of_history_is_no_confidence_and_spreads_nowhere(poison: float) -> None:
    # max(0, nan) is 0 but max(nan, 0) is nan; blurred after the fact: 121 pixels.
    render = np.full(SHAPE, 0.5, np.float32)
    past = render.copy()
    past[10, 10] = poison
    trust = confidence(render, past, np.ones(SHAPE[:2], bool), PAPER)
    assert np.isfinite(trust).all()
    assert trust[10, 10] == 0
    assert trust[10, 11] > 0.9
    assert trust[0, 0] == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(inject(render, [past], [trust], PAPER)[0], 0.5, atol=1e-6)


def test_e05_the_blur_keeps_constants_up_to_the_corners() -> None:
    # Zero padding: 0.60 at edges, 0.36 in corners.
    np.testing.assert_allclose(gaussian_blur(np.ones((20, 30)), 11, 2.0), 1.0, atol=1e-6)
    with pytest.raises(ValueError, match="odd"):
        gaussian_blur(np.ones((20, 30)), 10, 2.0)


def test_e06_what_comes_from_outside_the_picture_has_no_say() -> None:
    # Zero padding: black columns enter the mean.
    render = np.full(SHAPE, 0.5, np.float32)
    flow = np.zeros((*SHAPE[:2], 2), np.float32)
    flow[..., 0] = 6.0
    warped, inside = warp(render, flow)
    trust = confidence(render, warped, inside, PAPER)
    assert (trust[:, -6:] == 0).all()
    assert (trust[:, : -6 - 6] > 0.99).all()
    np.testing.assert_allclose(inject(render, [warped], [trust], PAPER)[0], 0.5, atol=1e-6)


@pytest.mark.parametrize("way", ["valid-after-blur", "planted", "searched"], ids=lambda w: f"E10-{w}")
def test_uncovered_background_gets_no_confidence(way: str) -> None:
    # By colours alone a quarter of the uncovered strip has c > 0.5, and 0.405 on average after the blur.
    if way == "valid-after-blur":
        render, valid = np.full(SHAPE, 0.5, np.float32), np.ones(SHAPE[:2], bool)
        valid[:, 10:12] = False
        trust = confidence(render, render, valid, PAPER)
        assert (trust[:, 10:12] == 0).all()
        assert (trust[:, 9] < 1).all()
        return
    background, square = textured((96, 160), 3), textured((40, 40), 4)
    previous, current = background.copy(), background.copy()
    previous[30:70, 50:90], current[30:70, 60:100] = square, square
    uncovered, far = np.zeros((96, 160), bool), np.ones((96, 160), bool)
    uncovered[30:70, 50:60], far[20:80, 40:110] = True, False
    if way == "planted":
        backward, forward = np.zeros((96, 160, 2), np.float32), np.zeros((96, 160, 2), np.float32)
        backward[30:70, 60:100, 0], forward[30:70, 50:90, 0] = -10, 10
        trusted = is_flow_consistent(backward, forward)
        np.testing.assert_array_equal(trusted, ~uncovered)
    else:
        with one_thread():
            backward = dis_flow(current, previous, "medium")
            trusted = is_flow_consistent(backward, dis_flow(previous, current, "medium"))
        assert trusted[36:64, 50:58].mean() < 0.05
        assert trusted[far].mean() > 0.99
    now, before = (np.repeat(p[..., None] / np.float32(255), 3, axis=2) for p in (current, previous))
    warped, inside = warp(before, backward)
    trust = confidence(now, warped, inside & trusted, PAPER)
    naive = confidence(now, warped, inside, PAPER)
    strip = uncovered if way == "planted" else np.s_[36:64, 50:58]
    assert trust[strip].mean() < 0.05 < 0.1 < naive[strip].mean()
    assert trust[far].mean() > 0.97


def test_e08_a_stored_picture_is_warped_once_and_keeps_its_contrast() -> None:
    # Ten half-pixel bilinear warps in sequence: contrast 0.41; one warp by five pixels loses nothing.
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


@pytest.mark.parametrize(
    ("difference_levels", "expected"),
    [(0, 1.0), (15, 0.5), (20, 1 / 3), (30, 0.0), (200, 0.0)],
    ids=lambda v: f"E11-{v:.2f}",
)
def test_the_error_is_in_levels_of_255_as_a_mean_over_channels(difference_levels: int, expected: float) -> None:
    # uint8 subtraction wraps to 246; floats with tau 30 give c ≥ 0.967 always.
    render = np.full(SHAPE, 10 / 255, np.float32)
    trust = confidence(render, render + np.float32(difference_levels / 255), np.ones(SHAPE[:2], bool), PAPER)
    np.testing.assert_allclose(trust, expected, atol=1e-4)


@pytest.mark.parametrize(
    "hw", [(120, 160), (64, 64), (127, 300), (1, 5), (129, 131), (704, 1280)], ids=lambda v: f"E12-{v[1]}x{v[0]}"
)
def test_pictures_fit_the_flow_network_and_the_flow_comes_back(hw: tuple[int, int]) -> None:
    # 120 and 64 px: a pyramid level of one value, a division by zero, NaN everywhere.
    rng = np.random.default_rng(0)
    first = rng.integers(0, 255, (*hw, 3), dtype=np.uint8)
    pair, fitted = raft.preprocess(first, first)
    assert pair.shape[:2] == (2, 3)
    assert min(pair.shape[2:]) >= 128
    assert all(side % 8 == 0 for side in pair.shape[2:])
    assert np.abs(pair).max() <= 1
    # The network would answer at the pair's size: a flow whose every pixel says where it stands comes back at the
    # picture's size.
    top, left = fitted.before
    rows, columns = np.mgrid[: pair.shape[2], : pair.shape[3]] + 0.5
    back = raft.postprocess(np.stack([columns - left, rows - top]).astype(np.float32), fitted)
    assert back.shape == (*hw, 2)
    own_rows, own_columns = np.mgrid[: hw[0], : hw[1]] + 0.5
    np.testing.assert_allclose(back, np.stack([own_columns, own_rows], axis=-1), rtol=1e-6, atol=1e-5)
    seen = (pair[0].transpose(1, 2, 0)[top :: fitted.enlarged, left :: fitted.enlarged] + 1) * 127.5
    np.testing.assert_allclose(seen[: hw[0], : hw[1]], first, atol=1e-3)


@pytest.mark.parametrize("wrong", ["size", "kind", "grey"], ids=lambda w: f"E12-{w}")
def test_pictures_that_the_flow_network_cannot_compare_are_refused(wrong: str) -> None:
    first = np.zeros((130, 140, 3), np.uint8)
    second = {"size": first[:-1], "kind": first.astype(np.float32), "grey": first[..., 0]}[wrong]
    with pytest.raises(ValueError, match="first and second"):
        raft.preprocess(first, second)
    with pytest.raises(ValueError, match="flow has shape"):
        raft.postprocess(np.zeros((2, 100, 100), np.float32), raft.preprocess(first, first)[1])


@pytest.mark.parametrize(("gain", "strength"), [(1.2, 0.9), (0.9, 1.2), (float("nan"), 0.3)], ids=lambda v: f"E14-{v}")
def test_an_enhancer_whose_feedback_diverges_is_refused(gain: float, strength: float) -> None:
    with pytest.raises(UserError, match="multiplies a change of brightness"):
        check_gain(gain, strength)


@pytest.mark.parametrize(("gain", "strength"), [(1.05, 0.3), (1.05, 0.9), (1.0, 0.3), (1.3, 0.0), (0.7, 0.5)])
def test_e14_brightness_that_feedback_adds_is_in_the_warning(
    gain: float, strength: float, capsys: pytest.CaptureFixture
) -> None:
    check_gain(gain, strength)
    brightness = 1.0
    for _ in range(400):
        brightness = gain * (1 + strength * (brightness - 1))
    warning = "".join(capsys.readouterr())
    assert (f"{brightness - gain:.1%} brighter" in warning) == (brightness - gain > 2 / 255)
