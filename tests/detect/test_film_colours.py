# SPDX-License-Identifier: Apache-2.0
"""A film with inverted or exchanged colours among others is named, and other differences of cameras are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.footage.source import open_source
from studiorecon.keypoints.film_colours import colour_notes, unlike_colours
from studiorecon.scene.camera import Lens
from studiorecon.scene.people import Detections

from tests.made.footage import write_video

READINGS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "as it is": (lambda rgb: rgb, ""),
    "BGR": (lambda rgb: rgb[..., ::-1], "red and blue exchanged"),
    "inverted": (lambda rgb: 1 - rgb, "its colours inverted"),
    "both": (lambda rgb: 1 - rgb[..., ::-1], "its colours inverted, and red and blue exchanged"),
    "darker": (lambda rgb: 0.6 * rgb, ""),
    "warmer": (lambda rgb: np.clip(rgb * [1.15, 1, 0.85], 0, 1), ""),
    "another person": (lambda rgb: np.roll(rgb, 4, axis=0), ""),
    "grey": (lambda rgb: np.repeat(rgb.mean(-1, keepdims=True), 3, -1), ""),
}
CLOTHES = np.array(
    [
        [0.75, 0.55, 0.45],
        *[[0.5, 0.2, 0.15]] * 2,
        *[[0.55, 0.22, 0.2], [0.75, 0.55, 0.45], *[[0.2, 0.25, 0.45]] * 2] * 2,
    ]
)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("seed", range(4))
def test_colours_of_one_film_among_others(reading: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    change, wanted = READINGS[reading]
    films = {f"c{k}": np.clip(CLOTHES * np.exp(rng.normal(0, 0.12, CLOTHES.shape)), 0, 1) for k in range(4)}
    films["c2"] = change(films["c2"])
    assert unlike_colours(films) == ({"c2": wanted} if wanted else {})
    two = {"c1": films["c1"], "c2": films["c2"]}
    assert unlike_colours(two) == {}


@pytest.mark.parametrize("seed", range(8))
def test_a_dim_film_is_not_named_for_the_little_contrast_that_inverting_it_leaves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    films = {f"c{k}": np.clip(0.2 * CLOTHES * np.exp(rng.normal(0, 0.6, CLOTHES.shape)), 0, 1) for k in range(4)}
    assert unlike_colours(films) == {}


def test_an_inverted_film_is_named_by_its_people(tmp_path: Path) -> None:
    keypoints = np.array([[[8 + 6 * k, 10 + 4 * k, 0.9] for k in range(17)]])
    skin, shirt, trousers = [190, 140, 115], [130, 45, 40], [50, 60, 120]
    picture = np.repeat(np.array([skin, shirt, trousers], np.uint8)[[0] * 30 + [1] * 20 + [2] * 46, None], 128, axis=1)
    films, seen = {}, []
    for camera in ("a", "b", "c"):
        shown = 255 - picture if camera == "b" else picture
        write_video(tmp_path / f"{camera}.mp4", np.stack([shown] * 12))
        films[camera] = open_source(tmp_path / f"{camera}.mp4", 0.0)
        frames = np.arange(12)
        seen.append(Detections(camera, "coco17", frames, np.zeros(12, int), np.repeat(keypoints, 12, axis=0)))
    (messages,) = colour_notes(films, seen)
    assert "camera b have the colours of the other films with its colours inverted" in messages
    assert colour_notes(films, [d for d in seen if d.camera != "b"]) == []
    assert colour_notes(films, [Detections("a", "coco17", frames[:0], frames[:0], keypoints[:0])]) == []
    # A film with a bar above, whose keypoints are in the pixels of the calibrated picture below it.
    write_video(tmp_path / "d.mp4", np.stack([np.pad(picture, ((48, 0), (0, 0), (0, 0)), constant_values=255)] * 12))
    films["d"] = open_source(tmp_path / "d.mp4", 0.0)
    right = [d for d in seen if d.camera != "b"] + [replace(seen[0], camera="d")]
    below = np.array([[1.0, 0, 0], [0, 1, -48]])
    lens = Lens("d", (128, 96), np.eye(3), "opencv", np.zeros(8), np.eye(4), below, keypoints_calibrated=True)
    assert colour_notes(films, right, {"d": lens}) == []
    assert colour_notes(films, right), "read as the film's pixels they are on other things"
