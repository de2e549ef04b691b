# SPDX-License-Identifier: Apache-2.0
"""What looks unlike the wall behind it: told from wallpaper, and put up where its foot stands, though one photo alone
shows it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from studiorecon.depth.layout.primitive_fitting import fit_primitives
from studiorecon.depth.layout.primitives import Primitive
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.stereo.self_dissimilarity import foreground_log_odds
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

from tests.made.room import ring, texture

ROOM_BOX = RoomBox(0.0, np.array([-4.0, -4.0, 0.0]), np.array([4.0, 4.0, 3.0]), np.ones(6, bool), np.full(6, np.nan))
NOBODY = np.zeros((0, 4))


def cameras(width: int = 160) -> list[Camera]:
    return ring(4, 3.0, (width, width * 9 // 16), 1.6, 0.9)


def place() -> tuple[float, float]:
    """Where the first camera alone sees something stand: beyond the middle, beside where the others look."""
    first, *others = cameras()
    grid = np.stack(np.meshgrid(np.arange(-3.4, 3.5, 0.1), np.arange(-3.4, 3.5, 0.1)), axis=-1).reshape(-1, 2)

    def sees(camera: Camera, height: float, margin_px: float) -> np.ndarray:
        points = np.column_stack([grid, np.full(len(grid), height)])
        pixels, z = camera.project(points)
        inside = (pixels > margin_px) & (pixels < np.array(camera.wh) - margin_px)
        return (z > 0.5) & inside.all(axis=1)

    alone = sees(first, 0.0, 12) & ~np.any([sees(c, h, -25) for c in others for h in (0.0, 1.0, 2.0)], axis=0)
    depth_m = first.project(np.column_stack([grid, np.zeros(len(grid))]))[1]
    return tuple(grid[np.where(alone, depth_m, -1).argmax()])


def pillar() -> Primitive:
    return Primitive(place(), 0.0, (0.4, 0.4), 0.0, 3.0, 0.0)


def wallpaper(points: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Stripes on the walls, boards on the floor, each face in its own colours, none quite like the next."""
    along = np.where((face // 2 == 0), points[..., 1], points[..., 0])
    stripe = (along / 0.25) % 1 < 0.5
    board = ((points[..., 1] / 0.2).astype(int) * 37 + (points[..., 0] / 0.9).astype(int) * 11) % 5
    colour = np.where(stripe[..., None], [0.55, 0.65, 0.6], [0.4, 0.5, 0.5]) * (1 - 0.05 * face[..., None])
    colour = np.where((face >= 4)[..., None], (0.45 + 0.03 * board)[..., None] * np.array([1.0, 0.8, 0.55]), colour)
    return 0.8 * colour + 0.2 * texture(points, face, 0)


def photos(
    stands: Primitive | None,
    only_first: bool = False,
    hidden_foot: bool = False,
    poster: bool = False,
    width: int = 160,
) -> list[Picture]:
    rng, pictures = np.random.default_rng(0), []
    for number, camera in enumerate(cameras(width)):
        depth_m, face = ROOM_BOX.intersect(*camera.rays())
        points = camera.unproject(camera.pixel_centres(), depth_m)
        rgb, known = wallpaper(points, face), np.ones(camera.hw, bool)
        if poster and number == 0:
            wall = face[:40][face[:40] < 4][0]
            axis = 1 if wall // 2 == 0 else 0
            middle = np.median(points[(face == wall)][:, axis])
            hung = (face == wall) & (np.abs(points[..., axis] - middle) < 0.4) & (np.abs(points[..., 2] - 1.6) < 0.4)
            rgb[hung] = [0.8, 0.2, 0.1]
        if stands is not None and (number == 0 or not only_first):
            entered = stands.depth(camera)
            before = entered > 0
            height = camera.unproject(camera.pixel_centres(), np.where(before, entered, 1.0))[..., 2]
            red = (height / 0.5) % 1 < 0.5
            rgb[before] = np.where(red[..., None], [0.7, 0.2, 0.15], [0.85, 0.8, 0.7])[before]
            if hidden_foot and before.any():
                low = np.nonzero(before)[0].max()
                known[low - 12 : low + 30] = False
        pictures.append(Picture(camera, (rgb + rng.normal(0, 0.01, rgb.shape)).astype(np.float32), known))
    return pictures


def put_up(pictures: Sequence[Picture]) -> list[Primitive]:
    gates = {"window": 5, "mean_weight": 1.5, "least_gain": 40.0, "most": 5}
    return fit_primitives(pictures, ROOM_BOX, NOBODY, **gates)


def test_a_pillar_is_unlike_the_wallpaper_behind_it() -> None:
    stands = pillar()
    shown = [stands.depth(c) > 0 for c in cameras()]
    assert shown[0].sum() > 100, "the first camera sees it"
    assert not any(s.any() for s in shown[1:]), "and no other"
    odds = foreground_log_odds(photos(stands), ROOM_BOX)
    assert odds[0][shown[0]].mean() > 0.4
    assert all((own[~s] > 0).mean() < 0.12 for own, s in zip(odds, shown))
    assert all(own.min() >= -1 and own.max() <= 1 and own.dtype == np.float32 for own in odds)


def test_it_stands_where_its_foot_is_seen_to_be() -> None:
    """A row of the picture is 0.2 m of floor there."""
    stands = pillar()
    found = put_up(photos(stands))
    assert len(found) == 1
    apart_m = np.linalg.norm(np.subtract(found[0].centre_m, stands.centre_m))
    assert apart_m < 0.3, (found, stands)
    assert found[0].size_m[0] == pytest.approx(0.4, abs=0.15)
    assert found[0].low_m == pytest.approx(0.0, abs=0.03)
    assert found[0].high_m > 2.5


@pytest.mark.parametrize("case", ["poster", "foot hidden", "another camera looks through it"])
def test_nothing_is_put_up_where_one_photo_does_not_tell(case: str) -> None:
    if case == "poster":
        pictures = photos(None, poster=True)
    elif case == "foot hidden":
        pictures = photos(pillar(), hidden_foot=True)
    else:
        middle = Primitive((0.2, 0.3), 0.0, (0.4, 0.4), 0.0, 1.8, 0.0)
        pictures = photos(middle, only_first=True)
    assert put_up(pictures) == []
