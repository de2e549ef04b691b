# SPDX-License-Identifier: Apache-2.0
"""What the room's straight edges say of calibrations that people accept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from studiorecon.cameras import edge_acceptance, refine
from studiorecon.cameras.edge_acceptance import apply_edge_refinement
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.edge_refinement import EdgeRefinement, edge_contradiction
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import edge_rotations
from studiorecon.scene.camera import Camera

from tests.defaults import loaded
from tests.made.cameras import detect, ring, walk
from tests.made.edges import about_the_spot, drawn
from tests.made.floors import between_deg

FRAMES = 30
# One person who hardly leaves the spot.
PEOPLE = [walk([0.0, 0.0, 0.0], [0.002, 0.0, 0.0], FRAMES)]


def observed(truth: Sequence[Camera], by: Sequence[Camera]) -> Observations:
    """What ``truth`` sees of the person with much noise, grouped by other cameras."""
    return make_observations(detect(list(truth), PEOPLE, 6.0, np.random.default_rng(2)), by, np.arange(FRAMES), 0.25)[0]


def by(
    given: list[Camera], seen: Observations, rooms: Sequence[RoomPicture | None]
) -> tuple[list[Camera], dict[str, Any]]:
    settings = loaded(refine.Settings)
    return apply_edge_refinement(given, given, seen, rooms, {"refined": False}, settings.limits, settings.bundle)


def test_a_calibration_that_people_accept_is_put_right_by_the_room(capsys: pytest.CaptureFixture[str]) -> None:
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v) for v, c in enumerate(truth)]
    found, report = by(given, observed(truth, given), rooms)
    assert between_deg(given, truth) > 2.9
    assert report["edges"]["believed"], report
    assert between_deg(found, truth) < 0.7
    assert report["edges"]["between_deg"] > between_deg(found, truth)
    assert report["edges"]["off_after_deg"] < 1 < report["edges"]["off_deg"]
    assert report["refined"]
    assert "the room's straight edges show that cameras have moved" in capsys.readouterr().out


def test_a_calibration_that_is_right_stays() -> None:
    truth = ring()
    found, report = by(truth, observed(truth, truth), [drawn(c, v) for v, c in enumerate(truth)])
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
    assert by(given, observed(truth, given), rooms) == (given, {"refined": False})


def test_lines_that_run_anywhere_move_no_camera() -> None:
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v, clutter=1.0) for v, c in enumerate(truth)]
    assert edge_contradiction(given, edge_rotations(given, rooms)) is None
    assert by(given, observed(truth, given), rooms) == (given, {"refined": False})


def test_edges_that_people_contradict_move_no_camera(capsys: pytest.CaptureFixture[str]) -> None:
    """Furniture that stands askew in one camera's picture alone, and somebody who walks about."""
    truth = ring()
    people = [walk([-1.2, -0.5, 0], [0.08, 0.03, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.06, 0], FRAMES, 2.0)]
    seen, _ = make_observations(detect(truth, people, 1.0, np.random.default_rng(0)), truth, np.arange(FRAMES), 0.25)
    askew = about_the_spot(truth, [0.0, 3.0, 0.0, 0.0])
    found, report = by(truth, seen, [drawn(c, v) for v, c in enumerate(askew)])
    assert report["edges"]["off_deg"] > 2
    assert not report["edges"]["believed"]
    assert all(a is b for a, b in zip(found, truth))
    assert "and are not used" in capsys.readouterr().out


def test_edges_that_moving_cameras_hardly_explains_move_no_camera(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in a real room whose calibration is right: the edges are 1.98° off, and 1.83° with other cameras."""
    truth = ring()
    given = about_the_spot(truth, [1.5, -1.5, 1.2, -0.8])
    rooms = [drawn(c, v) for v, c in enumerate(truth)]

    def hardly(cameras: list[Camera], *_: object) -> EdgeRefinement:
        off = edge_contradiction(cameras, edge_rotations(cameras, rooms))
        assert off is not None
        return EdgeRefinement(truth, off.off_deg, 0.9 * off.off_deg, 1.0, (2.0, 1.9), True)

    monkeypatch.setattr(edge_acceptance, "refine_on_edges", hardly)
    found, report = by(given, observed(truth, given), rooms)
    assert found == given
    assert not report["edges"]["believed"]
    assert "and are not used" in capsys.readouterr().out
