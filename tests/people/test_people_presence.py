# SPDX-License-Identifier: Apache-2.0
"""In which frames somebody is there: the same seconds at every frame rate, nobody lost who is measured, nobody in
between who was gone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from studiorecon.geometry import rotations
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors
from studiorecon.people.fitting.presence import STAYS_S, UNSEEN_S, fill_gaps, presence, true_runs

RATES = (10.0, 30.0, 60.0)
LENGTH_S = 20.0


def during(fps: float, *spans_s: tuple[float, float]) -> np.ndarray:
    """(T,) bool: from one second to another, both among them."""
    times_s = np.arange(round(LENGTH_S * fps) + 1) / fps
    return sum(((times_s > a - 1e-6) & (times_s < b + 1e-6) for a, b in spans_s), np.zeros(len(times_s), bool))


def spans_s(chosen: np.ndarray, fps: float) -> list[tuple[float, float]]:
    return [(round(first / fps, 6), round(last / fps, 6)) for first, last in true_runs(chosen)]


@pytest.mark.parametrize("fps", RATES)
@pytest.mark.parametrize(
    ("measured_s", "seen_s", "there_s"),
    [
        ([(0, 20)], [], [(0, 20)]),
        ([(3, 6)], [], [(2.5, 6.5)]),
        ([(0.3, 19.8)], [], [(0, 20)]),
        ([(2, 5), (15, 18)], [], [(1.5, 5.5), (14.5, 18.5)]),
        ([(2, 5), (7, 9)], [], [(1.5, 9.5)]),
        ([(2, 5), (7.2, 9)], [], [(1.5, 5.5), (6.7, 9.5)]),
        # One camera keeps sight of them, with gaps of less than two seconds.
        ([(2, 5), (15, 18)], [(6.9, 8), (9.5, 13.1)], [(1.5, 18.5)]),
        # One camera sees them leave, then nobody does.
        ([(2, 5), (15, 18)], [(5, 9)], [(1.5, 5.5), (14.5, 18.5)]),
        # Who only one camera sees, before or after, is nowhere yet.
        ([(8, 9)], [(0, 8), (9, 20)], [(7.5, 9.5)]),
        ([], [(0, 20)], []),
    ],
)
def test_seconds_decide_at_every_frame_rate(fps: float, measured_s: list, seen_s: list, there_s: list) -> None:
    assert spans_s(presence(during(fps, *measured_s), during(fps, *seen_s), fps), fps) == there_s


FLAGS = st.integers(1, 150).flatmap(lambda n: st.tuples(*(arrays(bool, n) for _ in range(3))))


@given(FLAGS, st.sampled_from([1.0, 7.0, 24.0, 25.0, 30.0]), st.integers(0, 3))
def test_what_holds_of_every_clip(flags: tuple, fps: float, rare: int) -> None:
    measured, seen, more = flags
    # Rare sightings leave gaps, dense ones none.
    measured &= np.arange(len(measured)) % 13 >= 4 * rare
    there = presence(measured, seen, fps)
    assert there[measured].all(), "whoever is measured is there"
    assert np.array_equal(presence(measured[::-1], seen[::-1], fps), there[::-1]), "time has no direction"
    assert (presence(measured, seen | more, fps) >= there).all(), "nobody is away for being seen"
    assert (presence(measured | more, seen, fps) >= there).all()
    at = np.flatnonzero(measured)
    for first, last in true_runs(there):
        own = at[(at >= first) & (at <= last)]
        assert len(own), "nobody is there without a measurement"
        assert (own[0] - first) / fps <= STAYS_S
        assert (last - own[-1]) / fps <= STAYS_S
        known = np.flatnonzero(measured | seen)
        known = known[(known >= own[0]) & (known <= own[-1])]
        assert len(known) < 2 or np.diff(known).max() / fps <= max(UNSEEN_S, 2 * STAYS_S)
    for first, last in true_runs(~there):
        # What is left out is long enough to be an absence, or lies at an end of the clip.
        assert first == 0 or last == len(there) - 1 or (last - first + 2 + 2 * int(STAYS_S * fps)) / fps > UNSEEN_S


def test_a_clip_shorter_than_the_margins_has_everybody_all_the_time() -> None:
    measured = np.arange(12) == 4
    assert presence(measured, measured, 30.0).all()


def test_what_is_no_clip_is_refused() -> None:
    with pytest.raises(ValueError, match="seen"):
        presence(np.ones(3, bool), np.ones(4, bool), 30.0)
    with pytest.raises(ValueError, match="fps must be positive"):
        presence(np.ones(3, bool), np.ones(3, bool), 0.0)


def test_who_leaves_stands_still_and_is_led_back_while_away() -> None:
    fps, frames = 10.0, 101
    measured = np.zeros(frames, bool)
    measured[10:31], measured[71:91] = True, True
    measured[20:25] = False  # a gap that is bridged
    walked_m = np.stack([np.arange(frames) * 0.1, np.zeros(frames), np.ones(frames)], axis=1)
    turns = rotations.exp(np.arange(frames)[:, None, None] * np.array([0.0, 0.0, 0.02]) * np.ones((1, 24, 1)))
    unknown = np.where(measured[:, None], walked_m, np.nan)
    there = presence(measured, measured, fps)
    local, trans_m = fill_gaps(np.where(measured[:, None, None, None], turns, np.nan), unknown, measured, there)
    np.testing.assert_array_equal(trans_m[measured], walked_m[measured])
    np.testing.assert_allclose(trans_m[20:25], walked_m[20:25])
    for margin, place in ((slice(5, 10), 10), (slice(31, 36), 30), (slice(66, 71), 71), (slice(91, 96), 90)):
        assert there[margin].all()
        np.testing.assert_array_equal(trans_m[margin], np.broadcast_to(walked_m[place], (5, 3)))
        np.testing.assert_allclose(local[margin], np.broadcast_to(turns[place], (5, 24, 3, 3)))
    assert not there[36:66].any()
    assert (np.diff(trans_m[35:67, 0]) > 0).all(), "a camera that follows comes along"
    np.testing.assert_allclose(np.diff(trans_m[35:67, 0]), np.diff(trans_m[35:67, 0]).mean())


def test_short_gaps_are_filled_to_the_bit_as_if_nobody_could_be_away() -> None:
    rng = np.random.default_rng(2)
    measured = rng.uniform(size=90) < 0.7
    local, trans_m = rotations.exp(rng.normal(size=(90, 24, 3))), rng.normal(size=(90, 3))
    there = presence(measured, measured, 30.0)
    assert there.all()
    filled_local, filled_m = fill_gaps(local, trans_m, measured, there)
    np.testing.assert_array_equal(filled_local, fill_rotations(local, measured))
    np.testing.assert_array_equal(filled_m, fill_vectors(trans_m, measured))
