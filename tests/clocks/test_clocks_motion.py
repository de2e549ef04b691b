# SPDX-License-Identifier: Apache-2.0
"""Motion is the last resort: where people or sound prove it wrong of most cameras, nothing is made of it elsewhere."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from studiorecon.clocks import offsets
from studiorecon.clocks.motion import motion_lags
from studiorecon.clocks.offsets import ClockVerdict
from studiorecon.clocks.posterior import Lag, Source
from studiorecon.clocks.timeline import Timeline, clock_as_filmed

FPS, SECONDS, CAMERAS = 30.0, 10.0, 9
# Who walks round a ring of eight cameras is nearest to one after the other.
ROUND_S = 17.8


def circling(late_s: Mapping[int, float]) -> list[np.ndarray]:
    """Energy (T,) of every camera's pictures of somebody who walks round them in a jerky way, seen from all around."""
    energies = []
    for camera in range(CAMERAS):
        t = np.arange(round(SECONDS * FPS)) / FPS + 30 + late_s.get(camera, 0.0)
        phase = t - camera * ROUND_S / 8
        bumps = np.random.default_rng(7).uniform(0, ROUND_S, 60)
        energies.append(
            sum(np.exp(-0.5 * (((phase - b + ROUND_S / 2) % ROUND_S - ROUND_S / 2) / 0.12) ** 2) for b in bumps) + 0.5
        )
    return energies


def verdicts(monkeypatch: pytest.MonkeyPatch, late_s: Mapping[int, float], from_people: int) -> list[ClockVerdict]:
    """What is made of such pictures where people tell the clocks of the first ``told_by_people`` cameras."""
    in_step = [Lag(Source("people"), 0, c, late_s.get(c, 0.0), 0.001, 0.005) for c in range(1, from_people)]
    monkeypatch.setattr(offsets.people, "people_lags", lambda *_: (in_step, {}))
    lines = [Timeline(FPS, round(SECONDS * FPS), 0.0)] * CAMERAS
    names = [f"cam{c}" for c in range(CAMERAS)]
    moved, still = motion_lags(circling(late_s), [clock_as_filmed(c, line) for c, line in zip(names, lines)], FPS)
    return offsets.estimate_clocks(names, lines, moved, {"motion": still}, [], {})[0]


def test_who_walks_in_a_circle_does_not_shift_the_cameras_that_see_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    found = verdicts(monkeypatch, {}, from_people=8)
    assert all(v.offset_s == 0 for v in found)
    assert [v.kind for v in found[1:8]] == ["in step"] * 7, "people are believed although motion contradicts them"
    assert found[8].kind == "undetermined"


def test_a_late_camera_is_found_by_people_whatever_motion_says(monkeypatch: pytest.MonkeyPatch) -> None:
    found = verdicts(monkeypatch, {3: 1.5}, from_people=8)
    assert found[3].kind == "found"
    assert found[3].offset_s == pytest.approx(1.5)


def test_films_that_move_clearly_together_have_a_lag_and_an_interval() -> None:
    energy = np.random.default_rng(2).exponential(1.0, 6000)
    line = Timeline(FPS, len(energy), 0.0)
    moved, still = motion_lags([energy] * 3, [clock_as_filmed(f"cam{c}", line) for c in range(3)], FPS)
    assert [lag.offset_s for lag in moved] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert not still
