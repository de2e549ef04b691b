# SPDX-License-Identifier: Apache-2.0
"""Places on the floor that cameras a quarter turn apart share: planted floors, and floors that say nothing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from studiorecon.geometry.triangulation import triangulate
from studiorecon.rig.floor_marks import FloorMarks, floor_marks
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

from tests.made.cameras import LIMITS, ring
from tests.made.floors import boards, carpet, off, room

MIDDLE = np.zeros(2)


def apart_m(marks: FloorMarks, truth: list[Camera], height_m: float = 0.0) -> np.ndarray:
    """(P,) how far places lie apart where two true cameras see them on the floor."""
    found = []
    for a, b in itertools.combinations(range(len(truth)), 2):
        both = np.isfinite(marks.pixels[[a, b]]).all((0, 2))
        at = []
        for v in (a, b):
            camera = truth[v]
            rays = camera.unproject(marks.pixels[v, both], np.ones(int(both.sum()))) - camera.centre_m
            at.append(camera.centre_m + rays * ((height_m - camera.centre_m[2]) / rays[:, 2:]))
        found.append(np.linalg.norm(at[0] - at[1], axis=-1))
    return np.concatenate(found)


@pytest.mark.parametrize(("seed", "degrees", "metres"), [(0, 0.0, 0.0), (1, 0.7, 0.04), (2, 0.7, 0.04), (3, 1.2, 0.08)])
def test_cameras_a_quarter_turn_apart_share_places_of_a_carpet(seed: int, degrees: float, metres: float) -> None:
    truth = ring(wh=(640, 352), height_m=1.8)
    truth = [
        Camera(c.name, c.wh, np.array([[500.0, 0, 320], [0, 500, 176], [0, 0, 1]]), c.camera_from_world) for c in truth
    ]
    rooms = [room(c, carpet(seed), v, gain=0.8 + 0.15 * v) for v, c in enumerate(truth)]
    marks = floor_marks(off(truth, seed, degrees, metres), rooms, MIDDLE, 0.0, 0.25)
    assert marks is not None
    assert np.median(apart_m(marks, truth)) < 0.006
    assert np.quantile(apart_m(marks, truth), 0.95) < 0.03
    assert len({frozenset(pair) for pair in marks.seen_by}) >= 4
    if not degrees:
        met = triangulate(marks.pixels, np.isfinite(marks.pixels).all(-1).astype(float), truth, LIMITS)
        assert np.nanmedian(met.error_px / marks.sigma_px[:, None]) < 2.0


def test_a_platform_is_found_at_its_own_height() -> None:
    truth = ring(height_m=1.8)
    rooms = [room(c, carpet(5), v, height_m=0.12) for v, c in enumerate(truth)]
    marks = floor_marks(truth, rooms, MIDDLE, 0.0, 0.1)
    assert marks is not None
    assert marks.points_m[0, 2] == pytest.approx(0.12, abs=0.02)
    assert np.median(apart_m(marks, truth, 0.12)) < 0.006


@pytest.mark.parametrize("what", ["bare", "different", "repeated", "blind"])
def test_floors_that_say_nothing_are_not_believed(what: str) -> None:
    truth = ring(height_m=1.8)
    floors = {
        "bare": [np.full((600, 600), 120, np.uint8)] * 4,
        "different": [carpet(10 + v) for v in range(4)],
        "repeated": [boards(0.16)] * 4,
        "blind": [carpet(1)] * 4,
    }[what]
    rooms: list[RoomPicture | None] = [room(c, floor, v) for v, (c, floor) in enumerate(zip(truth, floors))]
    if what == "blind":
        rooms = [rooms[0], None, None, None]
    assert floor_marks(off(truth, 4, 0.7, 0.05), rooms, MIDDLE, 0.0, 0.25) is None


def test_where_people_stand_nothing_is_looked_for() -> None:
    truth = ring(height_m=1.8)
    rooms = [room(c, carpet(2), v) for v, c in enumerate(truth)]
    hidden = [RoomPicture(r.grey, np.zeros_like(r.known)) for r in rooms]
    assert floor_marks(truth, [rooms[0], rooms[1], hidden[2], hidden[3]], MIDDLE, 0.0, 0.1).seen_by.keys() <= {
        (0, 1),
        (1, 0),
    }


def test_pictures_of_another_size_are_refused() -> None:
    truth = ring()
    rooms = [room(c, carpet(2), v) for v, c in enumerate(truth)]
    wrong = RoomPicture(rooms[0].grey[:100], rooms[0].known)
    with pytest.raises(ValueError, match="grey"):
        floor_marks(truth, [wrong, *rooms[1:]], MIDDLE, 0.0, 0.1)
