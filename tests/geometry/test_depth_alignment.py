# SPDX-License-Identifier: Apache-2.0
"""Aligning a predicted depth to a measured one, on the inputs where least squares gives a finite wrong answer (rows D,
C12)."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.depth_alignment import Alignment, align_depth, shared_alignment
from studiorecon.geometry.depth_surface import depth_breaks
from studiorecon.images.warp import sample

SCALE, SHIFT_M = 2.0, 0.5


def made(moved: float, seed: int = 0, noise: float = 0.0, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and reference depth with a share of pixels nearer than before (people walked in)."""
    rng = np.random.default_rng(seed)
    predicted = rng.uniform(0.5, 4.0, count)
    reference = SCALE * predicted + SHIFT_M
    gone = rng.random(count) < moved
    predicted = predicted + noise * rng.normal(size=count)
    return predicted, np.where(gone, rng.uniform(1.0, 3.0, count), reference + 0.005 * rng.normal(size=count))


def fit(predicted: np.ndarray, reference: np.ndarray, static: np.ndarray | None = None) -> Alignment:
    return align_depth(
        predicted, reference, np.ones(len(predicted), bool) if static is None else static, np.random.default_rng(1)
    )


@pytest.mark.parametrize("moved", [0.0, 0.10, 0.30, 0.45], ids=lambda v: f"D01-{v:.0%}")
def test_moved_pixels_do_not_move_the_scale(moved: float) -> None:
    # Least squares: 2.00, 1.80, 1.39, 1.16.
    found = fit(*made(moved))
    assert found.model == "affine"
    assert found.scale == pytest.approx(SCALE, rel=0.005)
    assert found.shift_m == pytest.approx(SHIFT_M, abs=0.03)


def test_d01_above_half_needs_the_mask() -> None:
    predicted, reference = made(0.6)
    clean = np.abs(reference - (SCALE * predicted + SHIFT_M)) < 0.1
    assert fit(predicted, reference, clean).scale == pytest.approx(SCALE, rel=0.005)


@pytest.mark.parametrize("spread", [0.0, 1e-7, 0.01], ids=lambda v: f"D02-{v:g}")
def test_a_flat_wall_gives_a_scale_and_no_shift(spread: float) -> None:
    # Least squares: scale 20.8 and shift -56; scale -1104 at 1e-7.
    rng = np.random.default_rng(2)
    predicted = 1.5 + spread * rng.normal(size=500)
    found = fit(predicted, 3.25 + 0.01 * rng.normal(size=500))
    assert found.model == "scale"
    assert found.shift_m == 0
    assert found.scale == pytest.approx(3.25 / 1.5, rel=0.01)


def test_d02_scale_is_never_negative() -> None:
    predicted = np.linspace(1, 3, 400)
    found = fit(predicted, 4 - predicted)
    assert found.model == "scale"
    assert found.scale > 0


def test_d03_far_depth_stays_positive_when_fitted_near() -> None:
    # In disparity 50 of 5500 far pixels became negative, down to -12318 m.
    rng = np.random.default_rng(3)
    near = rng.uniform(1, 4, 2000)
    found = fit(near, 1.1 * near + 0.05 * rng.normal(size=2000))
    far = found.apply(np.linspace(20, 200, 5500), 0.1)
    assert (far > 0).all()
    assert far.max() < 1.2 * 200


def test_d04_depth_pushed_behind_the_camera_is_unknown() -> None:
    aligned = Alignment(1.0, -1.8, "affine").apply(np.array([1.4, 2.4]), 0.1)
    assert aligned[0] == 0
    assert aligned[1] == pytest.approx(0.6)


@pytest.mark.parametrize("bad", [np.inf, np.nan, 0.0, -1.0], ids=lambda v: f"D05-{v}")
@pytest.mark.parametrize("which", ["predicted", "reference"])
def test_unusable_values_change_nothing(bad: float, which: str) -> None:
    maps = dict(zip(("predicted", "reference"), made(0.0)))
    maps[which][::5] = bad
    found = fit(**maps)
    assert found.scale == pytest.approx(SCALE, rel=0.002)
    assert found.apply(np.array([bad]), 0.1)[0] == 0


def test_d06_a_static_camera_does_not_flicker() -> None:
    # Independent least squares: 13.2 cm at 4 m.
    frames = [fit(*made(0.3, seed, count=1500)) for seed in range(121)]
    depth = [frame.apply(np.array([1.75]), 0.1)[0] for frame in frames]
    assert np.std(depth) < 0.005
    assert np.abs(np.diff(depth)).max() < 0.02
    shared = shared_alignment(frames)
    assert shared.apply(np.array([1.75]), 0.1)[0] == pytest.approx(4.0, abs=0.005)


@pytest.mark.parametrize("noise", [0.1, 0.25], ids=lambda v: f"D07-both-{v}")
def test_noise_in_both_maps_does_not_flatten_the_slope(noise: float) -> None:
    # One-sided least squares of the noisier map: attenuated by var/(var + noise²) = 0.94 at 0.25.
    rng = np.random.default_rng(5)
    truth = rng.uniform(0.5, 4.0, 20000)
    found = fit(truth + noise * rng.normal(size=20000), SCALE * (truth + noise * rng.normal(size=20000)) + SHIFT_M)
    assert found.scale == pytest.approx(SCALE, rel=0.02)


def test_nothing_to_fit_is_undetermined() -> None:
    assert fit(np.full(10, np.nan), np.ones(10)).model == "undetermined"
    assert shared_alignment([fit(np.zeros(100), np.ones(100))]).model == "undetermined"


def test_c12_depth_is_never_read_between_two_surfaces() -> None:
    # Bilinear: 4 m at the silhouette of a person at 2 m before a wall at 6 m; halos of 0.75 and 2.25 beside unknown
    # pixels.
    depth = np.full((20, 20), 6.0, np.float32)
    depth[:, :10] = 2.0
    columns = np.linspace(8.0, 12.0, 41)
    read, valid = sample(depth, np.stack([columns, np.full(41, 10.3)], axis=-1)[None], "nearest")
    assert valid.all()
    assert set(np.unique(read)) == {2.0, 6.0}
    assert depth_breaks(depth, 0.04)[:, 9:11].all()
    assert not depth_breaks(depth, 0.04)[:, :8].any()
