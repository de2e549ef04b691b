# SPDX-License-Identifier: Apache-2.0
"""Constants are fixed points: of every filter, of warping and resizing, of the enhancement blend, and of every measure
of change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from hypothesis import given
from hypothesis import strategies as st
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.stills import shrink
from studiorecon.geometry.lens import working_view, working_wh
from studiorecon.images import metrics
from studiorecon.images.blur import gaussian_blur
from studiorecon.images.plate import temporal_modes
from studiorecon.images.warp import warp
from studiorecon.masks.labelling import edge_aware_average
from studiorecon.recursive.injection import Injection, confidence, inject
from studiorecon.scene.camera import Lens

from tests.properties.moved_worlds import FEW, MANY, numbers

CONFIG = yaml.safe_load((Path(__file__).parents[2] / "config/config.yaml").read_text(encoding="utf-8"))
READING = settings_module.load(Injection, CONFIG["enhance"]["injection"], "enhance.injection")
LEVELS = numbers(0, 1)


@FEW
@given(LEVELS, st.sampled_from([1, 3, 11, 21]), numbers(0.3, 6))
def test_a_blur_keeps_constants(level: float, size: int, sigma: float) -> None:
    np.testing.assert_allclose(gaussian_blur(np.full((17, 23, 3), level), size, sigma), level, atol=2e-6)


@MANY
@given(LEVELS, st.integers(0, 1000), st.sampled_from(["nearest", "linear", "cubic"]))
def test_a_warp_keeps_constants_even_where_it_leaves_the_picture(level: float, seed: int, how: str) -> None:
    flow = np.random.default_rng(seed).normal(0, 12, (17, 23, 2))
    values, _ = warp(np.full((17, 23), level, np.float32), flow, how)
    np.testing.assert_allclose(values, level, atol=2e-6)


@FEW
@given(LEVELS, st.integers(0, 1000), st.integers(0, 8), st.sampled_from([(23, 17), (46, 34), (11, 9)]))
def test_what_resizes_straightens_or_smooths_edge_aware_average_keeps_constants(
    level: float, seed: int, radius: int, wh: tuple[int, int]
) -> None:
    rng = np.random.default_rng(seed)
    flat, measured = np.full((17, 23, 3), level, np.float32), rng.random((17, 23)) < 0.8
    smaller, known = shrink(np.where(measured[..., None], flat, 9), measured, wh)
    np.testing.assert_allclose(smaller[known], level, atol=1e-5)
    smooth = edge_aware_average(flat[..., 0], rng.integers(0, 255, (17, 23, 3), dtype=np.uint8), radius)
    np.testing.assert_allclose(smooth, level, atol=1e-4)
    lens = Lens(
        "c",
        (46, 34),
        np.array([[40.0, 0, 23], [0, 40, 17], [0, 0, 1]]),
        "opencv",
        rng.normal(0, 0.02, 5),
        np.eye(4),
        np.eye(2, 3),
    )
    picture = working_view(lens, (46, 34), working_wh((46, 34), wh[0])).picture(
        np.full((34, 46, 3), round(255 * level), np.uint8)
    )
    np.testing.assert_array_equal(picture, round(255 * level))


@FEW
@given(LEVELS, st.integers(0, 1000))
def test_a_constant_film_has_no_change_and_every_moved_picture_of_it_is_itself(level: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat, flow = np.full((17, 23, 3), level, np.float32), rng.normal(0, 2, (17, 23, 2)).astype(np.float32)
    inside = warp(flat[..., 0], flow)[1]
    for change in metrics.change_maps(flat, flat, flow, inside):
        np.testing.assert_allclose(change[inside], 0, atol=1e-6)
    assert metrics.psnr(flat, flat) == metrics.PSNR_CAP_DB
    np.testing.assert_allclose(metrics.ssim_map(flat, flat), 1, atol=1e-12)


@FEW
@given(st.tuples(*[st.integers(0, 255)] * 3), st.integers(1, 9), st.integers(0, 100))
def test_the_plate_of_a_film_that_never_changes_is_its_picture(colour: tuple, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = np.tile(np.uint8(colour), (count, 9, 11, 1))
    free = rng.random((count, 9, 11)) < 0.7
    plate, votes, rival = temporal_modes(frames, free, 8.0)
    measured = free.any(axis=0)
    np.testing.assert_array_equal(plate[measured], np.broadcast_to(np.float32(colour), plate[measured].shape))
    np.testing.assert_array_equal(votes, free.sum(axis=0))
    assert not rival.any()


@FEW
@given(
    LEVELS,
    st.integers(0, 1000),
    st.integers(0, 3),
)
def test_injection_keeps_constants_whatever_the_confidence(level: float, seed: int, existing: int) -> None:
    rng = np.random.default_rng(seed)
    render = np.full((17, 23, 3), level, np.float32)
    shares = [rng.random((17, 23)).astype(np.float32) for _ in range(existing)]
    blended, injected = inject(render, [render] * existing, shares, READING)
    np.testing.assert_allclose(blended, level, atol=1e-6)
    assert (injected <= READING.strength + 1e-6).all()
    trust = confidence(render, render, np.ones((17, 23), bool), READING)
    np.testing.assert_allclose(trust, 1, atol=2e-6)
