# SPDX-License-Identifier: Apache-2.0
"""What the room's straight edges say of calibrations that people accept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from studiorecon.cameras import refine
from studiorecon.rig.room_evidence import edge_contradiction, edge_rotations
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

from tests.defaults import loaded
from tests.made.cameras import detect, ring, walk
from tests.made.edges import about_the_spot, drawn
from tests.made.floors import between_deg

FRAMES = 30
# One person who hardly leaves the spot.
PEOPLE = [walk([0.0, 0.0, 0.0], [0.002, 0.0, 0.0], FRAMES)]


def by(
    given: list[Camera],
    truth: list[Camera],
    rooms: Sequence[RoomPicture | None],
    people: Sequence[np.ndarray] = PEOPLE,
    noise_px: float = 6.0,
) -> tuple[list[Camera], dict[str, Any]]:
    """The cameras and the report by what ``truth`` sees of people, with much noise."""
    seen = detect(truth, people, noise_px, np.random.default_rng(2))
    outcome = refine.decide(given, [], seen, FRAMES, 30.0, True, loaded(refine.Settings), rooms)
    return outcome.training, outcome.report


def test_a_calibration_that_people_accept_is_put_right_by_the_room(capsys: pytest.CaptureFixture[str]) -> None:
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v) for v, c in enumerate(truth)]
    found, report = by(given, truth, rooms)
    assert between_deg(given, truth) > 2.9
    assert report["edges"]["believed"], report
    assert between_deg(found, truth) < 0.7
    assert report["edges"]["between_deg"] > between_deg(found, truth)
    assert report["edges"]["off_after_deg"] < 1 < report["edges"]["off_deg"]
    assert report["refined"]
    assert "the room's straight edges" in capsys.readouterr().out


def test_a_calibration_that_is_right_stays() -> None:
    truth = ring()
    found, report = by(truth, truth, [drawn(c, v) for v, c in enumerate(truth)])
    assert not report["edges"]["believed"]
    assert report["edges"]["off_deg"] < 1
    assert all(a is b for a, b in zip(found, truth))


def test_a_room_that_is_mostly_hidden_moves_no_camera() -> None:
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v) for v, c in enumerate(truth)]
    for room in rooms:
        # Whoever stands before the camera hides the left half, and some of the rest.
        room.known[:, : int(0.45 * room.known.shape[1])] = False
    assert edge_contradiction(given, edge_rotations(given, rooms)) is None
    found, report = by(given, truth, rooms)
    assert "edges" not in report
    assert between_deg(found, given) < 1.0, report["freedom"]


def test_lines_that_run_anywhere_move_no_camera() -> None:
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v, clutter=1.0) for v, c in enumerate(truth)]
    assert edge_contradiction(given, edge_rotations(given, rooms)) is None
    found, report = by(given, truth, rooms)
    assert "edges" not in report
    assert between_deg(found, given) < 1.0, report["freedom"]


def test_edges_that_people_contradict_move_no_camera(capsys: pytest.CaptureFixture[str]) -> None:
    """Furniture that stands askew in one camera's picture alone, and somebody who walks about."""
    truth = ring()
    people = [walk([-1.2, -0.5, 0], [0.08, 0.03, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.06, 0], FRAMES, 2.0)]
    askew = about_the_spot(truth, [0.0, 3.0, 0.0, 0.0])
    found, report = by(truth, truth, [drawn(c, v) for v, c in enumerate(askew)], people, 1.0)
    assert report["edges"]["off_deg"] > 2
    assert not report["edges"]["believed"]
    assert between_deg(found, truth) < 0.1
