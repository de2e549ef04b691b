# SPDX-License-Identifier: Apache-2.0
"""Depth of a made room: walls to the centimetre, the bars of its accuracy, and honest answers where there is nothing to
measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.depth import box as walls
from studiorecon.depth import given, refine, sweep
from studiorecon.depth import room as room_box
from studiorecon.depth.layout.box import choose_faces, most_voted_offsets, refine_yaw
from studiorecon.depth.layout.primitives import read_primitives
from studiorecon.depth.layout.votes import Votes, read_sweeps
from studiorecon.depth.layout.yaw import match_yaw
from studiorecon.depth.stereo.matching import plane_depth
from studiorecon.depth.stereo.planes import wall_yaw
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.sweep_settings import DefaultConfidence, Matching
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.room import RoomBox, read_room, write_room

from tests.made.room import made_room, photograph, ring, write_capture

# A thinner catalogue than the default: the room is small and the tests are many.
THIN = {
    "sweep_width": 144,
    "refine_width": 192,
    "wall_step_m": 0.08,
    "reach_m": 6.0,
    "furniture_m": 1.0,
}
# Furniture where a test asks for it.
THIN |= {"primitives": 0}
FURNISHED = THIN | {"primitives": 3, "primitives_width": 96, "primitives_gain": 20.0}


@dataclass(frozen=True)
class Found:
    """What the three steps wrote."""

    room_box: RoomBox
    depth_m: list[np.ndarray]
    confidence: list[np.ndarray]


def estimate(folder: Path, cameras: list[Camera], plates: list[Path], section: dict) -> Found:
    model = folder / "cameras" / "images.txt"
    sweeps = [folder / f"{c.name}.sweep.npz" for c in cameras]
    for camera, path in zip(cameras, sweeps):
        sweep.run(load(sweep.Settings, section, "depth"), camera.name, model, plates, path)
    box, primitives = folder / "room.json", folder / "primitives.json"
    walls.run(load(walls.Settings, section, "depth"), model, plates, sweeps, folder / "box.json")
    files = folder / "box.json", [], box, primitives, folder / "primitives.png"
    room_box.run(load(room_box.Settings, section, "depth"), model, plates, sweeps, *files)
    maps = []
    for camera in cameras:
        out = folder / f"{camera.name}.exr"
        refine.run(load(refine.Settings, section, "depth"), camera.name, model, plates, box, primitives, [], out)
        maps.append(read_depth(out))
    return Found(read_room(folder / "room.json"), [d for d, _ in maps], [a for _, a in maps])


def relative_errors(found: Found, truth: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([(np.abs(d - t) / t).ravel() for d, t in zip(found.depth_m, truth)])


@pytest.fixture(scope="module")
def furnished(
    tmp_path_factory: pytest.TempPathFactory, default_settings: Callable[..., dict]
) -> tuple[Found, list[np.ndarray], Path]:
    """A turned room with a cupboard, cameras whose exposure differs by ±12 %, and part of one plate never seen
    empty."""
    folder = tmp_path_factory.mktemp("furnished")
    room, cameras = made_room(), ring()
    pictures, truth = zip(*(photograph(room, camera) for camera in cameras))
    gains = np.exp(np.array([[0.12, 0.1, 0.08], [-0.12, -0.1, -0.06], [0.02, 0.0, -0.05], [-0.02, 0.0, 0.03]]))
    exposed = [np.clip(p * g, 0, 1) for p, g in zip(pictures, gains)]
    unknown = np.zeros(cameras[0].hw, bool)
    unknown[70:90, 20:40] = True
    plates = write_capture(folder, cameras, exposed, unknown)
    return estimate(folder, cameras, plates, default_settings("depth", **FURNISHED)), list(truth), folder


def test_walls_are_placed_to_two_centimetres(furnished: tuple[Found, list[np.ndarray], Path]) -> None:
    found = furnished[0].room_box
    # The box may be described with u along any of the four wall directions.
    truth = made_room().room_box
    for face, fitted in zip(found.faces[:4], found.fitted[:4]):
        assert fitted
        along = truth.axes[:2] @ face[:3]
        axis = int(np.abs(along).argmax())
        assert np.abs(along[axis]) > np.cos(np.radians(0.4))
        assert min(abs(face[3] * np.sign(along[axis]) - w) for w in (truth.low_m[axis], truth.high_m[axis])) < 0.02
    assert found.fitted[4]
    assert abs(found.low_m[2]) < 0.02
    assert np.prod((found.high_m - found.low_m)[:2]) == pytest.approx(6.2 * 5.7, rel=0.02)


def test_depth_meets_its_bars(furnished: tuple[Found, list[np.ndarray], Path]) -> None:
    error = relative_errors(*furnished[:2])
    assert error.mean() <= 0.06
    assert (error < 0.05).mean() >= 0.80


def test_unequal_exposure_is_found(furnished: tuple[Found, list[np.ndarray], Path]) -> None:
    gains = np.stack([furnished[0].room_box.gains[f"cam{k}"] for k in (1, 2, 3, 4)])
    planted = np.exp(np.array([[0.12, 0.1, 0.08], [-0.12, -0.1, -0.06], [0.02, 0.0, -0.05], [-0.02, 0.0, 0.03]]))
    assert np.abs(np.log(gains / planted)).max() < 0.02


def test_confidence_tells_measured_from_default(
    furnished: tuple[Found, list[np.ndarray], Path], default_settings: Callable
) -> None:
    found, truth, _ = furnished
    error = relative_errors(found, truth)
    confidence = np.concatenate([c.ravel() for c in found.confidence])
    rests = confidence <= DefaultConfidence().default_confidence
    assert 0.05 < rests.mean() < 0.6
    sure = confidence > 0.7
    assert sure.mean() > 0.3
    assert (error[sure] < 0.05).mean() > 0.93
    # Pixels whose plate was never measured cannot have been judged.
    for a in found.confidence:
        assert (a[74:86, 24:36] <= 0.2).all()


def test_open_air_has_no_walls_and_says_so(
    tmp_path: Path, default_settings: Callable, capsys: pytest.CaptureFixture
) -> None:
    room, cameras = made_room(open_air=True), ring(3, target_m=1.5)
    pictures, truth = zip(*(photograph(room, camera) for camera in cameras))
    section = default_settings("depth", **THIN)
    found = estimate(tmp_path, cameras, write_capture(tmp_path, cameras, pictures), section)
    assert not found.room_box.fitted[[0, 1, 2, 3, 5]].any()
    assert found.room_box.fitted[4]
    assert "default" in capsys.readouterr().out
    near = np.concatenate([((t > 0) & (t < 5)).ravel() for t in truth])
    error = np.concatenate([(np.abs(d - t) / np.maximum(t, 1)).ravel() for d, t in zip(found.depth_m, truth)])
    assert (error[near] < 0.05).mean() > 0.9
    sky = np.concatenate([(t == 0)[:40].ravel() for t in truth])
    first_rows = np.concatenate([c[:40].ravel() for c in found.confidence])
    assert (first_rows[sky] <= 0.3).mean() > 0.9
    assert all((d > 0).all() for d in found.depth_m)


def test_a_single_camera_rests_on_the_default(tmp_path: Path, default_settings: Callable) -> None:
    cameras = ring(1)
    rgb, _ = photograph(made_room(), cameras[0])
    found = estimate(tmp_path, cameras, write_capture(tmp_path, cameras, [rgb]), default_settings("depth", **THIN))
    assert not found.room_box.fitted.any()
    assert (found.confidence[0] <= 0.2).all()
    assert np.isfinite(found.depth_m[0]).all()
    floor = plane_depth(cameras[0], np.array([0, 0, 1.0, 0]), 0.1, 50.0)
    assert np.abs(found.depth_m[0] - floor)[-10:].max() < 1e-3


def test_yaw_of_the_walls_is_found_with_and_without_lines() -> None:
    cameras = ring()
    for lines, tolerance_deg in ((True, 0.5), (False, 4.0)):
        room = made_room(lines=lines, table=False)
        pictures = [Picture(c, photograph(room, c)[0], np.ones(c.hw, bool)) for c in cameras]
        yaw_rad, support = wall_yaw(cameras, [p.rgb for p in pictures], [p.known for p in pictures])
        assert (support > 0.12) == lines
        if not lines:
            yaw_rad = match_yaw(pictures, 0.0, 6.0, Matching())
        assert abs((np.degrees(yaw_rad - 0.35) + 45) % 90 - 45) < tolerance_deg


def test_walls_are_turned_by_less_than_a_step(default_settings: Callable[..., dict]) -> None:
    room = made_room(table=False)
    pictures = [Picture(c, photograph(room, c)[0], np.ones(c.hw, bool)) for c in ring()]
    off_rad = np.radians(0.35)
    turned = replace(room.room_box, yaw_rad=room.room_box.yaw_rad - off_rad)
    seen = [room.room_box.intersect(*p.camera.rays())[1] for p in pictures]
    on_walls = [(turned.faces[face], [at == face for at in seen]) for face in range(4)]
    how = load(walls.Settings, default_settings("depth", **THIN), "depth")
    found_rad = refine_yaw(pictures, on_walls, 4 * off_rad, 2 * off_rad, how)
    assert np.degrees(abs(found_rad - off_rad)) < 0.15, "a step is 0.7 degrees"


def test_rival_walls_are_decided_by_what_the_window_holds() -> None:
    # Stripes every 0.75 m match themselves one period further in; the most voted plane was 0.75 m wrong on the made
    # studio.
    planes = np.array([[1.0, 0, 0, o] for o in np.arange(1.0, 5.0, 0.1)])
    votes = np.zeros(len(planes), int)
    votes[[10, 11, 20, 30]] = [500, 300, 450, 20]
    found = most_voted_offsets(planes, votes, np.array([1.0, 0, 0]), 1.5, 1, 100)
    assert np.allclose(found, [2.0 + 0.1 * 300 / 800, 3.0])
    assert most_voted_offsets(planes, votes, np.array([1.0, 0, 0]), 3.5, 1, 100) == []
    assert most_voted_offsets(planes, votes, np.array([0, 1.0, 0]), 1.5, 1, 100) == []


def test_a_wall_is_where_the_whole_box_explains_most_and_missing_where_nothing_matches() -> None:
    room, cameras = made_room(table=False), ring()
    pictures = [Picture(c, photograph(room, c)[0], np.ones(c.hw, bool)) for c in cameras]
    nobody = Votes(np.zeros((1, 4)), [np.zeros(c.hw, int) for c in cameras], [np.zeros(c.hw, bool) for c in cameras])
    bare = room.room_box.with_faces(dict(enumerate((-12.0, 12.0, -12.0, 12.0, 0.0, 12.0))))
    # Furniture a metre before the wall got more votes, and chance matches some behind another.
    offsets = {1: [2.3, 3.3], 2: [-5.0], 3: [3.1], 5: []}
    assert choose_faces(pictures, nobody, bare, offsets, Matching()) == {1: 3.3, 3: 3.1}


def test_plates_must_fit_their_cameras(tmp_path: Path, default_settings: Callable) -> None:
    cameras = ring(2, wh=(48, 32))
    plates = write_capture(tmp_path, [c.resized((24, 16)) for c in cameras], [np.zeros((16, 24, 3))] * 2)
    write_capture(tmp_path, cameras, [])
    settings = load(sweep.Settings, default_settings("depth"), "depth")
    with pytest.raises(UserError, match=r"cam1\.plate\.png .*24×16"):
        sweep.run(settings, "cam1", tmp_path / "cameras/images.txt", plates, tmp_path / "s.npz")
    with pytest.raises(UserError, match="no camera cam9"):
        sweep.run(settings, "cam9", tmp_path / "cameras/images.txt", plates, tmp_path / "s.npz")
    assert not (tmp_path / "s.npz").exists()


def test_a_floor_with_too_few_voters_is_a_default_and_its_file_is_read(
    tmp_path: Path, default_settings: Callable
) -> None:
    room, cameras, floor = made_room(), ring(wh=(96, 54)), np.array([[0.0, 0.0, 1.0, 0.0]])
    pictures = [Picture(c, photograph(room, c)[0], np.ones(c.hw, bool)) for c in cameras]
    near = [(p.depth(floor[0], Matching()) > 0) & (p.depth(floor[0], Matching()) < 4.0) for p in pictures]
    votes = Votes(floor, [np.zeros(c.hw, int) for c in cameras], near)
    settings = load(walls.Settings, default_settings("depth"), "depth")
    for wall_votes, enough in ((0.004, True), (1.1, False)):
        found = walls.fit_room_box(pictures, votes, 0.0, 0.0, replace(settings, wall_votes=wall_votes))
        write_room(tmp_path / "room.json", found)
        again = read_room(tmp_path / "room.json")
        assert again.fitted[4] == np.isfinite(again.score[4]) == enough


def test_given_depth_is_fitted_and_cleaned(tmp_path: Path, default_settings: Callable) -> None:
    cameras = ring(1, wh=(48, 32))
    write_capture(tmp_path, cameras, [])
    depth = np.where(np.arange(96) < 50, 2.0, 6.0)[None].repeat(64, 0).astype(np.float32)
    depth[:4, 0], depth[4:8, 0], depth[8:12, 0] = np.nan, np.inf, -1
    write_depth(tmp_path / "given.exr", depth, np.full(depth.shape, np.float32(np.nan)))
    settings = load(given.Settings, default_settings("depth"), "depth")
    given.run(settings, "cam1", tmp_path / "cameras/images.txt", tmp_path / "given.exr", tmp_path / "out.exr")
    found, confidence = read_depth(tmp_path / "out.exr")
    assert found.shape == (32, 48)
    assert set(np.unique(found)) <= {0.0, 2.0, 6.0}
    assert (confidence >= 0).all()
    write_depth(tmp_path / "square.exr", np.ones((50, 50)), np.ones((50, 50)))
    with pytest.raises(UserError, match="another shape"):
        given.run(settings, "cam1", tmp_path / "cameras/images.txt", tmp_path / "square.exr", tmp_path / "no.exr")
    write_depth(tmp_path / "empty.exr", np.zeros((32, 48)), np.zeros((32, 48)))
    with pytest.raises(UserError, match=r"0\.0%"):
        given.run(settings, "cam1", tmp_path / "cameras/images.txt", tmp_path / "empty.exr", tmp_path / "no.exr")
    assert not (tmp_path / "no.exr").exists()


# Coarser still: nothing is measured to the centimetre where cameras are blind.
COARSE = THIN | {"sweep_width": 96, "refine_width": 96, "wall_step_m": 0.16}


def test_sweeps_of_other_settings_are_refused_until_all_are_made_again(tmp_path: Path) -> None:
    files = [tmp_path / f"cam{k}.sweep.npz" for k in (1, 2)]

    def made(path: Path, offset_m: float) -> None:
        one = {"planes": np.array([[0, 0, 1.0, offset_m]]), "chosen": np.zeros((5, 7), np.int16), "floor_m": 0.0}
        write_npz(path, one | {"cost": np.zeros((5, 7)), "confident": np.ones((5, 7), bool), "yaw_rad": 0.0,
                               "gains": np.ones((2, 3))})  # fmt: skip

    for k, path in enumerate(files):
        made(path, 0.1 * k)
    with pytest.raises(UserError, match="delete it"):
        read_sweeps(files, 2)
    for path in files:
        path.unlink()
        made(path, 0.1)
    assert read_sweeps(files, 2).votes.count().tolist() == [70]


def test_plates_never_measured_at_all_are_undetermined(tmp_path: Path, default_settings: Callable) -> None:
    room, cameras = made_room(), ring()
    plates = write_capture(tmp_path, cameras, [photograph(room, c)[0] for c in cameras], np.ones(cameras[0].hw, bool))
    found = estimate(
        tmp_path, cameras, plates, default_settings("depth", **COARSE | {"primitives": 1, "primitives_width": 96})
    )
    assert not found.room_box.fitted.any()
    assert read_primitives(tmp_path / "primitives.json") == []
    for depth_m, confidence in zip(found.depth_m, found.confidence):
        assert np.isfinite(depth_m).all()
        assert (confidence <= 0.2).all()
