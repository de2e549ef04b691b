# SPDX-License-Identifier: Apache-2.0
"""Clocks of calibrated cameras made exact together: fractions of frames in films of two seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.clocks import people_clock
from studiorecon.clocks.agreement import Pair, solved
from studiorecon.clocks.calibrated_lag import CalibratedPair
from studiorecon.clocks.people_clock import people_pair
from studiorecon.clocks.together import together
from studiorecon.scene.camera import Lens
from studiorecon.scene.clocks import Clock

from tests.made.cameras import ring
from tests.made.silent import Silent, sighted

FPS, SECONDS = 30.0, 2.0
CAMERAS = ring()[:3]
LENSES = {
    c.name: (Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)), c.wh)
    for c in CAMERAS
}
GEOMETRY = {
    (a, b): CalibratedPair.of(LENSES[CAMERAS[a].name][0], LENSES[CAMERAS[b].name][0])
    for a, b in ((0, 1), (0, 2), (1, 2))
}


def told(later_frames: Sequence[float], draw: int) -> list[Pair]:
    """What two people tell of three cameras of which the last two began so many frames later."""
    own_s = np.arange(round(SECONDS * FPS)) / FPS
    films = [Silent(c, 20.0 + late / FPS, own_s) for c, late in zip(CAMERAS, [0.0, *later_frames], strict=True)]
    rng = np.random.default_rng(draw)
    seen = [sighted(film, (10 * draw, 10 * draw + 1), rng) for film in films]
    return people_pair(seen, [Clock(c.name, FPS, len(own_s)) for c in CAMERAS], FPS, LENSES)[0]


def errors(pairs: Sequence[Pair], later_frames: Sequence[float]) -> list[tuple[float, float]]:
    """By how many frames the last two cameras are off, and half of the 95 % interval."""
    found = solved("people", pairs, 3, 0, 0.0)
    return [(abs(p.offset_s * FPS - late), p.half_s * FPS) for p, late in zip(found[1:], later_frames) if p is not None]


def test_fractions_of_frames_are_nearer_than_pair_by_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = [np.random.default_rng(100 + draw).uniform(-0.5, 0.5, 2).tolist() for draw in range(8)]
    exact = [e for draw, later in enumerate(drawn) for e in errors(told(later, draw), later)]
    monkeypatch.setattr(people_clock, "together", lambda pairs, *_: pairs)
    singly = [e for draw, later in enumerate(drawn) for e in errors(told(later, draw), later)]
    assert len(exact) == len(singly) >= 14
    off, before = (np.array([error for error, _ in found]) for found in (exact, singly))
    assert np.median(off) < 0.8 * np.median(before)
    assert np.median(off) < 0.12
    stated, wide = (np.median([half for _, half in found]) for found in (exact, singly))
    assert stated < 0.85 * wide
    assert np.mean([error <= half for error, half in exact]) >= 0.85


def rays(offset_rows: Sequence[int], frames: int = 60) -> dict[int, list[tuple[int, np.ndarray]]]:
    """Of one swaying person's joints, exact, by cameras that begin so many rows later."""
    rows = np.arange(-20, frames + 20)
    sway = np.stack([np.sin(rows / 5.0), np.cos(rows / 7.0), 0.3 * np.sin(rows / 3.0)], axis=-1)
    joints = np.stack([0.4 * sway + [0.0, 0.0, 0.8 + 0.08 * j] for j in range(12)], axis=1)
    found = {}
    for k, camera in enumerate(CAMERAS):
        inside = joints @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        first = 20 + offset_rows[k]
        found[k] = [(0, (inside / inside[..., 2:])[first : first + frames])]
    return found


def test_from_a_frame_beside_them_clocks_are_found_exactly() -> None:
    rough = [Pair(0, 1, 2.4 / FPS, 0.5 / FPS), Pair(1, 2, -4.6 / FPS, 0.5 / FPS)]
    found = together(rough, rays([0, 3, -2]), GEOMETRY, 3, FPS)
    assert [(p.first, p.second) for p in found] == [(1, 0), (1, 2)]
    np.testing.assert_allclose([p.offset_s * FPS for p in found], [-3.0, -5.0], atol=0.01)
    assert all(p.sigma_s * FPS < 0.1 for p in found)


def test_what_is_known_well_enough_stays() -> None:
    sharp = [Pair(0, 1, 3 / FPS, 0.05 / FPS), Pair(0, 2, -2 / FPS, 0.05 / FPS)]
    assert together(sharp, rays([0, 3, -2]), GEOMETRY, 3, FPS) == sharp


def test_a_calibration_that_contradicts_changes_nothing() -> None:
    """The pairs say one thing with little doubt, the rays another."""
    said = [Pair(0, 1, 4.2 / FPS, 0.11 / FPS), Pair(0, 2, -2 / FPS, 0.11 / FPS)]
    assert together(said, rays([0, 3, -2]), GEOMETRY, 3, FPS) == said


def test_a_calibration_by_which_rays_miss_changes_nothing() -> None:
    rough = [Pair(0, 1, 3 / FPS, 0.5 / FPS), Pair(0, 2, -2 / FPS, 0.5 / FPS)]
    shifted = np.eye(4)
    shifted[:3, 3] = [0.0, 0.5, 0.0]
    far = {ab: replace(g, second_from_first=shifted @ g.second_from_first) for ab, g in GEOMETRY.items()}
    assert together(rough, rays([0, 3, -2]), far, 3, FPS) == rough
    # One camera's alone: the others are made exact without it.
    partly = GEOMETRY | {ab: far[ab] for ab in ((0, 1), (1, 2))}
    found = together(rough, rays([0, 3, -2]), partly, 3, FPS)
    assert found[0] == rough[0]
    assert found[1].sigma_s < rough[1].sigma_s


def test_a_joint_that_misses_by_a_constant_tells_the_same() -> None:
    """A camera 3 cm from where its calibration has it: rays of every joint miss by about as much all the time."""
    rough = [Pair(0, 1, 3.3 / FPS, 0.5 / FPS), Pair(0, 2, -2.3 / FPS, 0.5 / FPS)]
    shifted = np.eye(4)
    shifted[:3, 3] = [0.0, 0.03, 0.0]
    off = {ab: replace(g, second_from_first=shifted @ g.second_from_first) for ab, g in GEOMETRY.items()}
    found = together(rough, rays([0, 3, -2]), off, 3, FPS)
    np.testing.assert_allclose([p.offset_s * FPS for p in found], [3.0, -2.0], atol=0.05)


def test_cameras_that_nothing_links_stay_as_they_are() -> None:
    rough = [Pair(0, 1, 3 / FPS, 0.5 / FPS), Pair(2, 3, 1.0, 0.5 / FPS)]
    found = together(rough, {c: rays([0, 3, -2])[c] for c in (0, 1)}, {(0, 1): GEOMETRY[0, 1]}, 4, FPS)
    assert rough[1] in found
    (linked,) = [p for p in found if p != rough[1]]
    assert linked.offset_s * FPS == pytest.approx(3.0, abs=0.01)
    assert linked.sigma_s < rough[0].sigma_s
