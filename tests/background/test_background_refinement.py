# SPDX-License-Identifier: Apache-2.0
"""background: the views of the half-trained room, and a training that goes on with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.background.refinement import Refinement, looked_at_from, refined_targets, refinement_cameras
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import between, scene_centre
from studiorecon.images.transfer import Transfer
from studiorecon.scene.camera import Camera
from studiorecon.splatting.rendering import Rendering
from studiorecon.splatting.train.checkpoint import Checkpoint

from tests.made.background import WH, cameras, capture, look, run, settings
from tests.made.scene import ring

__all__ = ["cameras", "capture", "settings"]  # fixtures

ROUND = Refinement(40, 0.5, 0.15, 0.7, 150.0, Transfer(0.03, 0.5, 4.0, 0.0))


def heights_m(made: list[Camera]) -> np.ndarray:
    return np.array([camera.centre_m[2] for camera in made])


def middle_height_m(cameras: list[Camera]) -> float:
    return float(scene_centre(cameras)[2])


def test_u53_the_ring_rises_and_falls_twice_and_looks_at_the_middle(cameras: list[Camera]) -> None:
    made = refinement_cameras(cameras, ROUND)
    middle = np.mean([c.centre_m for c in cameras], axis=0)
    radius_m = np.linalg.norm((cameras[0].centre_m - middle)[:2])
    rise_m = heights_m(made) - heights_m(cameras).mean()
    assert np.abs(rise_m).max() == pytest.approx(0.15 * radius_m, rel=0.02)
    assert np.count_nonzero(np.diff(np.sign(np.roll(rise_m, 1) + 1e-9)) != 0) in (3, 4)  # two periods
    level = refinement_cameras(cameras, replace(ROUND, height=0.0))
    highest = int(rise_m.argmax())
    down_deg = np.degrees(np.arcsin(level[highest].forward[2]) - np.arcsin(made[highest].forward[2]))
    # 8.5 degrees for cameras that are level, less for these, which look down already; the wrong sign would look 17
    # degrees past.
    at_m = level[highest].centre_m[2] - middle_height_m(cameras)
    assert down_deg == pytest.approx(
        np.degrees(np.arctan2(at_m + rise_m.max(), radius_m) - np.arctan2(at_m, radius_m)), abs=0.3
    )
    assert 5 < down_deg < 8.6
    assert all(np.linalg.norm((c.centre_m - middle)[:2]) == pytest.approx(radius_m, rel=1e-6) for c in made)


def test_the_papers_views_lie_between_the_synthesized_ones(cameras: list[Camera]) -> None:
    """U53, appendix: 240 poses interpolated between 481, ±15 % of the radius up and down, the pitch made up for."""
    middle = scene_centre(cameras)
    path = []
    for one, other in zip(cameras, [*cameras[1:], cameras[0]]):
        path += between(one, other, 13, middle, rotations="slerp", clearance=0.0)[0]
    letter = replace(ROUND, views=24, path="views")
    made, level = (looked_at_from(cameras, path, settings) for settings in (letter, replace(letter, height=0.0)))
    assert len(made) == 24
    radius_m = np.median([np.linalg.norm((c.centre_m - middle)[:2]) for c in cameras])
    rise_m = heights_m(made) - heights_m(level)
    assert 0.13 * radius_m < np.abs(rise_m).max() <= 0.15 * radius_m
    assert (rise_m > 0).any()
    assert (rise_m < 0).any()
    np.testing.assert_allclose(level[0].camera_from_world, path[0].camera_from_world, atol=1e-9)
    np.testing.assert_allclose(level[-1].camera_from_world, path[-1].camera_from_world, atol=1e-9)
    for raised, straight, up_m in zip(made, level, rise_m):
        # On the chords of the path, not on a ring about the middle.
        np.testing.assert_allclose(raised.centre_m[:2], straight.centre_m[:2], atol=1e-9)
        turn = straight.rotation_camera_from_world @ raised.world_from_camera[:3, :3]
        np.testing.assert_allclose(turn[:, 0], [1, 0, 0], atol=1e-9)
        assert np.arctan2(turn[1, 2], turn[2, 2]) == pytest.approx(np.arctan2(up_m, radius_m), abs=1e-9)
        assert (raised.forward[2] < straight.forward[2]) == (up_m > 1e-9)
    assert min(np.linalg.norm((c.centre_m - middle)[:2]) for c in level) < 0.9 * radius_m
    with pytest.raises(UserError, match="there are 0 of them to look between"):
        looked_at_from(cameras, [], letter)


def test_cameras_on_an_arc_are_not_left() -> None:
    azimuths = np.degrees(
        [np.arctan2(*c.centre_m[1::-1]) for c in refinement_cameras(ring([0, 40, 80], "cam", wh=WH), ROUND)]
    )
    assert azimuths.min() >= -1
    assert azimuths.max() <= 81


def test_photos_teach_what_they_see_and_nothing_else(cameras: list[Camera]) -> None:
    """A room that is too dark by a tenth where photos see it; views get that back, holes and the unseen get no
    weight."""

    def dark(camera: Camera) -> Rendering:
        rgb, depth_m = look(camera)
        alpha = np.ones(camera.hw, np.float32)
        alpha[:5] = 0.5
        return Rendering((rgb - 0.1).astype(np.float32), alpha, depth_m)

    photos = [(c, look(c)[0], np.ones(c.hw, bool)) for c in cameras]
    made = refinement_cameras(cameras, replace(ROUND, views=5))
    targets, counted = refined_targets(made, photos, ROUND, dark)
    assert 0.3 < counted < 1
    for target in targets:
        assert not target.weight[:5].any()
        assert target.weight.max() <= 0.7 + 1e-6
        sure = target.weight > 0.6
        error = (target.rgb - look(target.camera)[0])[sure]
        assert np.median(np.abs(error)) < 0.02
        untouched = (target.weight == 0) & (np.arange(WH[1])[:, None] >= 5)
        assert np.abs((target.rgb - np.clip(dark(target.camera).rgb, 0, 1))[untouched]).max() < 1e-5
    none, _ = refined_targets(made, [(c, rgb, np.zeros(c.hw, bool)) for c, rgb, _ in photos], ROUND, dark)
    assert not any(target.weight.any() for target in none)


def test_a_refined_training_repeats_itself_and_goes_on_after_a_kill(
    settings, capture: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {
        "views": 6,
        "at": 0.5,
        "height": 0.15,
        "weight": 0.7,
        "ring_deg": 150.0,
        "transfer": {"depth_tolerance": 0.03, "angle_power": 0.5, "feather_px": 4.0, "smooth_px": 0.0},
    }
    wanted = settings(iterations=24, refinement=section)
    run(wanted, capture, tmp_path / "whole")
    run(settings(iterations=24), capture, tmp_path / "plain")
    whole = (tmp_path / "whole/scene.ply").read_bytes()
    assert whole != (tmp_path / "plain/scene.ply").read_bytes()
    saved = []

    def killed(self: Checkpoint, *snapshot: object) -> None:
        save(self, *snapshot)
        saved.append(snapshot[1]["iteration"])
        if len(saved) == 20:
            raise KeyboardInterrupt

    save = Checkpoint.save
    eager = replace(wanted, training=replace(wanted.training, checkpoint_every_s=1e-9))
    monkeypatch.setattr(Checkpoint, "save", killed)
    with pytest.raises(KeyboardInterrupt):
        run(eager, capture, tmp_path / "again")
    assert saved[-1] > 12  # in the second half
    run(eager, capture, tmp_path / "again")
    assert (tmp_path / "again/scene.ply").read_bytes() == whole
    assert not list((tmp_path / "again/.checkpoint").glob("*"))
