# SPDX-License-Identifier: Apache-2.0
"""A film that lacks frames in its middle, though its time stamps run evenly, is named, and no whole one is."""

from __future__ import annotations

from dataclasses import replace

import pytest
from studiorecon.clocks.stretches import lost_frames_notes

from tests.made.silent import Rough, rough

FPS = 30.0


def lacking(take: Rough, camera: int, at: int, count: int) -> Rough:
    """The take whose film of ``camera`` lacks ``count`` frames from ``at`` on."""
    seen, clocks = list(take.seen), list(take.clocks)
    one = seen[camera].only((seen[camera].frame < at) | (seen[camera].frame >= at + count))
    seen[camera] = replace(one, frame=one.frame - count * (one.frame >= at + count))
    clocks[camera] = replace(clocks[camera], frames=clocks[camera].frames - count)
    return replace(take, seen=seen, clocks=clocks)


def notes(take: Rough, calibrated: bool = True) -> list[str]:
    names = [clock.camera for clock in take.clocks]
    return lost_frames_notes(take.seen, take.clocks, FPS, take.lenses if calibrated else {}, names)


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("camera", range(2))
def test_a_film_that_lacks_frames_is_named(camera: int, calibrated: bool) -> None:
    whole = rough(camera, seconds=10.0, spread_s=0.0)
    assert not notes(whole, calibrated)
    (sentence,) = notes(lacking(whole, camera, 150, 3), calibrated)
    assert f"camera {whole.clocks[camera].camera} lacks about 3 " in sentence


def test_what_a_short_film_does_not_show_is_said() -> None:
    whole = rough(0, seconds=2.0)
    assert not notes(whole)
    (sentence,) = notes(lacking(whole, 1, 30, 3))
    assert f"camera {whole.clocks[1].camera} has 3 frames fewer than" in sentence
