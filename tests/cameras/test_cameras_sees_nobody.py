# SPDX-License-Identifier: Apache-2.0
"""Cameras that see nobody: they keep the pose they were given, the others are checked and moved without them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from studiorecon.calibration import doctor
from studiorecon.cameras import refine
from studiorecon.rig.active_cameras import active_cameras, inactive_camera_notes
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.defaults import loaded
from tests.made.cameras import detect, ring, walk
from tests.made.floors import between_deg, off

FRAMES = 40
PEOPLE = [walk([-1.2, -0.5, 0], [0.04, 0.02, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.04, 0], FRAMES, 2.0)]


def first(d: Detections, frames: int) -> Detections:
    """The detections of the first frames."""
    kept = d.frame < frames
    return replace(d, frame=d.frame[kept], track=d.track[kept], keypoints=d.keypoints[kept])


def seen_but(*blind: int, ghost: int = 0) -> list[Detections]:
    """What the ring's cameras see, ``blind`` ones nobody but what is in ``ghost`` frames."""
    seen = detect(ring(), PEOPLE, 1.5, np.random.default_rng(0))
    return [first(d, ghost) if v in blind else d for v, d in enumerate(seen)]


def about(camera: Camera) -> dict[str, Any]:
    """What the doctor is told about a film."""
    reported = {"camera": camera.name, "wh": list(camera.wh), "frames": FRAMES, "first_frame": 0.0, "keypoints": True}
    return reported | {"video_frames": FRAMES, "fps": 30.0, "rotation_deg": 0, "brightness": 0.4, "burnt": 0.0}


def decided(given: list[Camera], seen: list[Detections]) -> refine.Refinement:
    return refine.decide(given, [], seen, FRAMES, 30.0, True, loaded(refine.Settings))


@pytest.mark.parametrize("ghost", [0, 3])
def test_cameras_that_were_moved_are_put_right_without_the_one_that_sees_nobody(
    ghost: int, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = ring()
    given = off(truth, 2, 3.0, 0.2)
    outcome = decided(given, seen_but(2, ghost=ghost))
    assert between_deg(given, truth) > 3
    others = [[group[v] for v in (0, 1, 3)] for group in (outcome.training, truth)]
    assert between_deg(*others) < 0.3
    assert np.array_equal(outcome.training[2].camera_from_world, given[2].camera_from_world)
    reported = capsys.readouterr().out
    how = "a person in 3 frames only" if ghost else "nobody"
    assert reported.count(f"warning: camera c2 sees {how}: it shows only the room") == 1
    assert "identities come from c0, c1, c3" in reported


def test_who_passes_a_camera_for_a_second_in_a_long_film_is_seen_by_it() -> None:
    seen = detect(ring(), [walk([0, 0, 0], [0.002, 0, 0], 600)], 1.5, np.random.default_rng(0))
    at_a_door = [*seen[:3], first(seen[3], 40)]
    assert active_cameras(at_a_door, 30.0) == [0, 1, 2, 3], "1.3 s"
    assert active_cameras(at_a_door, 60.0) == active_cameras(at_a_door, 0.0) == [0, 1, 2], "0.7 s, and nobody knows"
    assert not inactive_camera_notes(at_a_door, 30.0)
    assert list(inactive_camera_notes(at_a_door, 60.0)) == ["c3"]


def test_a_camera_that_sees_nobody_changes_nothing_about_a_good_calibration() -> None:
    truth = ring()
    outcome = decided(truth, seen_but(2))
    assert not outcome.report["refined"]
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))


@pytest.mark.parametrize("ghost", [0, 3])
def test_where_one_camera_alone_sees_people_nothing_is_refused(ghost: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Three frames of furniture that looks like somebody speak against no calibration."""
    truth = ring()
    seen = seen_but(1, 2, 3, ghost=ghost)
    rng = np.random.default_rng(1)
    seen = [seen[0], *(replace(d, keypoints=rng.permuted(d.keypoints, axis=1)) for d in seen[1:])]
    outcome = decided(truth, seen)
    assert outcome.report["reason"] == "no person in two cameras"
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))
    assert "no person is visible in two cameras at once" in capsys.readouterr().out


@pytest.mark.parametrize(("blind", "verdict"), [((2,), "check"), ((1, 2, 3), "cannot tell")])
def test_the_doctor_says_which_camera_sees_nobody(blind: tuple[int, ...], verdict: str) -> None:
    cameras = ring()
    report, _ = doctor.examine(cameras, seen_but(*blind), [about(c) for c in cameras], loaded(doctor.Settings))
    assert report["verdict"] == verdict, report["advice"]
    for v in blind:
        assert sum(sentence.startswith(f"camera c{v} sees nobody") for sentence in report["advice"]) == 1
    if verdict == "cannot tell":
        assert "people are seen by one camera alone" in report["advice"][0]
    else:
        assert report["refined"]["between_deg"] < 3, "the others are judged without it"
