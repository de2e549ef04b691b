# SPDX-License-Identifier: Apache-2.0
"""Planes of regions: a leaning board, neither wall nor upright box, is found; what is explained stays; nothing to see
is no plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.depth import refine
from studiorecon.depth.layout.primitives import write_primitives
from studiorecon.depth.stereo.patches import UNSEEN
from studiorecon.depth.stereo.photo_inconsistency import surface_cost, unexplained
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.stereo.regions import Regions, explain_regions, world_plane
from studiorecon.footage.exr import read_depth
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.room import RoomBox, write_room

from tests.made.room import Room, made_room, photograph, ring, texture, write_capture

HOW = {"window": 7, "mean_weight": 1.5, "penalty": 0.8, "near_m": 0.3, "most_share": 0.4, "most": 100}
# A board of 1.4 m x 1.2 m that leans back by 50 degrees, across the room's diagonal; its lower edge is 25 cm above the
# floor.
MIDDLE_M, HALF_M, LEAN_RAD, YAW_RAD = np.array([-0.5, 0.1, 0.7]), (0.7, 0.6), np.radians(50), 0.9


def board_axes() -> np.ndarray:
    """(3, 3) rows: along the board's lower edge, up its slope, and its normal."""
    along = np.array([-np.sin(YAW_RAD), np.cos(YAW_RAD), 0.0])
    level = np.array([np.cos(YAW_RAD), np.sin(YAW_RAD), 0.0])
    up = np.sin(LEAN_RAD) * np.array([0.0, 0.0, 1.0]) - np.cos(LEAN_RAD) * level
    return np.stack([along, up, np.cross(along, up)])


