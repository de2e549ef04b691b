# SPDX-License-Identifier: Apache-2.0
"""Each effect: planted it is found, alone it does not set off another, and without information nothing is claimed.

Many seeds and all pairs are the benchmark's (``python -m benchmarks.effects``); here a few seeds keep the statistics
honest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.scene.decisions import Decision
from studiorecon.survey.effect_decisions import decide_effects
from studiorecon.survey.evidence import Evidence, SurveyInput
from studiorecon.survey.scene_change import MovingRegion, largest_moving

from tests.made.planted import ROOT, SETTINGS  # noqa: F401
from tests.made.studio_world import OTHERWISE, PLANTED, scene

# Where the scene without anything planted stands: a ring of four cameras in a deep room, with one person far from them.
USUAL_ON = {"people", "closed_path", "view_synthesis"}


def decisions(material: SurveyInput) -> dict[str, Decision]:
    return {d.effect: d for d in decide_effects(Evidence(material, SETTINGS), SETTINGS.thresholds)}


@pytest.fixture(scope="module")
def usual() -> SurveyInput:
    return scene(0)


@pytest.fixture(scope="module")
def base(usual: SurveyInput) -> dict[str, Decision]:
    return decisions(usual)


def test_nothing_planted_nothing_found(base: dict[str, Decision]) -> None:
    assert {effect: d.verdict for effect, d in base.items()} == {e: "on" if e in USUAL_ON else "off" for e in base}


@pytest.mark.parametrize("cause", OTHERWISE)
def test_what_other_steps_take_out_sets_no_effect_off(base: dict[str, Decision], cause: str) -> None:
    found = decisions(scene(0, **OTHERWISE[cause]))
    assert {effect: d.verdict for effect, d in found.items()} == {effect: d.verdict for effect, d in base.items()}


# Fifteen cameras take their time.
SLOW = {"view_synthesis"}


@pytest.mark.parametrize("effect", [pytest.param(e, marks=[pytest.mark.slow] if e in SLOW else []) for e in PLANTED])
def test_a_planted_effect_is_found_and_no_other_one(effect: str) -> None:
    found = decisions(scene(1, **PLANTED[effect]))
    assert found[effect].verdict == ("off" if effect in USUAL_ON else "on"), found[effect]
    for other, decision in found.items():
        if other != effect:
            assert decision.verdict in ("undetermined", "on" if other in USUAL_ON else "off"), decision


class TestNoInformation:
    def test_a_blank_room_does_not_say_whether_cameras_move(self) -> None:
        assert decisions(scene(2, texture=0.0))["moving_cameras"].verdict == "undetermined"

    def test_without_depth_cameras_share_nothing(self) -> None:
        found = decisions(scene(2, known_depth=False))
        assert {found[e].verdict for e in ("exposure", "view_dependent_colour", "moving_shadows")} == {"undetermined"}

    def test_without_people_nothing_is_said_of_their_shadows(self) -> None:
        found = decisions(scene(2, people=0))
        assert found["moving_shadows"].verdict == "undetermined"
        assert found["people"].verdict == "off"

    def test_where_people_hide_the_room_nothing_is_said_of_light_and_things(self, usual: SurveyInput) -> None:
        hidden = replace(usual, films=[replace(f, free=np.zeros_like(f.free)) for f in usual.films])
        found = decisions(hidden)
        assert {
            found[e].verdict for e in ("changing_light", "dynamic_objects", "moving_shadows", "moving_cameras")
        } == {"undetermined"}


class TestLookalikes:
    """What resembles an effect and is none of it."""

    def test_a_lamp_that_flickers_in_place_is_no_thing_that_moves(self, usual: SurveyInput) -> None:
        def flickers(pictures: np.ndarray) -> np.ndarray:
            lit = pictures.copy()
            lit[::2, 20:34, 30:44] = np.clip(lit[::2, 20:34, 30:44].astype(int) + 60, 0, 255)
            return lit

        found = decisions(_filmed(usual, flickers))
        assert found["dynamic_objects"].verdict == "off"

    def test_people_who_cover_half_of_the_room_do_not_change_its_light(self, usual: SurveyInput) -> None:
        def covered(pictures: np.ndarray) -> np.ndarray:
            dark = pictures.copy()
            dark[10:, :, : dark.shape[2] // 2] //= 3
            return dark

        films = [replace(f, pictures=covered(f.pictures), free=_left_taken(f.free)) for f in usual.films]
        assert decisions(replace(usual, films=films))["changing_light"].verdict == "off"

    def test_a_change_of_light_is_no_movement_shadow_or_gloss(self) -> None:
        found = decisions(scene(3, light=0.15))
        assert found["changing_light"].verdict == "on"
        assert {found[e].verdict for e in ("moving_cameras", "view_dependent_colour", "dynamic_objects")} == {"off"}
        assert found["moving_shadows"].verdict != "on"

    def test_a_lost_keypoint_leaves_a_leg_that_is_no_thing(self, usual: SurveyInput) -> None:
        films = []
        for film in usual.films:
            pictures = film.pictures.copy()
            for t, free in enumerate(film.free):
                rows, columns = np.nonzero(~free)
                if len(rows):
                    at = columns[rows.argmax()]
                    pictures[t, rows.max() + 1 : rows.max() + 12, max(at - 4, 0) : at + 4] = (20, 30, 160)
            films.append(replace(film, pictures=pictures))
        assert decisions(replace(usual, films=films))["dynamic_objects"].verdict == "off"


def test_what_one_camera_alone_sees_move_is_no_object():
    one, later = MovingRegion(3, 0.004, 0.0005), MovingRegion(20, 0.009, 0.0005)
    assert largest_moving([[one, later], [MovingRegion(5, 0.002, 0.0005)], None]).value == one.area
    assert largest_moving([[one, later], []]).value == 0
    assert largest_moving([[one, later], None]).value is None


class TestPairs:
    """Two effects at once are both found."""

    @pytest.mark.parametrize(
        "pair", [("exposure", "view_dependent_colour"), ("moving_shadows", "dynamic_objects")], ids="+".join
    )
    def test_both_are_found(self, pair: tuple[str, str]) -> None:
        found = decisions(scene(4, **PLANTED[pair[0]], **PLANTED[pair[1]]))
        assert [found[e].verdict for e in pair] == ["on", "on"]


def test_a_moving_camera_voids_what_rests_on_the_calibration() -> None:
    found = decisions(scene(5, **PLANTED["moving_cameras"], **PLANTED["exposure"]))
    assert found["exposure"].verdict == "undetermined"
    assert "cameras move" in found["exposure"].reason
    assert found["people"].verdict == "on"


def test_the_planted_size_is_what_is_measured() -> None:
    found = decisions(scene(6, lag_frames=0.5, readout=0.9, gain=1.04))
    # Gains have a geometric mean of 1, so the one that differs shows three quarters of it.
    assert found["exposure"].detail["gains"]["c1"][0] == pytest.approx(1.04**0.75, abs=0.004)
    found = decisions(scene(6, k1=0.06, shift_px=0.8))
    assert found["moving_cameras"].value == pytest.approx(0.8, abs=0.1)


def _filmed(material: SurveyInput, change: Callable[[np.ndarray], np.ndarray]) -> SurveyInput:
    return replace(material, films=[replace(f, pictures=change(f.pictures)) for f in material.films])


def _left_taken(free: np.ndarray) -> np.ndarray:
    taken = free.copy()
    taken[10:, :, : taken.shape[2] // 2 - 10] = False
    return taken
