# SPDX-License-Identifier: Apache-2.0
"""The first film: where it goes, that it shows the room, and that what nobody sees stays grey."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.depth import box, preview, sweep
from studiorecon.depth.stereo.plates import Picture
from studiorecon.footage.video import read_frame, read_stack
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.scene.camera import Camera

from tests.made.room import made_room, photograph, ring, write_capture

SMALL = {"sweep_width": 96, "wall_step_m": 0.1, "reach_m": 5.0, "furniture_m": 0.5}


def azimuths(cameras: list[Camera]) -> np.ndarray:
    middle = scene_centre(cameras)
    return np.array([np.arctan2(*(c.centre_m - middle)[1::-1]) for c in cameras])


def test_the_film_goes_once_around_through_every_camera() -> None:
    cameras = ring(4, wh=(96, 54))
    way = preview.preview_path(cameras)
    assert all(min(np.linalg.norm(c.centre_m - own.centre_m) for c in way) < 1e-9 for own in cameras)
    turned = np.diff(np.unwrap(azimuths(way)))
    assert (turned > 0).all()
    assert turned.sum() + turned.mean() == pytest.approx(2 * np.pi, rel=0.02), "it ends where it began"


def test_the_film_turns_back_where_nobody_filmed() -> None:
    two = ring(4, wh=(96, 54))[:2]
    way = preview.preview_path(two)
    assert np.ptp(np.unwrap(azimuths(way))) <= np.ptp(np.unwrap(azimuths(two))) + 1e-3
    assert all(min(np.linalg.norm(c.centre_m - own.centre_m) for c in way) < 1e-9 for own in two)
    steps = [np.linalg.norm(a.centre_m - b.centre_m) for a, b in zip(way, [*way[1:], way[0]])]
    assert max(steps) < 1.01 * min(steps), "there and back without a jump or a stop, and again from the start"


def test_one_camera_stays_where_it_is() -> None:
    way = preview.preview_path(ring(4, wh=(96, 54))[:1])
    assert len(way) > 1
    assert all(np.array_equal(c.camera_from_world, way[0].camera_from_world) for c in way)


def test_the_film_shows_the_plates_where_the_cameras_stand(tmp_path: Path) -> None:
    room, cameras = made_room(table=False), ring(4, wh=(96, 54))
    shots = [photograph(room, camera)[0] for camera in cameras]
    plates = write_capture(tmp_path, cameras, shots)
    model = tmp_path / "cameras" / "images.txt"
    sweeps = [tmp_path / f"{camera.name}.npz" for camera in cameras]
    for camera, path in zip(cameras, sweeps):
        sweep.run(load(sweep.Settings, SMALL, "depth"), camera.name, model, plates, path)
    walls, film = tmp_path / "box.json", tmp_path / "preview.mp4"
    box.run(load(box.Settings, SMALL, "depth"), model, plates, sweeps, walls)
    preview.run(load(preview.Settings, SMALL, "depth"), model, plates, sweeps, walls, film)
    off, other = (np.abs(read_frame(film, number) / 255.0 - shots[0]).mean() for number in (0, 24))
    assert off < 0.08
    assert off < other / 2
    assert len(read_stack(film)) == 96


def test_what_no_camera_sees_is_grey() -> None:
    camera = ring(4, wh=(96, 54))[0]
    rgb, depth_m = np.ones((54, 96, 3), np.float32), np.full((54, 96), 3.0, np.float32)
    depth_m[:, 48:] = 0.0
    picture = next(
        iter(
            preview.draw_views(
                preview.discs_from_depths([Picture(camera, rgb, np.ones((54, 96), bool))], [depth_m]), [camera]
            )
        )
    )
    assert (picture[10:44, 60:90] == 128).all()
    assert (picture[10:44, 8:36] > 230).all()
