# SPDX-License-Identifier: Apache-2.0
"""scene.factors: dividing exposure and light out of pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.scene.factors import NONE, Factors, read_factors, write_factors


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(0).integers(20, 200, (6, 8, 3)).astype(np.uint8)


def test_a_gained_picture_comes_back_to_a_level_in_bytes_and_exactly_in_floats(picture: np.ndarray) -> None:
    gain = np.array([1.12, 0.9, 1.01])
    exposure = Factors({"a": gain[None]})
    gained = np.rint(picture * gain).astype(np.uint8)
    assert np.abs(exposure.normalise("a", gained).astype(int) - picture).max() <= 1
    exact = (picture / 255 * gain / 2).astype(np.float32)
    np.testing.assert_allclose(exposure.normalise("a", exact), picture / 510, atol=1e-6)


def test_what_has_no_factor_stays_the_same_array(picture: np.ndarray) -> None:
    assert NONE.normalise("a", picture, 5) is picture
    assert Factors({"b": np.full((1, 3), 2.0)}).normalise("a", picture) is picture


def test_gains_and_light_multiply_frame_by_frame(picture: np.ndarray, tmp_path: Path) -> None:
    light = np.array([1.0, 1.2, 0.8])
    write_factors(tmp_path / "gains.json", {"a": np.array([[1.1, 1.0, 0.9]]), "b": np.full((1, 3), 0.5)})
    write_factors(tmp_path / "course.json", {"a": np.repeat(light[:, None], 3, axis=1)})
    both = read_factors([tmp_path / "gains.json", tmp_path / "course.json"], 3)
    filmed = [np.rint(picture * 0.9 * level * np.array([1.1, 1.0, 0.9])).astype(np.uint8) for level in light]
    for even in both.normalise_film("a", filmed):
        assert np.abs(even.astype(float) - picture * 0.9).max() <= 1.5
    assert both.normalise("b", np.full((1, 1, 3), 60, np.uint8), 2).tolist() == [[[120, 120, 120]]]


def test_bright_pixels_clip_instead_of_wrapping_round() -> None:
    bright = np.full((2, 2, 3), 250, np.uint8)
    assert Factors({"a": np.full((1, 3), 0.8)}).normalise("a", bright).min() == 255


def test_an_empty_file_divides_nothing(picture: np.ndarray, tmp_path: Path) -> None:
    write_factors(tmp_path / "gains.json", {})
    assert read_factors([tmp_path / "gains.json"]).normalise("a", picture) is picture


@pytest.mark.parametrize("broken", [[[0.0, 1.0, 1.0]], [[-1.0, 1, 1]], []])
def test_factors_that_cannot_be_divided_by_are_refused(broken: list, tmp_path: Path) -> None:
    (tmp_path / "gains.json").write_text(f'{{"factors": {{"a": {broken}}}}}')
    with pytest.raises(UserError, match=r"factors.*delete it"):
        read_factors([tmp_path / "gains.json"])


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "decisions.json").write_text('{"decisions": []}')
    with pytest.raises(UserError, match=r"decisions\.json .*decisions.*delete it"):
        read_factors([tmp_path / "decisions.json"])


def test_a_course_of_another_length_is_refused(tmp_path: Path) -> None:
    write_factors(tmp_path / "course.json", {"a": np.ones((5, 3))})
    with pytest.raises(UserError, match="5 factors of camera a for 12 frames"):
        read_factors([tmp_path / "course.json"], 12)


def test_factors_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="factors of a"):
        write_factors(tmp_path / "gains.json", {"a": np.array([[np.nan, 1, 1]])})
