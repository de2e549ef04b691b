# SPDX-License-Identifier: Apache-2.0
"""Where a round thing stands that one camera alone sees: its foot and sides in the picture at full size."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.depth.layout.contact_localisation import localise_by_contact
from studiorecon.depth.layout.primitives import Primitive, depth_with_primitives
from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import RoomBox

from tests.made.room import ring, texture

ROOM_BOX = RoomBox(0.0, np.array([-5.0, -5.0, 0.0]), np.array([5.0, 5.0, 3.0]), np.ones(6, bool), np.full(6, np.nan))
PLACE_M = (-3.4, -1.6)
SHAFT = Primitive("cylinder", PLACE_M, 0.0, (0.4, 0.4), 0.0, 3.0, 0.0)
BASE = Primitive("cylinder", PLACE_M, 0.0, (0.54, 0.54), 0.0, 0.16, 0.0)
# As pictures 160 pixels wide place it: too near, a little beside, and too wide.
GUESS = Primitive("cylinder", (-3.22, -1.49), 0.0, (0.46, 0.46), 0.0, 3.0, 0.0).numbers
REACH_PX = 4.5


def photo(*stands: Primitive, contrast: float = 1.0, width: int = 480) -> Picture:
    """The first camera's picture of them, two rays each way to a pixel; ``contrast``: of them with what is behind."""
    camera = ring(4, 3.0, (width, width * 9 // 16), 1.6, 0.9)[0]
    fine = camera.resized((2 * camera.wh[0], 2 * camera.wh[1]))
    depth_m, face = ROOM_BOX.intersect(*fine.rays())
    rgb = 0.3 + 0.2 * texture(fine.unproject(fine.pixel_centres(), depth_m), face, 0)
    _, shown = depth_with_primitives(stands, fine, depth_m)
    rgb[shown] = (1 - contrast) * rgb[shown] + contrast * np.array([0.8, 0.75, 0.6])
    rgb = rgb.reshape(camera.hw[0], 2, camera.hw[1], 2, 3).mean(axis=(1, 3))
    noise = np.random.default_rng(0).normal(0, 0.01, rgb.shape)
    return Picture(camera, (rgb + noise).astype(np.float32), np.ones(camera.hw, bool))


def apart_m(found: np.ndarray) -> float:
    return float(np.hypot(*(found[1:3] - PLACE_M)))


@pytest.mark.parametrize("stands", [(SHAFT,), (SHAFT, BASE)], ids=["plain", "on a wider base"])
def test_it_moves_to_where_its_foot_is_seen(stands: tuple[Primitive, ...]) -> None:
    assert apart_m(GUESS) > 0.2
    found = localise_by_contact(GUESS, photo(*stands), REACH_PX)
    assert apart_m(found) < 0.03
    assert found[4] == found[5] == pytest.approx(SHAFT.size_m[0], abs=0.03)
    assert (found[[0, 3, 6, 7]] == GUESS[[0, 3, 6, 7]]).all(), "only moved, and as wide as it is seen to be"


def test_what_hides_half_of_it_does_not_matter() -> None:
    picture = photo(SHAFT, BASE)
    foot_px = picture.camera.project(np.array([*PLACE_M, 0.0]))[0]
    picture.known[int(foot_px[1]) - 60 :, : int(foot_px[0]) - 3] = False
    assert apart_m(localise_by_contact(GUESS, picture, REACH_PX)) < 0.06


def test_it_stays_where_its_foot_is_not_seen() -> None:
    hidden = photo(SHAFT)
    hidden.known[int(hidden.camera.project(np.array([*PLACE_M, 0.0]))[0][1]) - 12 :] = False
    for picture in (hidden, photo(SHAFT, contrast=0.02)):
        assert (localise_by_contact(GUESS, picture, REACH_PX) == GUESS).all()


def test_it_moves_no_further_than_it_may() -> None:
    """What is further off is another thing's foot."""
    assert apart_m(localise_by_contact(GUESS, photo(SHAFT), 1.0)) > 0.1


@pytest.mark.parametrize("case", ["around the camera", "above it", "at its feet", "behind it"])
def test_what_no_camera_can_tell_stays(case: str) -> None:
    picture = photo(SHAFT)
    centre_m = picture.camera.centre_m
    start = GUESS.copy()
    if case == "around the camera":
        start[1:3] = centre_m[:2]
    elif case == "above it":
        start[6:] = centre_m[2] + 0.1, centre_m[2] + 1.0
    elif case == "at its feet":
        start[1:3], start[4:6] = centre_m[:2] + 0.24, 0.6
    else:
        start[1:3] = 2 * centre_m[:2]
    assert (localise_by_contact(start, picture, REACH_PX) == start).all()


def test_a_smaller_picture_says_the_same() -> None:
    assert apart_m(localise_by_contact(GUESS, photo(SHAFT, BASE, width=240), REACH_PX / 2)) < 0.06
