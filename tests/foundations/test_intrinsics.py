# SPDX-License-Identifier: Apache-2.0
"""U60: the focal length from a local point map."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.intrinsics import FittedFocal, focal_from_points

WH = (128, 72)


def point_map(focal_px: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points (H, W, 3) in camera axes of a bumpy scene, and pixels (H, W, 2)."""
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(np.arange(WH[0]) + 0.5, np.arange(WH[1]) + 0.5)
    depth = rng.uniform(1.5, 6.0, columns.shape)
    slope = np.stack([(columns - WH[0] / 2) / focal_px, (rows - WH[1] / 2) / focal_px], axis=-1)
    return np.concatenate([slope * depth[..., None], depth[..., None]], axis=-1), np.stack([columns, rows], axis=-1)


def fit(points: np.ndarray, pixels: np.ndarray, confidence: np.ndarray | None = None) -> FittedFocal:
    return focal_from_points(points, pixels, np.ones(points.shape[:-1]) if confidence is None else confidence, WH, 0.1)


@pytest.mark.parametrize("focal", [40.0, 110.0, 400.0], ids=lambda f: f"U60-{f:g}")
def test_exact_points_give_the_exact_focal_length_in_any_unit(focal: float) -> None:
    points, pixels = point_map(focal)
    for unit in (1.0, 1e-3, 1e4):
        found = fit(unit * points, pixels)
        assert found.focal_px == pytest.approx(focal, rel=1e-9)
        assert found.error_px < 1e-6
    assert found.intrinsics(WH) == pytest.approx(np.array([[focal, 0, 64], [0, focal, 36], [0, 0, 1]]))


def test_a_third_of_wrong_points_moves_it_little() -> None:
    points, pixels = point_map(110.0)
    rng = np.random.default_rng(1)
    wrong = rng.random(points.shape[:2]) < 0.3
    points[wrong] += rng.normal(0, 2.0, (int(wrong.sum()), 3))
    assert fit(points, pixels).focal_px == pytest.approx(110.0, rel=0.02)


def test_points_that_are_none_are_left_out() -> None:
    points, pixels = point_map(110.0)
    confidence = np.ones(points.shape[:2])
    for at, bad in (((0, 0), np.nan), ((1, 1), np.inf), ((2, 2), -np.inf)):
        points[at] = bad
    points[3] *= -1  # behind the camera
    points[4] = 0.0
    confidence[5:20], points[5:20] = 0.05, points[5:20] * [3.0, 1, 1]
    confidence[30, :40], points[30, :40] = np.nan, 7.0
    assert fit(points, pixels, confidence).focal_px == pytest.approx(110.0, rel=1e-9)


def test_no_points_and_points_on_the_axis_are_undetermined() -> None:
    points, pixels = point_map(110.0)
    for found in (fit(np.full_like(points, np.nan), pixels), fit(points, np.full_like(pixels, 64.0) * [1, 36 / 64])):
        assert np.isnan(found.focal_px)
        assert "points" in found.reason
    assert "axes" in fit(points * [-1, -1, 1], pixels).reason


def test_another_principal_point_shows_in_the_error() -> None:
    points, pixels = point_map(110.0)
    assert fit(points, pixels + np.array([9.0, 0])).error_px > 4


def test_wrong_shapes_are_named() -> None:
    points, pixels = point_map(110.0)
    with pytest.raises(ValueError, match=r"confidence has shape \(4,\)"):
        fit(points, pixels, np.ones(4))
