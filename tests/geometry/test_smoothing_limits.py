# SPDX-License-Identifier: Apache-2.0
"""Rows F of the table of hard cases: smoothing of turns and paths over time. The naive outcomes are in the comments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.geometry import rotations, smoothing
from studiorecon.geometry.smoothing import Smoothing

Z = np.array([0.0, 0.0, 1.0])
PAPER = (0.5, 1.0)
# The time in which an exponential pass that takes half of the new sample at 30 frames per second forgets to 1/e.
HALF_S = 1 / (30 * np.log(2))


def about(axis: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    return rotations.exp(np.deg2rad(np.asarray(degrees, dtype=float))[:, None] * axis)


def apart_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.rad2deg(rotations.angle(a, b))


def test_f01_angles_alternating_about_half_a_turn_stay_there() -> None:
    # Axis-angle components of ±179° average to 39..77°; the truth is 180°.
    turns = about(Z, np.where(np.arange(40) % 2, 179.0, -179.0))
    smooth = smoothing.smooth_rotations(turns, *PAPER)
    assert apart_deg(smooth, about(Z, np.full(40, 180.0))).max() < 1
    literal = Smoothing(HALF_S, 1 / 30, "axis_angles").smooth_body(
        np.tile(turns[:, None], (1, 24, 1, 1)), np.zeros((40, 3)), 30.0
    )
    assert apart_deg(literal[0][:, 3], about(Z, np.full(40, 180.0))).min() > 90  # the naive form, selectable (U42)


@pytest.mark.parametrize("axis", [Z, np.array([0.6, 0.0, 0.8])], ids=["F02-z", "F02-oblique"])
def test_a_slow_turn_through_half_a_turn_is_kept(axis: np.ndarray) -> None:
    # Components: 132° off; canonical quaternions: 6.0°, their norm falls to 0.50.
    turns = about(axis, np.linspace(150, 210, 121))
    wrong = apart_deg(smoothing.smooth_rotations(turns, *PAPER), turns)
    reach = len(smoothing.smoothing_kernel(*PAPER)) // 2
    assert np.deg2rad(wrong[reach:-reach]).max() < 1e-9
    assert wrong.max() < 2


@pytest.mark.parametrize("frames", [3, 5, 50], ids="F03-{}-frames".format)
def test_constants_are_exact_up_to_the_ends(frames: int) -> None:
    # `np.convolve(..., "same")` and constant padding leave 0.70 of the value at the ends.
    np.testing.assert_allclose(smoothing.smooth_vectors(np.full((frames, 3), 2.5), *PAPER), 2.5, rtol=1e-14)
    turns = about(Z, np.full(frames, 170.0))
    np.testing.assert_allclose(smoothing.smooth_rotations(turns, *PAPER), turns, atol=1e-14)


def test_a_ramp_is_pulled_only_at_its_ends() -> None:
    """F03: inside a ramp passes exactly; the first frame is pulled by under 1.5 frames, whatever the slope."""
    ramp = np.arange(60.0)
    smooth = smoothing.smooth_vectors(ramp, *PAPER)
    reach = len(smoothing.smoothing_kernel(*PAPER)) // 2
    np.testing.assert_allclose(smooth[reach:-reach], ramp[reach:-reach], atol=1e-10)
    assert abs(smooth[0]) < 1.5
    assert (np.diff(smooth) > 0).all()


@pytest.mark.parametrize("frames", [0, 1, 2, 3], ids="F04-{}".format)
def test_clips_too_short_to_smooth_pass_through(frames: int) -> None:
    # Two frames: motion shrinks to 29 %; `filtfilt` raises at three.
    values, turns = np.arange(3.0 * frames).reshape(frames, 3), about(Z, np.arange(float(frames)) * 10)
    smooth, smooth_turns = smoothing.smooth_vectors(values, *PAPER), smoothing.smooth_rotations(turns, *PAPER)
    assert smooth.shape == values.shape
    assert smooth_turns.shape == (frames, 3, 3)
    if frames < 3:
        np.testing.assert_array_equal(smooth, values)
        np.testing.assert_array_equal(smooth_turns, turns)
    else:
        assert np.isfinite(smooth).all()
        np.testing.assert_allclose(smooth[1], values[1], atol=1e-12)  # symmetric about the middle


@pytest.mark.parametrize("gap", [[4], [4, 5, 6], [0, 1], [9]], ids="F05-{}".format)
def test_a_gap_is_filled_and_reaches_nobody_else(gap: list[int]) -> None:
    # One NaN of ten frames: all ten after the exponential passes, nine after the Gaussian.
    path, turns = np.linspace(0, 9, 10)[:, None] * [1.0, 0.5, 0], about(Z, np.linspace(0, 90, 10))
    valid = np.ones(10, dtype=bool)
    valid[gap] = False
    path[gap], turns[gap] = 1e6, rotations.exp([3.0, 0, 0])  # whatever stands in a gap is not looked at
    filled, turned = smoothing.fill_vectors(path, valid), smoothing.fill_rotations(turns, valid)
    np.testing.assert_array_equal(filled[valid], path[valid])
    np.testing.assert_array_equal(turned[valid], turns[valid])
    if gap[0] > 0 and gap[-1] < 9:
        np.testing.assert_allclose(filled[gap, 0], gap, atol=1e-12)
        assert apart_deg(turned[gap], about(Z, 10.0 * np.array(gap))).max() < 1e-9
    else:
        np.testing.assert_array_equal(
            filled[gap], np.tile(path[gap[-1] + 1 if gap[0] == 0 else gap[0] - 1], (len(gap), 1))
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf], ids=["F05-nan", "F05-inf"])
def test_an_unfilled_gap_is_refused(bad: float) -> None:
    values = np.zeros((10, 3))
    values[4, 1] = bad
    with pytest.raises(
        ValueError, match=r"values of shape \(10, 3\) has 1 values that are not finite, the first at \(4, 1\)"
    ):
        smoothing.smooth_vectors(values, *PAPER)
    with pytest.raises(ValueError, match="no valid frame"):
        smoothing.fill_vectors(np.zeros((10, 3)), np.zeros(10, dtype=bool))
    turns = about(Z, np.zeros(10))
    turns[4, 1, 1] = bad
    with pytest.raises(ValueError, match="not finite"):
        smoothing.smooth_rotations(turns, *PAPER)


@pytest.mark.parametrize(("sigma", "kept"), [(0.0, 0.147), (1.0, 0.046)], ids=["F06-cascade", "F06-cascade-gauss"])
def test_the_passes_are_a_cascade(sigma: float, kept: float) -> None:
    """Acceleration that white noise keeps; averaged passes would keep 2.4 times as much without the Gaussian."""
    weights = smoothing.smoothing_kernel(0.5, sigma)
    second = np.array([1.0, -2.0, 1.0])
    assert np.linalg.norm(np.convolve(weights, second)) / np.linalg.norm(second) == pytest.approx(kept, abs=0.002)
    # Sample by sample, as the recursion is written.
    values = np.random.default_rng(3).normal(size=400)
    truth = recursion(recursion(values, 0.5)[::-1], 0.5)[::-1]
    found = smoothing.smooth_vectors(values, 0.5, 0.0)
    np.testing.assert_allclose(found[60:-60], truth[60:-60], atol=1e-3)


def recursion(values: np.ndarray, alpha: float) -> np.ndarray:
    """α weighs the new sample (U40)."""
    out = values.copy()
    for t in range(1, len(out)):
        out[t] = alpha * out[t] + (1 - alpha) * out[t - 1]
    return out


@pytest.mark.parametrize(("period", "kept"), [(8, 0.34), (15, 0.68), (30, 0.90)], ids=["F07-8", "F07-15", "F07-30"])
def test_the_share_of_a_motion_that_is_kept_is_documented(period: int, kept: float) -> None:
    assert smoothing.remaining_motion(*PAPER, period) == pytest.approx(kept, abs=0.01)
    swing = 20 * np.cos(2 * np.pi * np.arange(241) / period)
    found = rotations.log(smoothing.smooth_rotations(about(Z, swing), *PAPER))[:, 2]
    assert np.rad2deg(found[120 - 120 % period]) == pytest.approx(20 * kept, abs=0.3)


def test_f08_the_first_frame_has_no_more_say_than_others() -> None:
    # Averaged passes that start from the first sample: weight 0.75 on itself, influence 1.25 in all.
    influence = smoothing.smooth_vectors(np.eye(60), *PAPER).sum(0)
    assert influence.max() < 1.12
    assert influence[0] < 1.05
    np.testing.assert_allclose(influence.sum(), 60)


@pytest.mark.parametrize("step_deg", [5, 30, 90], ids="F09-{}".format)
def test_windows_are_averaged_on_the_sphere_of_rotations(step_deg: float) -> None:
    # Mean of rotation vectors, joint at 120°, steps of 30°: up to 2.7° off.
    base = Rotation.from_rotvec(np.deg2rad(120) * np.array([0.0, 0.6, 0.8]))
    steps = Rotation.from_rotvec(
        np.deg2rad(step_deg) * np.random.default_rng(0).choice([-0.5, 0, 0.5], (9, 1)) * np.array([1.0, 0, 0])
    )
    turns = (base * steps).as_matrix()
    # All turns lie on one circle about the joint's own x axis: the mean there is the mean of angles.
    angles = steps.as_rotvec()[:, :1]
    truth = (base * Rotation.from_rotvec(smoothing.smooth_vectors(angles, *PAPER) * [1.0, 0, 0])).as_matrix()
    found = smoothing.smooth_rotations(turns, *PAPER)
    assert rotations.angle(found, truth).max() < 1e-9
    assert np.abs(np.swapaxes(found, -1, -2) @ found - np.eye(3)).max() < 1e-14


def test_what_is_smoothed_follows_the_settings() -> None:
    """U42: the root with the pose; U41: the deviation is a time."""
    rng = np.random.default_rng(4)
    local, trans = rotations.exp(rng.normal(0, 0.3, (30, 24, 3))), rng.normal(size=(30, 3))
    whole = Smoothing(HALF_S, 1 / 30, "rotations").smooth_body(local, trans, 30.0)
    np.testing.assert_allclose(whole[1], smoothing.smooth_vectors(trans, 0.5, 1.0))
    assert apart_deg(whole[0][:, 0], local[:, 0]).mean() > 1
    faster = Smoothing(HALF_S, 1 / 30, "rotations").smooth_body(local, trans, 60.0)
    np.testing.assert_allclose(faster[1], smoothing.smooth_vectors(trans, 1 - 0.5**0.5, 2.0))
    with pytest.raises(ValueError, match=r"trans_m has shape \(29, 3\)"):
        Smoothing(HALF_S, 1 / 30, "rotations").smooth_body(local, trans[:29], 30.0)


def test_the_papers_constants_steady_the_pelvis_as_its_table_has_it() -> None:
    """The table's mean acceleration of joints falls from 2.74 to 1.29 mm/frame² with smoothing: the root is in it."""
    paper = Smoothing(0.0481, 0.0333, "axis_angles")
    rng, turns = np.random.default_rng(0), np.tile(np.eye(3), (60, 24, 1, 1))
    trans = np.cumsum(np.full((60, 3), 0.01), axis=0) + rng.normal(0, 0.0007, (60, 3))
    before, after = (
        1000 * np.linalg.norm(np.diff(one, 2, axis=0), axis=1).mean()
        for one in (trans, paper.smooth_body(turns, trans, 30.0)[1])
    )
    assert before == pytest.approx(2.74, abs=0.3)
    assert after < 1.29
    none = Smoothing(0.0, 0.0, "axis_angles")
    np.testing.assert_array_equal(none.smooth_body(turns, trans, 30.0)[1], trans)


@pytest.mark.parametrize("fps", [15.0, 60.0, 120.0])
def test_smoothing_keeps_its_length_in_seconds(fps: float) -> None:
    reference = Smoothing(1 / (30 * np.log(2)), 1 / 30, "rotations")
    alpha, sigma = smoothing.at_frame_rate(reference, fps)
    # A motion of two seconds keeps the same share at every frame rate.
    assert smoothing.remaining_motion(alpha, sigma, 2 * fps) == pytest.approx(
        smoothing.remaining_motion(0.5, 1.0, 60), abs=0.01
    )
    assert smoothing.at_frame_rate(reference, 30.0) == pytest.approx((0.5, 1.0))
