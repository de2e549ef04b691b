# SPDX-License-Identifier: Apache-2.0
"""What looks like people and is none, and people who look like furniture, in pictures: filmed in the synthetic studio,
found by the detector, and told apart by the rule that is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.people.association.terms import measure_bones, proportions
from studiorecon.studio.meshes import Mesh

from tests.made.cameras import STANDING
from tests.made.lookalikes import FPS, SECONDS, dog, keeping_still, looked_at, panel, portrait, sitting, stool

FRAMES = round(FPS * SECONDS)


@pytest.mark.slow
def test_a_poster_of_somebody_has_no_depth(root: Path, tmp_path: Path) -> None:
    poster = panel(portrait(1, 0.0), height_m=1.75, above_m=0.12)
    seen = looked_at(1, lambda t: [], [poster], tmp_path, root)
    assert seen.named(0) == seen.people == {"p0"}
    assert "it is flat" in seen.reasons


@pytest.mark.slow
def test_somebody_who_walks_on_a_screen_has_no_depth(root: Path, tmp_path: Path) -> None:
    film = [portrait(0, t / FPS) for t in range(FRAMES)]
    seen = looked_at(1, lambda t: [panel(film[t], height_m=1.6, above_m=0.3, glow=0.6)], [], tmp_path, root)
    assert seen.named(0) == seen.people == {"p0"}
    assert "it is flat" in seen.reasons


@pytest.mark.slow
def test_somebody_s_image_in_a_mirror_is_not_a_second_person(root: Path, tmp_path: Path) -> None:
    mirror = panel(np.full((240, 450, 3), 0.02), height_m=2.4, above_m=0.0, mirror=4.0)
    seen = looked_at(1, lambda t: [mirror], [], tmp_path, root)
    assert seen.named(0) == seen.people == {"p0"}
    assert "mirror image" in seen.reasons


@pytest.mark.slow
@pytest.mark.parametrize(
    ("people", "x_m", "y_m", "heading_rad"), [(0, -0.2, 0.5, 0.5), (1, -0.2, 0.5, 0.5), (0, -0.66, -0.42, 5.03)]
)
def test_a_dog_has_not_a_person_s_proportions(
    people: int, x_m: float, y_m: float, heading_rad: float, root: Path, tmp_path: Path
) -> None:
    def walking(t: int) -> list[Mesh]:
        ahead_m = 0.5 * t / FRAMES
        place = x_m + ahead_m * np.cos(heading_rad), y_m + ahead_m * np.sin(heading_rad)
        return dog(place, heading_rad, float(np.sin(2 * np.pi * t / 8)))

    seen = looked_at(people, walking, [], tmp_path, root)
    assert seen.people == seen.named(0) == ({"p0"} if people else set())


@pytest.mark.slow
def test_somebody_who_stands_still_all_the_time_is_a_person(root: Path, tmp_path: Path) -> None:
    seen = looked_at(2, lambda t: [], [], tmp_path, root, keeping_still)
    assert len(seen.named(1)) == 1, seen.reasons
    assert seen.people == seen.named(0) | seen.named(1)
    assert len(seen.people) == 2


@pytest.mark.slow
def test_somebody_who_sits_on_a_stool_is_a_person(root: Path, tmp_path: Path) -> None:
    seen = looked_at(2, lambda t: [], [stool()], tmp_path, root, sitting)
    assert len(seen.named(1)) == 1, seen.reasons
    assert seen.people == seen.named(0) | seen.named(1)
    assert len(seen.people) == 2


def test_people_of_all_sizes_have_a_person_s_proportions_and_what_has_not_is_named() -> None:
    for size in (0.5, 1.0, 1.3):
        assert proportions(measure_bones(size * STANDING[None] + np.zeros((5, 1, 1)))).nats > 0
    narrow = STANDING.copy()
    for joint in ("shoulder", "hip"):
        narrow[[STABLE_KEYPOINTS.index(f"{side}_{joint}") for side in ("left", "right")], 1] *= 0.5
    term = proportions(measure_bones(np.repeat(narrow[None], 5, axis=0)))
    assert term.nats < -5
    assert "shoulders 0.36 of its trunk, hips 0.20 of its trunk" in term.text


def test_bad_keypoints_of_somebody_cost_less_than_odd_proportions() -> None:
    rng = np.random.default_rng(0)

    def nats(points_m: np.ndarray) -> float:
        return proportions(measure_bones(points_m)).nats

    assert nats(STANDING + rng.normal(0, 0.01, (20, 12, 3))) > 1
    wavering = STANDING + rng.normal(0, 0.06, (20, 12, 3))
    assert nats(wavering) > 0
    wavering[:, [STABLE_KEYPOINTS.index(f"{side}_shoulder") for side in ("left", "right")], 1] *= 0.4
    assert nats(wavering) < -2


def test_what_is_not_known_counts_neither_way() -> None:
    hidden = np.repeat(STANDING[None], 6, axis=0)
    hidden[:, [STABLE_KEYPOINTS.index(f"{side}_ankle") for side in ("left", "right")]] = np.nan
    hidden[:4, STABLE_KEYPOINTS.index("left_knee")] = np.nan
    assert set(measure_bones(hidden)) == {"trunk", "shoulders", "hips", "upper arms", "forearms", "thighs"}
    assert proportions(measure_bones(hidden)).nats > 0
    nothing = measure_bones(np.full((6, 12, 3), np.nan))
    assert nothing == {}
    assert proportions(nothing).nats == 0
