# SPDX-License-Identifier: Apache-2.0
"""A calibration of a film whose pixels are not square may be for the picture as stored, or as shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.geometry.crop_hypotheses import for_square_pixels
from studiorecon.scene.camera import Lens

STORED, SHOWN = (240, 180), (320, 180)
FOR_SHOWN = Lens(
    "a",
    SHOWN,
    np.array([[228.0, 0, 160.0], [0, 228.0, 90.0], [0, 0, 1]]),
    "opencv",
    np.array([-0.1, 0.02, 0, 0, 0]),
    np.eye(4),
    np.eye(2, 3),
)


def for_stored(scale: float = 1.0, sized: bool = True) -> Lens:
    wh = tuple(round(side * scale) for side in STORED) if sized else (0, 0)
    return replace(FOR_SHOWN, wh=wh, intrinsics=np.diag([0.75 * scale, scale, 1.0]) @ FOR_SHOWN.intrinsics)


@pytest.mark.parametrize("lens", [FOR_SHOWN, for_stored(), replace(FOR_SHOWN, wh=(0, 0)), for_stored(sized=False)])
def test_both_are_the_same_camera(lens: Lens) -> None:
    square, note = for_square_pixels(lens, STORED, SHOWN)
    np.testing.assert_allclose(square.intrinsics, FOR_SHOWN.intrinsics)
    assert square.wh in (SHOWN, (0, 0))
    assert "240×180" in note
    assert "320×180" in note


def test_a_calibration_of_another_scale_is_known_by_its_shape() -> None:
    square, _ = for_square_pixels(for_stored(2.0), STORED, SHOWN)
    assert square.wh == (640, 360)
    np.testing.assert_allclose(square.intrinsics, np.diag([2.0, 2.0, 1.0]) @ FOR_SHOWN.intrinsics)


def test_square_pixels_and_the_user_s_own_maps_stay() -> None:
    mapped = replace(for_stored(), calibration_from_video=np.array([[2.0, 0, 0], [0, 2.0, 0]]))
    assert for_square_pixels(FOR_SHOWN, SHOWN, SHOWN) == (FOR_SHOWN, "")
    assert for_square_pixels(mapped, STORED, SHOWN) == (mapped, "")
