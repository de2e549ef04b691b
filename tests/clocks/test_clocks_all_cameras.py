# SPDX-License-Identifier: Apache-2.0
"""Cameras whose calibration is off by a degree tell the time together: they put each other right, and what still runs
ahead or behind is time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.clocks import offsets
from studiorecon.clocks.offset_consensus import Proposal
from studiorecon.clocks.offsets import joint_refinement
from studiorecon.clocks.rig_offsets import offsets_vs_rig
from studiorecon.clocks.timeline import Timeline
from studiorecon.footage.source import FootageSource
from studiorecon.scene.people import write_detections

from tests.made.silent import Rough, rough


def errors_s(seconds: np.ndarray, take: Rough) -> np.ndarray:
    """By how much the cameras are off against the first."""
    return seconds - seconds[0] - (take.start_s - take.start_s[0])


@pytest.mark.parametrize(("fps", "cameras", "seed"), [(30.0, 3, 3), (15.0, 5, 2), (60.0, 4, 3)])
def test_clocks_come_out_though_every_camera_stands_elsewhere(fps: float, cameras: int, seed: int) -> None:
    take = rough(seed, cameras, fps)
    assert np.ptp(take.start_s) > 0.1
    late = offsets_vs_rig(take.clocks, take.seen, take.lenses)
    assert late is not None
    off_s, half_s = errors_s(late.seconds, take), 1.96 * np.hypot(late.sigma_s, late.sigma_s[0])
    assert np.abs(off_s).max() < 0.02, off_s
    assert (np.abs(off_s) <= half_s).all(), (off_s, half_s)
    assert half_s.max() < 0.05


def test_clocks_that_are_right_are_confirmed_as_they_are() -> None:
    for seed in range(2):
        take = rough(seed, spread_s=0.0)
        late = offsets_vs_rig(take.clocks, take.seen, take.lenses)
        assert late is not None, seed
        told = np.isfinite(late.seconds)
        assert told.sum() >= 3, seed
        assert np.abs(late.seconds[told]).max() < 0.015, seed
        assert late.sigma_s[told].max() < 0.025, seed


def test_people_who_stand_still_tell_nothing() -> None:
    take = rough(1)
    still = [replace(d, keypoints=d.keypoints[:1].repeat(len(d.frame), axis=0)) for d in take.seen]
    late = offsets_vs_rig(take.clocks, still, take.lenses)
    assert late is None or np.isnan(late.seconds).all()


def test_two_cameras_tell_nothing_together_and_one_without_a_lens_is_not_told() -> None:
    take = rough(2)
    two = {name: take.lenses[name] for name in ("c0", "c1")}
    assert offsets_vs_rig(take.clocks, take.seen, two) is None
    three = {name: take.lenses[name] for name in ("c0", "c1", "c2")}
    late = offsets_vs_rig(take.clocks, take.seen, three)
    assert late is not None
    assert np.isnan([late.seconds[3], late.sigma_s[3]]).all()
    assert np.abs(errors_s(late.seconds, take)[:3]).max() < 0.025


def test_a_camera_of_another_take_is_not_told_and_does_not_shift_the_others() -> None:
    take, other = rough(1, 5), rough(7, 5)
    late = offsets_vs_rig(take.clocks, [*take.seen[:4], other.seen[4]], take.lenses)
    assert late is not None
    assert np.isnan(late.seconds[4])
    assert np.abs(errors_s(late.seconds, take)[:4]).max() < 0.025


def said(method: str, camera: int, off_s: float, half_s: float, take: Rough) -> Proposal:
    return Proposal(method, float(take.start_s[camera] - take.start_s[0]) + off_s, half_s, 0.0, np.inf)


def test_it_stands_in_place_of_what_people_told_two_by_two_but_not_of_sound_nor_of_what_is_sharper() -> None:
    take = rough(2)
    vague, sound = said("people", 1, 0.1, 0.16, take), said("sound", 2, 0.09, 0.12, take)
    sharp = said("people", 3, 0.0, 0.01, take)
    asked = joint_refinement([[], [vague], [sound], [sharp]], 0, take.clocks, take.seen, take.lenses)
    assert [[p.method for p in own] for own in asked] == [[], ["all cameras"], ["sound", "all cameras"], ["people"]]
    together = np.array([0.0, *(own[-1].offset_s for own in asked[1:])])
    assert np.abs(errors_s(together, take)).max() < 0.02


def test_clocks_that_are_known_are_not_asked_about_again(monkeypatch: pytest.MonkeyPatch) -> None:
    take = rough(1)
    sharp = [[]] + [[Proposal("sound", 0.1, 0.004, 0.0, np.inf)]] * 3
    monkeypatch.setattr("studiorecon.clocks.offsets.offsets_vs_rig", lambda *_: pytest.fail("asked"))
    assert joint_refinement(sharp, 0, take.clocks, take.seen, take.lenses) == sharp


def test_the_step_asks_all_cameras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    take = rough(2)
    monkeypatch.setattr(offsets, "read_sound", lambda _: None)
    monkeypatch.setattr(offsets.sync, "read_motion_energy", lambda _: np.zeros(0))
    # What two by two cannot tell.
    monkeypatch.setattr(offsets, "people_pair", lambda *_: ([], {}))
    names = [clock.camera for clock in take.clocks]
    paths = [tmp_path / f"{name}.npz" for name in names]
    for seen, path in zip(take.seen, paths, strict=True):
        write_detections(path, seen)
    sources = [FootageSource(path, (640, 360), 30.0, 120, 0, (), ()) for path in paths]
    lines = [Timeline(30.0, 120, 0.0)] * 4
    lenses = {name: lens for name, (lens, _) in take.lenses.items()}
    verdicts, told, reference = offsets.estimate_clocks(names, sources, lines, paths, paths, lenses)
    assert reference == 0
    assert [v.method for v in verdicts[1:]] == ["all cameras"] * 3
    assert np.abs(errors_s(np.array([v.offset_s for v in verdicts]), take)).max() < 0.02
    assert all("all cameras" in f["sentence"] for f in told[1:])
