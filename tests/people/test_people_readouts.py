# SPDX-License-Identifier: Apache-2.0
"""Rows that look one after the other: found from people who walk, not invented, and taken out of their keypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.keypoints.resampling import correct_rolling_shutter
from studiorecon.people import associate as step
from studiorecon.people.fitting.readouts import estimate_readouts
from studiorecon.rig.body_points import Tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.people import Detections, write_detections, write_identities
from studiorecon.scene.readouts import read_readouts

from tests.made.studio_world import FPS, FRAMES, Plan, cameras_of, seen_keypoints

PLANTED_S = 0.9 / FPS


def walked(seed: int, **planted: object) -> tuple[Tracks, list[Camera]]:
    plan = replace(Plan(), **planted)
    cameras = cameras_of(plan)
    return seen_keypoints(plan, seed, cameras), cameras


@pytest.mark.parametrize("seed", range(6))
def test_a_planted_readout_is_found_in_its_camera_alone(seed: int) -> None:
    seen, cameras = walked(seed, readout=0.9)
    reported = estimate_readouts(seen.pixels, cameras, FPS)
    assert [one.camera for one in reported if one.used_s] == [cameras[-1].name], reported
    assert reported[-1].used_s == pytest.approx(PLANTED_S, abs=max(4 * (reported[-1].sigma_s or 0), 0.1 * PLANTED_S))


@pytest.mark.parametrize("planted", [{}, {"lag_frames": 0.5}, {"k1": 0.06}, {"speed_m_s": 0.02, "readout": 0.9}])
def test_nothing_is_moved_that_another_cause_explains(planted: dict) -> None:
    for seed in range(6):
        seen, cameras = walked(seed, **planted)
        reported = estimate_readouts(seen.pixels, cameras, FPS)
        assert not any(one.used_s for one in reported), reported
        assert all(one.reason for one in reported)


def test_a_time_that_no_sensor_takes_is_not_believed() -> None:
    seen, cameras = walked(2, readout=1.5)
    assert "no sensor takes that long" in estimate_readouts(seen.pixels, cameras, FPS)[-1].reason


def test_nobody_tells_nothing() -> None:
    reported = estimate_readouts(np.full((4, 0, 10, 25, 2), np.nan), cameras_of(Plan()), FPS)
    assert {(one.readout_s, one.used_s) for one in reported} == {(None, 0.0)}


def test_the_step_finds_it_and_keypoints_come_back_to_where_they_were(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen, cameras = walked(3, readout=0.9)
    straight, _ = walked(3)
    files = []
    for view, camera in enumerate(cameras):
        keypoints = np.concatenate([seen.pixels[view, 0], seen.confidence[view, 0][..., None]], axis=-1)
        one = Detections(camera.name, "body_25", np.arange(FRAMES), np.zeros(FRAMES, int), keypoints)
        files.append(tmp_path / f"{camera.name}.npz")
        write_detections(files[-1], one)
    write_model(tmp_path, cameras)
    footage = [
        Footage(c.name, False, c.wh, c.intrinsics.tolist(), FPS, FRAMES, 0, "x", "", c.wh, 0, 0.0, []) for c in cameras
    ]
    write_manifest(tmp_path / "manifest.json", Manifest("walk", FPS, FRAMES, tuple(footage)))
    write_identities(tmp_path / "corrected.tsv", {(c.name, 0): "p0" for c in cameras})
    step.run(
        step.Settings(),
        model=tmp_path / "images.txt",
        manifest=tmp_path / "manifest.json",
        detections=files,
        videos=[],
        corrected=[tmp_path / "corrected.tsv"],
        people=tmp_path / "people.tsv",
        identities=tmp_path / "identities.tsv",
        association=tmp_path / "association.json",
        who=tmp_path / "who",
    )
    took_s = read_readouts(tmp_path / "who/readouts.json")
    assert f"{cameras[-1].name} has a rolling shutter of" in capsys.readouterr().out
    assert not any(took_s[c.name] for c in cameras[:-1])
    moved = correct_rolling_shutter(one, took_s[cameras[-1].name], cameras[-1].wh[1], FPS)
    wanted = straight.pixels[-1, 0]
    both = np.isfinite(wanted).all(-1) & np.isfinite(one.keypoints[..., :2]).all(-1)
    before, after = (np.abs(d.keypoints[..., :2] - wanted)[both].mean() for d in (one, moved))
    assert after < 0.6 * before, (before, after)
    assert correct_rolling_shutter(one, 0.0, 100, FPS) is one
