# SPDX-License-Identifier: Apache-2.0
"""Pictures of a static camera in one light, whoever passes and however the light swings."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.images.photometric_normalisation import STEADY, light_factors, normalise_light

from tests.made.footage import smooth_pictures


def filmed(gains: np.ndarray, noise: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """(T, H, W, 3) uint8 of a room in a light that changes by ``gains`` (T, 3), and (T, H, W) where nobody stands: a
    bright block whom a detector saw crosses it, and a dark one whom it did not."""
    rng = np.random.default_rng(5)
    room = 30 + 0.6 * smooth_pictures(1, seed=4)[0].astype(np.float64)
    pictures, free = room * gains[:, None, None], np.ones((len(gains), *room.shape[:2]), bool)
    for t in range(len(gains)):
        seen, unseen = round(t * 60 / len(gains)), round(70 - t * 60 / len(gains))
        pictures[t, 10:50, seen : seen + 15], free[t, 10:50, seen : seen + 15] = 250, False
        pictures[t, 20:60, unseen : unseen + 12] = 15
    return np.clip(np.rint(pictures + rng.normal(0, noise, pictures.shape)), 0, 255).astype(np.uint8), free


def test_a_swinging_light_is_measured_and_divided_out() -> None:
    swing = 1 + 0.15 * np.sin(np.linspace(0, 2 * np.pi, 40))[:, None] * [1.0, 0.8, 0.6]
    frames, free = filmed(swing)
    factors = light_factors(frames, free)
    np.testing.assert_allclose(factors, swing / np.median(swing, axis=0), rtol=0.01)
    even = normalise_light(frames, factors).astype(np.float64)
    corner = np.s_[:, 52:60, :10]
    assert np.ptp(frames[corner].mean(axis=(1, 2)), axis=0).max() > 15
    assert np.ptp(even[corner].mean(axis=(1, 2)), axis=0).max() < 2


def test_in_a_steady_light_nothing_is_touched() -> None:
    frames, free = filmed(np.ones((30, 3)))
    factors = light_factors(frames, free)
    assert np.abs(np.log(factors)).max() < STEADY / 4
    assert normalise_light(frames, factors) is frames


@pytest.mark.parametrize("case", ["nobody free", "black", "burnt out"])
def test_pictures_that_do_not_tell_are_left_as_they_are(case: str) -> None:
    frames, free = filmed(np.ones((10, 3)))
    if case == "nobody free":
        free[:] = False
    else:
        frames[:] = 0 if case == "black" else 255
    assert (light_factors(frames, free) == 1).all()


def test_a_picture_that_somebody_fills_is_left_out_and_the_others_are_reported() -> None:
    swing = np.where(np.arange(20)[:, None] % 2 == 0, 0.85, 1.0) * np.ones(3)
    frames, free = filmed(swing)
    free[7] = False
    factors = light_factors(frames, free)
    assert (factors[7] == 1).all()
    reported = np.delete(factors / factors[1], 7, axis=0)
    np.testing.assert_allclose(reported, np.delete(swing / swing[1], 7, axis=0), rtol=0.012)


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    frames, free = filmed(np.ones((6, 3)))
    with pytest.raises(ValueError, match="free"):
        light_factors(frames, free[:5])
