# SPDX-License-Identifier: Apache-2.0
"""Hard cases of optimisers and of the temporal network's inputs (O01 to O08), and the weights of training
views (I11 to I13)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.body.avatar.encoding import BANDS, encode_position, encode_time, in_body_box, time_bands
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train import state
from studiorecon.splatting.train.optimiser import Adam
from studiorecon.splatting.train.schedule import exponential, rates_at
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target, scene_extent
from studiorecon.splatting.train.terms import active_terms

from tests.made.gaussians import camera, camera_on_ring, room
from tests.made.splatting_settings import SETTINGS
from tests.made.training import begun, one_step

BLACK = Target(camera(97, 53), np.zeros((53, 97, 3), np.float32))


# Naive: sin(2⁹πx) in float16 is off by rms 0.18 for |x| ≤ 1, 0.82 up to 5, NaN up to 100; in bfloat16 0.86; in float32
# 0.029 at 1000.
@pytest.mark.parametrize("metres", [pytest.param(m, id=f"O01 body at {m:g} m") for m in (0.0, 5.0, 100.0, 1000.0)])
def test_the_position_code_has_all_its_digits(metres: float) -> None:
    rng = np.random.default_rng(0)
    low, high = np.array([-0.9, -0.3, -1.0]) + metres, np.array([0.9, 0.3, 1.0]) + metres
    truth = rng.uniform(-1, 1, (2000, 3))
    points = (low + high) / 2 + truth * (high - low) / 2
    code = encode_position(in_body_box(points, low, high))
    assert code.shape == (2000, 63)
    assert code.dtype == np.float32
    exact = np.concatenate([truth, *(f(truth * 2.0**k) for k in range(BANDS) for f in (np.sin, np.cos))], axis=1)
    assert np.sqrt(((code - exact) ** 2).mean()) < 1e-4
    assert np.abs(code - exact).max() < 1e-4


# Naive: the top of ten bands turns by 2.1 cycles between two of 121 frames (4.3 / 2 without π): aliased.
def test_o02_no_time_band_turns_faster_than_half_a_cycle_per_frame() -> None:
    highest = 8
    assert time_bands(121) == highest + 1
    codes = np.array([encode_time(frame, 121) for frame in range(121)])
    assert codes.shape == (121, 21)
    bands = codes[:, 1:].reshape(121, BANDS, 2)
    assert not bands[:, highest + 1 :].any()
    turned = np.unwrap(np.arctan2(bands[:, : highest + 1, 0], bands[:, : highest + 1, 1]), axis=0)
    cycles = np.diff(turned, axis=0) / (2 * np.pi)
    # Unaliased: the turn between frames is the band's true frequency.
    true = 2.0 ** np.arange(highest + 1) / 120 / (2 * np.pi)
    np.testing.assert_allclose(cycles, np.broadcast_to(true, cycles.shape), atol=1e-4)
    assert cycles.max() <= 0.5


# Naive: t / (T − 1) divides by zero for T = 1.
@pytest.mark.parametrize("frames", [1, 2, 121], ids=lambda frames: f"O03 of {frames} frames")
def test_time_runs_from_zero_to_one(frames: int) -> None:
    first, last = encode_time(0, frames), encode_time(frames - 1, frames)
    assert first[0] == 0
    assert last[0] == (1 if frames > 1 else 0)
    assert np.isfinite(first).all()
    assert np.isfinite(last).all()


def blob(x_m: float, z_m: float = 3.0) -> Gaussians:
    return Gaussians(
        np.array([[x_m, 0.0, z_m]]),
        np.array([[1.0, 0, 0, 0]]),
        np.full((1, 3), np.log(0.1)),
        np.array([1.0]),
        np.full((1, 4, 3), 0.1),
    )


# Naive (all rows of a dense Adam step): 10 steps of momentum carry the unseen blob as far again, −0.10 → −0.20.
@pytest.mark.parametrize("loop", ["arrays", "training loop"], ids=["O04 arrays", "O04 training loop"])
def test_what_was_not_visible_does_not_move(loop: str) -> None:
    if loop == "arrays":
        position = np.zeros((2, 1), np.float32)
        adam = Adam({"x": position}, (0.9, 0.999), 1e-15)
        for step in range(100):
            seen = np.array([True, step < 10])
            adam.step({"x": np.where(seen, 1.0, 0.0).astype(np.float32)[:, None]}, {"x": 0.01}, rows=seen)
            if step == 9:
                left = position[1, 0]
        assert left == pytest.approx(-0.1, abs=1e-3)
        assert position[1, 0] == left
        return
    # Ten steps on a view that shows both, then ninety on one that looks the other way.
    view = camera(64, 48)
    away = replace(view, camera_from_world=np.diag([-1.0, 1, -1, 1]) @ view.camera_from_world)
    both = Gaussians(*(np.concatenate(pair) for pair in zip(vars(blob(0.0)).values(), vars(blob(0.3, -3.0)).values())))
    grey = np.full((48, 64, 3), 0.2, np.float32)
    run = begun(both, [Target(view, grey), Target(away, grey)], SETTINGS)
    for step in range(10):
        one_step(run, active_terms(SETTINGS), step, 0)
    ahead = run.state.source == 0
    before = state.state_gaussians(run.state)
    for step in range(10, 100):
        one_step(run, active_terms(SETTINGS), step, 1)
    after = state.state_gaussians(run.state)
    for name in ("means_m", "quaternions", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(after, name)[ahead], getattr(before, name)[ahead])
    assert np.abs(after.sh[~ahead] - before.sh[~ahead]).max() > 0.01


# Naive: with epsilon 1e-15 a gradient of 1e-12 becomes a full step, 0.016; with 1e-8 still 1.6e-6.
def test_o05_rounding_noise_is_not_a_full_step() -> None:
    gaussians = room(64, 3)
    run = begun(gaussians, [BLACK], SETTINGS)
    rasteriser = run.rasteriser
    rasteriser.draw(run.state.blocked, camera(97, 53), (0, 0, 0))
    noisy = int(np.flatnonzero(rasteriser.visible)[0])
    gradient = np.zeros_like(run.state.blocked.parameters).reshape(-1, 59, 16)
    gradient[:, :3] = 1e-3
    gradient[noisy // 16, :3, noisy % 16] = 1e-12
    before = state.state_gaussians(run.state).means_m
    run.descend(0, 3, gradient.reshape(-1))
    steps = np.abs(state.state_gaussians(run.state).means_m - before).max(axis=1)
    rate = SETTINGS.position_lr_start
    np.testing.assert_allclose(steps[np.flatnonzero(rasteriser.visible)[1:]], rate, rtol=0.05)
    assert steps[noisy] < 0.01 * rate


# Naive: one NaN makes the parameter and both moments NaN for ever.
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf], ids=lambda value: f"O06 {value}")
def test_a_gradient_that_is_not_finite_is_skipped_and_counted(poison: float) -> None:
    run = begun(room(64, 3), [BLACK], SETTINGS)
    run.rasteriser.draw(run.state.blocked, camera(97, 53), (0, 0, 0))
    seen = int(np.flatnonzero(run.rasteriser.visible)[0])
    gradient = np.full_like(run.state.blocked.parameters, 1e-3).reshape(-1, 59, 16)
    gradient[seen // 16, 1, seen % 16] = poison
    before = state.state_gaussians(run.state)
    run.descend(0, 3, gradient.reshape(-1))
    after = state.state_gaussians(run.state)
    assert run.adam.refused == 1
    assert state.finite_mask(after).all()
    assert after.means_m[seen, 1] == before.means_m[seen, 1]
    assert after.means_m[seen, 0] != before.means_m[seen, 0]
    run.descend(1, 3, np.full_like(run.state.blocked.parameters, 1e-3))
    assert state.state_gaussians(run.state).means_m[seen, 1] != before.means_m[seen, 1], (
        "it moves again with the next good gradient"
    )
    values, slopes = np.zeros((3, 2), np.float32), np.ones((3, 2), np.float32)
    slopes[1, 1] = poison
    adam = Adam({"x": values}, (0.9, 0.999), 1e-8)
    adam.step({"x": slopes}, {"x": 0.1})
    assert adam.refused == 1
    assert values[1, 1] == 0
    adam.step({"x": np.ones_like(values)}, {"x": 0.1})
    assert (values < 0).all()


# Naive: log of an end rate of 0 is a domain error.
@pytest.mark.parametrize(
    ("begin", "end"), [(1e-3, 0.0), (1.6e-4, 1.6e-6), (0.0, 0.0)], ids=["O07 to zero", "O07 paper", "O07 zero"]
)
def test_a_schedule_is_monotone_and_finite(begin: float, end: float) -> None:
    rates = [exponential(begin, end, done) for done in np.linspace(0, 1, 11)]
    assert np.isfinite(rates).all()
    assert np.all(np.diff(rates) <= 0)
    assert rates[-1] == pytest.approx(max(end, 1e-12))


# Naive: a step of 1.6e-6 m at 1e6 m changes nothing in float32; the world is re-centred on the cameras (C08), where it
# does.
def test_o07_the_smallest_step_moves_a_recentred_position() -> None:
    assert np.float32(1e6) + np.float32(1.6e-6) == np.float32(1e6)
    assert np.float32(8.0) + np.float32(rates_at(SETTINGS, 0, 4.0)[0]) != np.float32(8.0)


# Naive: a step of 1.6e-4 whatever the extent is 0.16 % of a scene of 0.1 m and 1.6e-6 of one of 100 m.
@pytest.mark.parametrize("size", [0.125, 128.0], ids=lambda size: f"O08 scene times {size:g}")
def test_training_does_not_depend_on_the_unit_of_length(size: float) -> None:
    truth = room(400, 3).with_sh_degree(1)
    views = [camera_on_ring(i, 4, 97, 53) for i in range(4)]
    pictures = [Rasteriser(near_m=0.01, threads=1).forward(truth, view).rgb.clip(0, 1) for view in views]
    begin = replace(
        truth, means_m=truth.means_m + np.random.default_rng(0).normal(0, 0.03, truth.means_m.shape).astype(np.float32)
    )

    def scaled(view: Camera) -> Camera:
        pose = view.camera_from_world.copy()
        pose[:3, 3] *= size
        return replace(view, camera_from_world=pose)

    settings = replace(SETTINGS, iterations=40, warmup_half_resolution=0.0)
    targets = [Target(view, rgb) for view, rgb in zip(views, pictures)]
    plain = train(begin, targets, settings, np.random.default_rng(0), extent_m=scene_extent(views), threads=1).gaussians
    big_views = [scaled(view) for view in views]
    big_begin = replace(
        begin, means_m=begin.means_m * np.float32(size), log_scales=begin.log_scales + np.float32(np.log(size))
    )
    big = train(
        big_begin,
        [Target(view, rgb) for view, rgb in zip(big_views, pictures)],
        replace(settings, near_m=0.01 * size),
        np.random.default_rng(0),
        extent_m=scene_extent(big_views),
        threads=1,
    ).gaussians
    moved, big_moved = plain.means_m - begin.means_m, (big.means_m - big_begin.means_m) / np.float32(size)
    # Rounding is amplified by Adam where gradients are tiny, so the comparison is of the whole.
    assert np.linalg.norm(big_moved - moved) < 0.02 * np.linalg.norm(moved)
    assert np.abs(big.sh - plain.sh).mean() < 1e-3
