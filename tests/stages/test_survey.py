# SPDX-License-Identifier: Apache-2.0
"""Survey: planted effects are found, absent ones are not, and what cannot be known is called undetermined."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.images.exr import write_depth
from studiorecon.images.plate import write_plate
from studiorecon.images.video import write_lossless
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.colmap import write_model
from studiorecon.scene.decisions import ORDER, Decision, forced, read_decisions, switched_on, write_decisions
from studiorecon.scene.people import write_identities, write_people
from studiorecon.scene.shell import Shell, write_shell
from studiorecon.settings import load
from studiorecon.survey import decide as step
from studiorecon.survey.coverage import decide_ring, decide_views, from_two_sides, largest_gap_deg, seen_by, stage, stage_points
from studiorecon.survey.effects import decide_people
from studiorecon.survey.exposures import View, decide_exposure
from studiorecon.survey.films import halved, read_film, run_starts

WH = (96, 64)


def ring(azimuths_deg: list[float], radius_m: float = 3.0, wh: tuple[int, int] = WH, focal_px: float = 60.0) -> list[Camera]:
    """Cameras 1.5 m high that look at a point 1 m above the origin."""
    cameras = []
    for index, azimuth in enumerate(np.radians(azimuths_deg)):
        centre = np.array([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), 1.5])
        forward = np.array([0, 0, 1.0]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ centre
        intrinsics = np.array([[focal_px, 0, wh[0] / 2], [0, focal_px, wh[1] / 2], [0, 0, 1]])
        cameras.append(Camera(f"c{index}", wh, intrinsics, pose))
    return cameras


def floor_view(camera: Camera, gain: float | tuple = 1.0, noise: float = 0.0, seed: int = 0) -> View:
    """The floor z = 0 with a soft pattern, seen by a camera of the given exposure."""
    origin, rays = camera.rays()
    down = rays[..., 2] < -1e-6
    depth_m = np.where(down, -origin[2] / np.where(down, rays[..., 2], -1.0), 0.0)
    points = origin + depth_m[..., None] * rays
    pattern = 0.4 + 0.1 * np.sin(2 * points[..., :1] + np.array([0, 1, 2])) * np.cos(1.5 * points[..., 1:2])
    rgb = pattern * np.asarray(gain) + np.random.default_rng(seed).normal(0, noise, (*camera.hw, 3))
    return View(camera, rgb.astype(np.float32), np.ones(camera.hw, bool), np.where(depth_m < 20, depth_m, 0).astype(np.float32))


@pytest.fixture
def settings(default_settings) -> step.Settings:
    return load(step.Settings, default_settings("survey"), "survey")


class TestPeople:
    def test_somebody_nobody_and_an_empty_room(self) -> None:
        assert (decide_people(["p0", "p1"]).verdict, decide_people(["p0", "p1"]).value) == ("on", 2.0)
        assert decide_people([]).verdict == "off"
        assert "dataset says" in decide_people(None).reason


class TestCoverage:
    def test_the_stage_is_where_the_cameras_look(self) -> None:
        centre, radius_m = stage(ring([0, 90, 180, 270]))
        np.testing.assert_allclose(centre, 0, atol=1e-9)
        assert radius_m == pytest.approx(3.0)

    @pytest.mark.parametrize(("azimuths", "gap"), [([0, 90, 180, 270], 90), ([0, 60, 120], 240), ([10], 360), ([350, 10, 180], 170)])
    def test_the_largest_gap(self, azimuths: list[float], gap: float) -> None:
        assert largest_gap_deg(ring(azimuths)) == pytest.approx(gap, abs=1.0)

    def test_walls_hide_what_is_behind_them(self) -> None:
        camera = ring([0])[0]
        points = camera.unproject(np.array([[48.0, 32.0]] * 3), np.array([1.0, 2.0, 4.0]))
        wall = np.full(camera.hw, 2.0, np.float32)
        assert seen_by(points, [camera], [wall], 0.05)[0].tolist() == [True, True, False]
        assert seen_by(points, [camera], [0 * wall], 0.05)[0].all()
        assert not seen_by(camera.unproject(np.array([[-5.0, 3.0]]), np.ones(1)), [camera], [wall], 0.05).any()

    def test_two_cameras_side_by_side_are_one_side(self) -> None:
        cameras = ring([0, 0.5, 90])
        seen = np.array([[True], [True], [False]])
        assert not from_two_sides(np.array([[0, 0, 1.0]]), cameras, seen, 2.0).any()
        assert from_two_sides(np.array([[0, 0, 1.0]]), cameras, np.ones((3, 1), bool), 2.0).all()

    def test_four_cameras_need_views_between_and_a_dense_ring_does_not(self, settings: step.Settings) -> None:
        def verdict(azimuths: list[float], was_on: bool = False) -> str:
            cameras = ring(azimuths, focal_px=40)
            return decide_views(
                cameras, [np.zeros(c.hw, np.float32) for c in cameras], grid_m=settings.grid_m, height_m=settings.height_m,
                tolerance=settings.depth_tolerance, gap_deg=settings.gap_deg, threshold=settings.thresholds["view_synthesis"],
                was_on=was_on,
            ).verdict  # fmt: skip

        assert verdict([0, 90, 180, 270]) == "on"
        assert verdict(list(range(0, 360, 20))) == "off"
        # A gap of 33 degrees lies between 0.8 times the threshold and the threshold.
        almost = list(np.arange(0, 360, 360 / 11))
        assert (verdict(almost), verdict(almost, was_on=True)) == ("off", "on")

    @pytest.mark.parametrize(("azimuths", "verdict"), [([0, 90, 180, 270], "on"), ([0, 45, 90], "off")])
    def test_a_ring_is_closed_and_an_arc_is_not(self, azimuths: list[float], verdict: str) -> None:
        assert decide_ring(ring(azimuths), 150.0).verdict == verdict

    def test_parallel_cameras_have_a_stage(self) -> None:
        cameras = ring([0, 0.0])
        assert np.isfinite(stage(cameras)[0]).all()
        assert len(stage_points(cameras, 0.5, 2.0)) >= 0


class TestExposure:
    def test_a_planted_gain_is_found_and_equal_cameras_are_left_alone(self) -> None:
        cameras = ring([0, 90, 180, 270])
        right = wrong = 0
        for seed in range(20):
            views = [floor_view(c, noise=0.02, seed=10 * seed + k) for k, c in enumerate(cameras)]
            wrong += decide_exposure(views, 0.05, 0.01)[0].verdict == "on"
            views[2] = floor_view(cameras[2], gain=1.03, noise=0.02, seed=10 * seed + 7)
            decision = decide_exposure(views, 0.05, 0.01)[0]
            right += decision.verdict == "on" and decision.reason.startswith("c2")
        assert (right, wrong) == (20, 0)

    def test_a_colour_cast_counts_as_exposure(self) -> None:
        views = [floor_view(c, gain=(1.0, 1.0, 1.06) if k == 1 else 1.0) for k, c in enumerate(ring([0, 90, 180]))]
        assert decide_exposure(views, 0.05, 0.01)[0].verdict == "on"

    def test_cameras_that_share_nothing_are_undetermined(self) -> None:
        blind = [View(v.camera, v.rgb, v.measured, 0 * v.depth_m) for v in map(floor_view, ring([0, 180]))]
        decision = decide_exposure(blind, 0.05, 0.01)[0]
        assert (decision.verdict, decision.value) == ("undetermined", None)


class TestDecisions:
    def test_they_can_be_forced(self) -> None:
        made = [Decision("exposure", "s", 1.5, None, 1.0, "on", "because")]
        (decision,) = forced(made, {"exposure": "off", "injection": "on"})
        assert decision.verdict == "off"
        assert "measured on" in decision.reason
        with pytest.raises(Refusal, match=r"effects are .*exposure"):
            forced(made, {"weather": "off"})

    def test_the_next_survey_knows_what_was_on_but_not_what_was_forced(self, tmp_path: Path) -> None:
        assert switched_on(tmp_path / "decisions.json") == frozenset()
        made = [Decision(e, "s", 1.5, None, 1.0, v, "r") for e, v in (("exposure", "on"), ("hands", "off"), ("face", "on"))]
        write_decisions(tmp_path / "decisions.json", forced(made, {"face": "on"}))
        assert switched_on(tmp_path / "decisions.json") == {"exposure"}


@pytest.fixture
def files(tmp_path: Path) -> dict:
    """What the step reads: three cameras that look at a floor for twelve frames, and one person without keypoints."""
    cameras = ring([0, 120, 240])
    write_model(tmp_path / "cameras", cameras)
    footage = tuple(Footage(c.name, False, c.wh, c.intrinsics.tolist(), 30.0, 12, 0, "v", "", c.wh, 0, 0.0, []) for c in cameras)
    write_manifest(tmp_path / "manifest.json", Manifest("s", 30.0, 12, footage))
    write_people(tmp_path / "people.tsv", [("p0", 5, "c0,c1", 1.0, "keypoints")])
    write_identities(tmp_path / "identities.tsv", {})
    write_shell(tmp_path / "shell.json", Shell(0.0, np.array([-4, -4, 0.0]), np.array([4, 4, 3.0]), np.ones(6, bool), np.ones(6)))
    rng = np.random.default_rng(0)
    for view in map(floor_view, cameras):
        picture = np.rint(view.rgb * 255)
        write_plate(tmp_path / f"{view.camera.name}.png", picture.astype(np.uint8), view.measured)
        write_depth(tmp_path / f"{view.camera.name}.exr", view.depth_m, np.ones(view.camera.hw, np.float32))
        noisy = [np.clip(picture + np.rint(rng.normal(0, 1, picture.shape)), 0, 255).astype(np.uint8) for _ in range(12)]
        write_lossless(tmp_path / f"{view.camera.name}.mkv", noisy, 30.0)
    named = {key: [tmp_path / f"{c.name}.{end}" for c in cameras] for key, end in (("videos", "mkv"), ("plates", "png"), ("depths", "exr"))}
    return named | {
        "manifest": tmp_path / "manifest.json", "model": tmp_path / "cameras/images.txt", "people": [tmp_path / "people.tsv"],
        "identities": [tmp_path / "identities.tsv"], "detections": [], "shell": tmp_path / "shell.json",
        "decisions": tmp_path / "survey/decisions.json", "gains": tmp_path / "survey/gains.json", "course": tmp_path / "survey/course.json",
        "gloss": tmp_path / "survey/gloss.json",
    }  # fmt: skip


class TestStep:
    def test_every_effect_has_a_decision_with_its_reason(self, files: dict, settings: step.Settings) -> None:
        step.run(settings, **files)
        found = read_decisions(files["decisions"])
        assert list(found) == list(ORDER)
        assert all(d.reason and d.statistic and d.calibration == "uncalibrated" for d in found.values())
        told = {"people": "on", "view_synthesis": "on", "closed_path": "on", "exposure": "off", "sync_offset": "undetermined"}
        assert {effect: found[effect].verdict for effect in told} == told
        assert "trained.json" in found["injection"].reason
        assert found["view_synthesis"].obeyed_by
        assert not found["hands"].obeyed_by

    def test_every_effect_can_be_forced_both_ways(self, files: dict, settings: step.Settings) -> None:
        for verdict in ("on", "off"):
            step.run(replace(settings, force=dict.fromkeys(ORDER, verdict)), **files)
            assert {(d.verdict, d.forced) for d in read_decisions(files["decisions"]).values()} == {(verdict, True)}
        step.run(settings, **files)
        assert read_decisions(files["decisions"])["exposure"].verdict == "off", "a lifted force leaves no trace"

    def test_same_input_same_bytes(self, files: dict, settings: step.Settings) -> None:
        step.run(settings, **files)
        once = files["decisions"].read_bytes()
        step.run(settings, **files)
        assert files["decisions"].read_bytes() == once

    def test_a_room_that_is_known_to_be_empty(self, files: dict, settings: step.Settings) -> None:
        step.run(settings, **files | {"people": [], "identities": []})
        found = read_decisions(files["decisions"])
        assert found["people"].verdict == "off"
        assert found["hands"].verdict == "undetermined"

    def test_a_missing_film_is_refused(self, files: dict, settings: step.Settings) -> None:
        with pytest.raises(Refusal, match="3 training cameras, but 2 videos"):
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
        small = halved(film)
        assert (small.pictures.shape, small.scale) == ((6, 16, 24, 3), 4.0)

    def test_fast_footage_is_looked_at_thirty_times_a_second(self, files: dict) -> None:
        film = read_film(files["videos"][0], ring([0, 120, 240])[0], 12, 60.0, None, pictures=4, run=2, longest_px=48)
        assert film.times.tolist() == [0, 2, 8, 10]
        assert film.runs == [slice(0, 2), slice(2, 4)]
        assert len(film.pictures) == 4
