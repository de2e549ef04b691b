# SPDX-License-Identifier: Apache-2.0
"""Clocks of films without sound, from people as the embedded detector sees them, at any frame rate."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.clocks.people import people_lags
from studiorecon.scene.clocks import Clock

from benchmarks.clocks import by_people, silent_films
from tests.made.cameras import ring
from tests.made.silent import Silent, sighted


@pytest.mark.parametrize("fps", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("frames", [(1.0, -1.0), (0.4, -0.4)])
def test_a_frame_and_less_comes_out(fps: float, frames: tuple[float, float]) -> None:
    films = silent_films(fps, 8.0, (frames[0] / fps, frames[1] / fps), False, 0.0)
    for row in by_people(films, fps, False, 0):
        assert row["error"] < 0.2
        assert row["error"] <= 1.5 * row["half"], "three standard deviations"


def test_ten_seconds_come_out() -> None:
    for row in by_people(silent_films(15.0, 30.0, (10.0, -10.0), False, 0.0), 15.0, False, 1):
        assert row["error"] < 0.2


def test_frames_that_come_unevenly_are_compared_at_their_own_times() -> None:
    for row in by_people(silent_films(30.0, 8.0, (0.55, -0.3), True, 0.0), 30.0, True, 2):
        assert row["error"] < 0.2


def test_two_strangers_have_no_lag_at_ten_frames_per_second() -> None:
    """One camera sees one of them, the other one the other; seconds of it must not fit somewhere."""
    wrong = 0
    for draw in range(12):
        own_s = np.arange(40) / 10
        rng = np.random.default_rng(draw)
        films = [Silent(camera, 20.0, own_s) for camera in ring()[:2]]
        seen = [sighted(film, (10 * draw + k,), rng) for k, film in enumerate(films)]
        lags = people_lags(seen, [Clock(d.camera, 10.0, 40) for d in seen], 10.0)[0]
        wrong += any(lag.outlier_probability < 0.05 for lag in lags)
    assert wrong <= 1
