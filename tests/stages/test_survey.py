# SPDX-License-Identifier: Apache-2.0
"""Survey: planted effects are found, absent ones are not, and what cannot be known is called undetermined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.images.exr import write_depth
from studiorecon.images.plate import write_plate
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.colmap import write_model
from studiorecon.scene.decisions import Decision, forced, read_decisions, write_decisions
from studiorecon.scene.people import write_people
from studiorecon.settings import load
from studiorecon.survey import decide as step
from studiorecon.survey.coverage import from_two_sides, largest_gap_deg, seen_by, stage, stage_points
from studiorecon.survey.exposures import View

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
        assert (step.decide_people(["p0", "p1"]).verdict, step.decide_people(["p0", "p1"]).value) == ("on", 2.0)
        assert step.decide_people([]).verdict == "off"
        assert "dataset says" in step.decide_people(None).reason


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
        def decide(azimuths: list[float]) -> dict[str, Decision]:
            cameras = ring(azimuths, focal_px=40)
            return {d.effect: d for d in step.decide_views(cameras, [np.zeros(c.hw, np.float32) for c in cameras], settings)}

        assert decide([0, 90, 180, 270])["view_synthesis"].verdict == "on"
        assert decide(list(range(0, 360, 20)))["view_synthesis"].verdict == "off"
        assert decide([0, 90, 180, 270])["closed_path"].verdict == "on"
        assert decide([0, 45, 90])["closed_path"].verdict == "off"

    def test_parallel_cameras_have_a_stage(self) -> None:
        cameras = ring([0, 0.0])
        assert np.isfinite(stage(cameras)[0]).all()
        assert len(stage_points(cameras, 0.5, 2.0)) >= 0


class TestExposure:
    def test_a_planted_gain_is_found_and_equal_cameras_are_left_alone(self, settings: step.Settings) -> None:
        cameras = ring([0, 90, 180, 270])
        right = wrong = 0
        for seed in range(20):
            views = [floor_view(c, noise=0.02, seed=10 * seed + k) for k, c in enumerate(cameras)]
            wrong += step.decide_exposure(views, settings).verdict != "off"
            views[2] = floor_view(cameras[2], gain=1.03, noise=0.02, seed=10 * seed + 7)
            decision = step.decide_exposure(views, settings)
            right += decision.verdict == "on" and decision.reason.startswith("c2")
        assert (right, wrong) == (20, 0)

    def test_a_colour_cast_counts_as_exposure(self, settings: step.Settings) -> None:
        views = [floor_view(c, gain=(1.0, 1.0, 1.06) if k == 1 else 1.0) for k, c in enumerate(ring([0, 90, 180]))]
        assert step.decide_exposure(views, settings).verdict == "on"

    def test_cameras_that_share_nothing_are_undetermined(self, settings: step.Settings) -> None:
        blind = [View(v.camera, v.rgb, v.measured, 0 * v.depth_m) for v in map(floor_view, ring([0, 180]))]
        decision = step.decide_exposure(blind, settings)
        assert (decision.verdict, decision.value) == ("undetermined", None)


class TestDecisions:
    def test_they_survive_their_file(self, tmp_path: Path) -> None:
        made = [Decision("a", "s", 1.5, (1.0, 2.0), 1.0, "on", "r"), Decision("b", "s", None, None, None, "undetermined", "r")]
        write_decisions(tmp_path / "decisions.json", made)
        assert list(read_decisions(tmp_path / "decisions.json").values()) == made

    def test_they_can_be_forced(self) -> None:
        made = [Decision("a", "s", 1.5, None, 1.0, "on", "because")]
        (decision,) = forced(made, {"a": "off"})
        assert decision.verdict == "off"
        assert "measured on" in decision.reason
        with pytest.raises(Refusal, match="effects are a"):
            forced(made, {"b": "off"})


def test_the_step_writes_its_decisions(tmp_path: Path, settings: step.Settings) -> None:
    cameras = ring([0, 120, 240])
    write_model(tmp_path / "cameras", cameras)
    footage = tuple(Footage(c.name, False, c.wh, c.intrinsics.tolist(), 30.0, 5, 0, "v", "", c.wh, 0, 0.0, []) for c in cameras)
    write_manifest(tmp_path / "manifest.json", Manifest("s", 30.0, 5, footage))
    write_people(tmp_path / "people.tsv", [("p0", 5, "c0,c1", 1.0, "keypoints")])
    for view in map(floor_view, cameras):
        write_plate(tmp_path / f"{view.camera.name}.png", np.rint(view.rgb * 255).astype(np.uint8), view.measured)
        write_depth(tmp_path / f"{view.camera.name}.exr", view.depth_m, np.ones(view.camera.hw, np.float32))
    plates, depths = ([tmp_path / f"{c.name}.{suffix}" for c in cameras] for suffix in ("png", "exr"))
    model, manifest, out = tmp_path / "cameras/images.txt", tmp_path / "manifest.json", tmp_path / "decisions.json"
    step.run(settings, manifest, model, [tmp_path / "people.tsv"], plates, depths, out)
    found = {effect: d.verdict for effect, d in read_decisions(out).items()}
    assert found == {"people": "on", "view_synthesis": "on", "closed_path": "on", "exposure": "off"}
    step.run(settings, manifest, model, [], plates, depths, out)
    assert read_decisions(out)["people"].verdict == "off"
