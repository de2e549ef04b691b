# SPDX-License-Identifier: Apache-2.0
"""A camera out of focus is found among sharp ones; soft rooms and equal cameras are left alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.scene.decisions import Decision
from studiorecon.survey.effects import DEFOCUS
from studiorecon.survey.effects.defocus import edge_blur_px
from studiorecon.survey.evidence import Evidence, SurveyInput

from tests.made.planted import SETTINGS
from tests.made.studio_world import scene


def tiles(seed: int, blur_px: float) -> np.ndarray:
    """(192, 288, 3) a picture of turned rectangles, drawn four times as large, blurred by so much and noisy."""
    rng = np.random.default_rng(seed)
    large = np.full((768, 1152, 3), 0.5, np.float32)
    for _ in range(60):
        box = cv2.boxPoints((rng.uniform((0, 0), (1152, 768)), rng.uniform(80, 320, 2), rng.uniform(0, 90)))
        cv2.fillConvexPoly(large, np.rint(box).astype(np.int32), tuple(map(float, rng.uniform(0.1, 0.9, 3))))
    small = cv2.resize(
        cv2.GaussianBlur(large, (0, 0), 4 * np.hypot(blur_px, 0.25)), (288, 192), interpolation=cv2.INTER_AREA
    )
    return (small + rng.normal(0, 0.001, small.shape)).astype(np.float32)


def scored(blurs_px: list[float], seed: int = 0) -> Decision:
    """The decision where the cameras' plates are tiles blurred by so much."""
    material: SurveyInput = scene(seed)
    views = [
        replace(view, rgb=tiles(10 * seed + k, blur_px))
        for k, (view, blur_px) in enumerate(zip(material.views, blurs_px, strict=True))
    ]
    found = DEFOCUS.measure(Evidence(replace(material, views=views), SETTINGS), DEFOCUS.threshold)
    return DEFOCUS.decide(found.value, found.interval, found.reason, detail=found.detail)


@pytest.mark.parametrize("seed", range(3))
def test_one_camera_out_of_focus_is_found_and_named(seed: int) -> None:
    found = scored([0.0, 0.0, 1.5, 0.0], seed)
    assert found.verdict == "on"
    assert found.reason.startswith("c2's")
    # 1.5 px of 288 are 6.7 of 1280.
    assert found.value == pytest.approx(1.5 * 1280 / 288, rel=0.15)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("blur_px", [0.0, 1.0])
def test_cameras_that_are_equally_sharp_set_nothing_off(blur_px: float, seed: int) -> None:
    assert scored([blur_px] * 4, seed).verdict == "off"


@pytest.mark.parametrize("seed", range(2))
def test_a_camera_that_sees_somewhat_softer_things_is_not_called_out_of_focus(seed: int) -> None:
    found = scored([1.0, 1.0, 1.2, 1.0], seed)
    assert found.value is not None
    assert found.value > DEFOCUS.threshold
    assert found.verdict == "undetermined"


def test_blurs_add_in_squares() -> None:
    sharp = edge_blur_px(tiles(3, 0.0), np.ones((192, 288), bool)).value
    for blur_px in (1.0, 2.0, 3.0):
        found = edge_blur_px(tiles(3, blur_px), np.ones((192, 288), bool)).value
        assert np.sqrt(found**2 - sharp**2) == pytest.approx(blur_px, rel=0.15)


def test_without_edges_nothing_is_said() -> None:
    material = scene(2, texture=0.0)
    found = DEFOCUS.measure(Evidence(material, SETTINGS), DEFOCUS.threshold)
    assert found.value is None
    assert "enough sharp edges" in found.reason