def with_board(room: Room, camera: Camera, samples: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture (H, W, 3), exact depth (H, W) and where the board is seen (H, W) bool."""

    def cast(lens: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        colour, behind_m = photograph(room, lens, 1)
        origin, rays = lens.rays()
        axes = board_axes()
        depth_m = (axes[2] @ (MIDDLE_M - origin)) / (rays @ axes[2])
        local = (origin + rays * depth_m[..., None] - MIDDLE_M) @ axes.T
        hit = (
            (depth_m > 0)
            & (depth_m < behind_m)
            & (np.abs(local[..., 0]) < HALF_M[0])
            & (np.abs(local[..., 1]) < HALF_M[1])
        )
        painted = texture(local[..., [0, 1, 2]] * 2.5, np.full(hit.shape, 4), 11)
        return np.where(hit[..., None], painted, colour), np.where(hit, depth_m, behind_m), hit

    fine, _, _ = cast(camera.resized((camera.wh[0] * samples, camera.wh[1] * samples)))
    colour = fine.reshape(camera.hw[0], samples, camera.hw[1], samples, 3).mean((1, 3))
    return (colour.astype(np.float32), *cast(camera)[1:])


def on_walls(room: Room, cameras: list[Camera]) -> list[np.ndarray]:
    return [room.room_box.intersect(*c.rays())[0].astype(np.float32) for c in cameras]


def in_front_of_it(cameras: list[Camera]) -> list[int]:
    """Cameras that see the board's front, the one that stands highest above it first."""
    heights = [float(board_axes()[2] @ (c.centre_m - MIDDLE_M)) for c in cameras]
    return [i for i in np.argsort(heights)[::-1] if heights[i] > 0.5]


@pytest.fixture(scope="module")
def leaning() -> tuple[Room, list[Picture], list[np.ndarray], list[np.ndarray], list[Regions]]:
    """The room with the board, five looks at it, true depths, the board's pixels, and what every camera finds."""
    room, cameras = made_room(table=False), ring(5)
    shots = [with_board(room, camera) for camera in cameras]
    pictures = [Picture(c, rgb, np.ones(c.hw, bool)) for c, (rgb, *_) in zip(cameras, shots)]
    # A camera at its back has nobody to agree with: two at its front are looked at.
    found = [
        explain_regions(pictures, i, on_walls(room, cameras), room.room_box, **HOW) for i in in_front_of_it(cameras)[:2]
    ]
    return room, pictures, [s[1] for s in shots], [s[2] for s in shots], found


def replaced(picture: Picture, depth_m: np.ndarray, found: Regions) -> np.ndarray:
    planes = np.concatenate([np.zeros((1, 4)), found.planes])
    return np.where(found.chosen > 0, picture.depth_of(planes[found.chosen]), depth_m)


def test_a_leaning_board_is_found_where_two_cameras_see_its_front(leaning: tuple) -> None:
    room, pictures, truth, boards, found = leaning
    before, after, hurt = [], [], []
    for i, regions in zip(in_front_of_it([p.camera for p in pictures]), found):
        picture, depth_m, board = pictures[i], truth[i], boards[i]
        wall_m = room.room_box.intersect(*picture.camera.rays())[0]
        error = np.abs(replaced(picture, wall_m, regions) - depth_m) / depth_m
        before.append((np.abs(wall_m - depth_m) / depth_m)[board].mean())
        after.append(error[board].mean())
        hurt.append((error[~board] > 0.05).mean())
    assert len(after) == 2
    assert np.mean(before) > 0.2
    assert np.mean(after) < 0.3 * np.mean(before)
    assert np.mean(hurt) < 0.03


def test_the_planes_lean_as_the_board_does(leaning: tuple) -> None:
    _, pictures, _, boards, found = leaning
    angles, off_m = [], []
    for i, regions in zip(in_front_of_it([p.camera for p in pictures]), found):
        chosen = regions.chosen[boards[i] & (regions.chosen > 0)]
        planes = regions.planes[chosen - 1]
        angles.append(np.degrees(np.arccos(np.clip(np.abs(planes[:, :3] @ board_axes()[2]), 0, 1))))
        off_m.append(np.abs(planes[:, :3] @ MIDDLE_M - planes[:, 3]))
    assert np.median(np.concatenate(angles)) < 6
    assert np.median(np.concatenate(off_m)) < 0.04


def test_what_is_explained_stays_as_it_is() -> None:
    room, cameras = made_room(), ring()
    shots = [photograph(room, camera) for camera in cameras]
    pictures = [Picture(c, rgb, np.ones(c.hw, bool)) for c, (rgb, _) in zip(cameras, shots)]
    depths = [depth_m.astype(np.float32) for _, depth_m in shots]
    for i in (0, 2):
        found = explain_regions(pictures, i, depths, room.room_box, **HOW)
        moved = np.abs(replaced(pictures[i], depths[i], found) - depths[i]) > 0.05 * depths[i]
        assert moved.mean() < 0.01


def test_the_cost_of_a_surface_tells_the_true_one(leaning: tuple) -> None:
    room, pictures, truth, boards, _ = leaning
    true = [(p, d.astype(np.float32)) for p, d in zip(pictures, truth)]
    i = in_front_of_it([p.camera for p in pictures])[0]
    others = [pair for j, pair in enumerate(true) if j != i]
    right, judged = surface_cost(pictures[i], true[i][1], others, 7, 1.5)
    wrong, _ = surface_cost(pictures[i], on_walls(room, [pictures[i].camera])[0], others, 7, 1.5)
    inner = boards[i] & judged
    assert inner.sum() > 200
    assert np.median(right[inner]) < 0.3
    assert np.median(wrong[inner]) > 0.6
    assert (right[~judged] == UNSEEN).all()


@pytest.mark.parametrize("case", ["one camera", "no texture", "never measured", "no depth"])
def test_nothing_to_see_is_no_plane(leaning: tuple, case: str) -> None:
    room, pictures, _, _, _ = leaning
    depths = on_walls(room, [p.camera for p in pictures])
    if case == "one camera":
        pictures, depths = pictures[:1], depths[:1]
    elif case == "no texture":
        pictures = [replace(p, rgb=np.full_like(p.rgb, 0.6)) for p in pictures]
    elif case == "never measured":
        pictures = [replace(p, known=np.zeros_like(p.known)) for p in pictures]
    else:
        depths = [np.zeros_like(d) for d in depths]
    found = explain_regions(pictures, 0, depths, room.room_box, **HOW)
    assert np.isfinite(found.cost).all()
    if case == "no depth":
        # Nothing is known of the room but its walls: whatever is found lies before them.
        reach_m = room.room_box.intersect(*pictures[0].camera.rays())[0]
        assert (replaced(pictures[0], reach_m, found) <= 1.02 * reach_m).all()
    else:
        assert not len(found.planes)
        assert not found.chosen.any()


def test_pixels_that_were_never_measured_make_no_region(leaning: tuple) -> None:
    picture = leaning[1][0]
    cost, half = np.ones(picture.known.shape, np.float32), picture.known.copy()
    half[:, :96] = False
    assert unexplained(picture, cost, 7)
    masks = unexplained(replace(picture, known=half), cost, 7)
    assert masks
    assert all((mask & half).sum() >= 0.9 * mask.sum() for mask in masks)


def test_a_plane_keeps_its_place_from_picture_to_world() -> None:
    camera = ring(3)[1]
    plane = np.array([0.48, 0.6, 0.64, 0.2])
    pixels = camera.pixel_centres()
    depth_m = Picture(camera, np.zeros((*camera.hw, 3), np.float32), np.ones(camera.hw, bool)).depth_of(
        np.broadcast_to(plane, (*camera.hw, 4))
    )
    hit = depth_m > 0
    design = np.column_stack([pixels[hit], np.ones(hit.sum())])
    w = np.linalg.lstsq(design, 1 / depth_m[hit], rcond=None)[0]
    back = world_plane(camera, w)
    np.testing.assert_allclose(back * np.sign(back[:3] @ plane[:3]), plane, atol=1e-9)


@pytest.fixture(scope="module")
def refined(
    tmp_path_factory: pytest.TempPathFactory, default_settings: Callable[..., dict]
) -> Callable[[int], tuple[bytes, Path]]:
    """The board's room on file, and a function that writes the first front camera's depth with so many planes."""
    folder = tmp_path_factory.mktemp("regions")
    room, cameras = made_room(table=False), ring(5)
    plates = write_capture(folder, cameras, [with_board(room, c)[0] for c in cameras])
    fitted = RoomBox(
        room.room_box.yaw_rad, room.room_box.low_m, room.room_box.high_m, np.ones(6, bool), np.full(6, 0.9)
    )
    write_room(folder / "room.json", replace(fitted, gains={c.name: np.ones(3) for c in cameras}, planes=fitted.faces))
    write_primitives(folder / "primitives.json", [])
    write_npz(folder / "passes.npz", {f"depth_{c.name}": d for c, d in zip(cameras, on_walls(room, cameras))})
    front = cameras[in_front_of_it(cameras)[0]]

    def write(regions: int) -> tuple[bytes, Path]:
        settings = load(refine.Settings, default_settings("depth", refine_width=192, regions=regions), "depth")
        out = folder / f"{regions}.exr"
        refine.run(
            settings,
            front.name,
            folder / "cameras/images.txt",
            plates,
            folder / "passes.npz",
            folder / "room.json",
            folder / "primitives.json",
            out,
        )
        return out.read_bytes(), out

    write.truth = with_board(room, front)[1:]
    return write


def test_off_is_off(refined: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    first, _ = refined(0)

    def never(*_: object, **__: object) -> Regions:
        raise AssertionError("regions are looked for though they are switched off")

    monkeypatch.setattr(refine, "explain_regions", never)
    assert refined(0)[0] == first


def test_the_file_holds_the_board_and_says_how_sure_it_is(refined: Callable) -> None:
    depth_m, board = refined.truth
    (off_m, _), (on_m, sure) = read_depth(refined(0)[1]), read_depth(refined(100)[1])
    error = [np.abs(d - depth_m)[board] / depth_m[board] for d in (off_m, on_m)]
    assert np.mean(error[0]) > 0.2
    assert np.mean(error[1]) < 0.4 * np.mean(error[0])
    moved = (on_m != off_m) & board
    assert moved.mean() > 0.02
    assert np.median(sure[moved]) > 0.5
    assert (on_m == off_m)[~board].mean() > 0.95
