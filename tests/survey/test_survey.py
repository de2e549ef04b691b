# SPDX-License-Identifier: Apache-2.0
"""Survey: planted effects are detected, absent ones are not, and the rest is undetermined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import gaps_around
from studiorecon.rig.body_points import person_tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision, apply_forced, read_decisions
from studiorecon.scene.room import Platform, read_room, write_room
from studiorecon.survey import decide as step
from studiorecon.survey.clips import halve_film, read_film, run_starts
from studiorecon.survey.coverage import has_parallax, stage_disc, visible_points
from studiorecon.survey.effect_decisions import decide_effect as of_effect
from studiorecon.survey.effects import CLOSED_PATH, EARLY, EFFECTS, EXPOSURE, PEOPLE, VIEW_SYNTHESIS
from studiorecon.survey.evidence import Evidence, SurveyInput
from studiorecon.survey.exposures import ExposureView

from tests.made.survey import WH, decided, files, floor_view, ring, settings  # noqa: F401


def blank(camera: Camera) -> ExposureView:
    """A camera whose depth is unknown, which hides nothing."""
    zero = np.zeros(camera.hw, np.float32)
    return ExposureView(camera, np.zeros((*camera.hw, 3), np.float32), zero > 0, zero)


class TestPeople:
    def test_somebody_nobody_and_an_empty_room(self, settings: step.Settings) -> None:
        two = decided(PEOPLE, settings, [], ["p0", "p1"])
        assert (two.verdict, two.value) == ("on", 2.0)
        assert decided(PEOPLE, settings, [], []).verdict == "off"
        assert "dataset states" in decided(PEOPLE, settings, []).reason


class TestCoverage:
    def test_the_stage_is_where_the_cameras_look(self) -> None:
        centre, radius_m = stage_disc(ring([0, 90, 180, 270]))
        np.testing.assert_allclose(centre, 0, atol=1e-9)
        assert radius_m == pytest.approx(3.0)

    @pytest.mark.parametrize(
        ("azimuths", "wanted"), [([0, 90, 180, 270], 90), ([0, 60, 120], 240), ([10], 360), ([350, 10, 180], 170)]
    )
    def test_the_largest_gap(self, azimuths: list[float], wanted: float) -> None:
        assert np.degrees(max(gap.rad for gap in gaps_around(ring(azimuths)))) == pytest.approx(wanted, abs=1.0)

    def test_walls_hide_what_is_behind_them(self) -> None:
        camera = ring([0])[0]
        points = camera.unproject(np.array([[48.0, 32.0]] * 3), np.array([1.0, 2.0, 4.0]))
        wall = np.full(camera.hw, 2.0, np.float32)
        assert visible_points(points, [camera], [wall], 0.05)[0].tolist() == [True, True, False]
        assert visible_points(points, [camera], [0 * wall], 0.05)[0].all()
        assert not visible_points(camera.unproject(np.array([[-5.0, 3.0]]), np.ones(1)), [camera], [wall], 0.05).any()

    def test_two_cameras_side_by_side_are_one_side(self) -> None:
        cameras = ring([0, 0.5, 90])
        seen = np.array([[True], [True], [False]])
        assert not has_parallax(np.array([[0, 0, 1.0]]), cameras, seen, 2.0).any()
        assert has_parallax(np.array([[0, 0, 1.0]]), cameras, np.ones((3, 1), bool), 2.0).all()

    def test_four_cameras_need_views_between_and_a_dense_ring_does_not(self, settings: step.Settings) -> None:
        def verdict(azimuths: list[float]) -> str:
            views = [blank(camera) for camera in ring(azimuths, focal_px=40)]
            return decided(VIEW_SYNTHESIS, settings, views).verdict

        assert verdict([0, 90, 180, 270]) == "on"
        assert verdict(list(range(0, 360, 20))) == "off"

    def test_every_gap_between_neighbours_is_decided_by_itself(self, settings: step.Settings) -> None:
        """Cameras close together except for two gaps, of 33 and of 80 degrees."""
        cameras = ring([0, 20, 40, 60, 93, 173, 193, 213, 233, 253, 273, 293, 313, 333], focal_px=40)
        views = [blank(camera) for camera in cameras]
        nobody = person_tracks([], {}, [], 0, 0.0)
        evidence = Evidence(SurveyInput(cameras, None, views, [], nobody, 0.0, 30.0), settings)

        found = of_effect(VIEW_SYNTHESIS, evidence, VIEW_SYNTHESIS.threshold)
        parts = found.detail["parts"]
        assert found.value == max(part["value"] for part in parts.values())
        assert {name for name, part in parts.items() if part["verdict"] == "on"} == {"04"}

    def test_the_widest_gap_is_named(self, settings: step.Settings) -> None:
        assert decided(CLOSED_PATH, settings, [blank(c) for c in ring([0, 45, 90])]).detail == {"widest": "02"}

    @pytest.mark.parametrize(("azimuths", "verdict"), [([0, 90, 180, 270], "on"), ([0, 45, 90], "off")])
    def test_a_ring_is_closed_and_an_arc_is_not(
        self, azimuths: list[float], verdict: str, settings: step.Settings
    ) -> None:
        assert decided(CLOSED_PATH, settings, [blank(c) for c in ring(azimuths)]).verdict == verdict


class TestExposure:
    def test_a_planted_gain_is_found_and_equal_cameras_are_left_alone(self, settings: step.Settings) -> None:
        cameras = ring([0, 90, 180, 270])
        right = wrong = 0
        for seed in range(20):
            views = [floor_view(c, noise=0.02, seed=10 * seed + k) for k, c in enumerate(cameras)]
            wrong += decided(EXPOSURE, settings, views).verdict == "on"
            views[2] = floor_view(cameras[2], gain=1.03, noise=0.02, seed=10 * seed + 7)
            decision = decided(EXPOSURE, settings, views)
            right += decision.verdict == "on" and decision.reason.startswith("c2")
        assert (right, wrong) == (20, 0)

    def test_a_colour_cast_counts_as_exposure(self, settings: step.Settings) -> None:
        views = [floor_view(c, gain=(1.0, 1.0, 1.06) if k == 1 else 1.0) for k, c in enumerate(ring([0, 90, 180]))]
        assert decided(EXPOSURE, settings, views).verdict == "on"

    def test_cameras_that_share_nothing_are_undetermined(self, settings: step.Settings) -> None:
        blind = [ExposureView(v.camera, v.rgb, v.measured, 0 * v.depth_m) for v in map(floor_view, ring([0, 180]))]
        decision = decided(EXPOSURE, settings, blind)
        assert (decision.verdict, decision.value) == ("undetermined", None)


class TestDecisions:
    def test_they_can_be_forced(self) -> None:
        made = [Decision("exposure", "s", 1.5, None, 1.0, "on", "because")]
        (decision,) = apply_forced(made, {"exposure": "off"})
        assert decision.verdict == "off"
        assert "measured on" in decision.reason
        with pytest.raises(UserError, match=r"effects decided here are .*exposure"):
            apply_forced(made, {"weather": "off"})


class TestStep:
    def test_every_effect_has_a_decision_with_its_reason(self, files: dict, settings: step.Settings) -> None:
        step.run(settings, **files)
        found = read_decisions(files["decisions"])
        assert list(found) == [effect.name for effect in EFFECTS]
        assert all(d.reason and d.statistic and d.calibration == "uncalibrated" for d in found.values())
        reported = {"people": "on", "view_synthesis": "on", "closed_path": "on", "exposure": "off"}
        assert {effect: found[effect].verdict for effect in reported} == reported
        assert "report/audit.json" in found["injection"].reason
        assert found["view_synthesis"].used_by
        assert not found["defocus"].used_by

    def test_every_effect_that_acts_can_be_forced_both_ways(self, files: dict, settings: step.Settings) -> None:
        for verdict in ("on", "off"):
            acting = {effect.name for effect in EARLY if effect.acts}
            step.run(replace(settings, force=dict.fromkeys(acting, verdict)), **files)
            made = read_decisions(files["decisions"])
            assert {(made[name].verdict, made[name].forced) for name in acting} == {(verdict, True)}
            assert not any(decision.forced for name, decision in made.items() if name not in acting)
        step.run(settings, **files)
        assert read_decisions(files["decisions"])["exposure"].verdict == "off", "a lifted force leaves no trace"

    def test_cameras_that_are_said_to_move_or_to_stand_still_are_believed(
        self, files: dict, settings: step.Settings
    ) -> None:
        for verdict, exposure in (("on", "undetermined"), ("off", "off")):
            step.run(replace(settings, force={"moving_cameras": verdict}), **files)
            assert read_decisions(files["decisions"])["exposure"].verdict == exposure

    def test_a_room_that_is_known_to_be_empty(self, files: dict, settings: step.Settings) -> None:
        step.run(settings, **files | {"people": [], "identities": []})
        found = read_decisions(files["decisions"])
        assert found["people"].verdict == "off"
        assert found["moving_shadows"].verdict == "undetermined"

    def test_the_floor_is_where_people_stand(
        self, files: dict, settings: step.Settings, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Shadows of people on a platform fall on it, not on the room's floor below."""
        box, heights_m = read_room(files["room_box"]), []
        monkeypatch.setattr(step, "SurveyInput", lambda *given: heights_m.append(given[5]) or SurveyInput(*given))
        for platform in (None, Platform(box.low_m[:2], box.high_m[:2], 0.3)):
            write_room(files["room_box"], replace(box, platform=platform))
            step.run(settings, **files)
        assert heights_m == [0.0, 0.3]

    def test_a_missing_film_is_refused(self, files: dict, settings: step.Settings) -> None:
        with pytest.raises(UserError, match="2 videos, 3 plates"):
            step.run(settings, **files | {"videos": files["videos"][:2]})


class TestFilms:
    def test_runs_are_spread_over_the_clip_and_begin_with_it(self) -> None:
        assert run_starts(1000, 60, 12) == [0, 247, 494, 741, 988]
        assert run_starts(5, 60, 12) == [0]
        assert run_starts(60, 60, 12) == [0, 12, 24, 36, 48]

    def test_pictures_shrink_and_runs_are_found_again(self, files: dict) -> None:
        camera = ring([0, 120, 240])[0]
        film = read_film(files["videos"][0], camera, 12, 30.0, None, pictures=6, run=2, longest_px=48)
        assert film.times.tolist() == [0, 1, 5, 6, 10, 11]
        assert film.runs == [slice(0, 2), slice(2, 4), slice(4, 6)]
        assert (film.pictures.shape, film.scale, film.free.all()) == ((6, 32, 48, 3), 2.0, True)
        small = halve_film(film)
        assert (small.pictures.shape, small.scale) == ((6, 16, 24, 3), 4.0)

    def test_fast_footage_is_looked_at_thirty_times_a_second(self, files: dict) -> None:
        film = read_film(files["videos"][0], ring([0, 120, 240])[0], 12, 60.0, None, pictures=4, run=2, longest_px=48)
        assert film.times.tolist() == [0, 2, 8, 10]
        assert film.runs == [slice(0, 2), slice(2, 4)]
        assert len(film.pictures) == 4
