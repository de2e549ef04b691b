# SPDX-License-Identifier: Apache-2.0
"""Cameras by a network: its unit becomes metres by people's torsos, and its model is read like any other
calibration."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration import files as calibration
from studiorecon.calibration import network
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.models.adapters import pi3
from studiorecon.models.catalogue.card import Card
from studiorecon.models.protocols import Reconstruction
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import Clock, Clocks, write_clocks
from studiorecon.scene.people import Detections, read_detections, write_detections
from studiorecon.scene.schema import record

from tests.made.imported import imported
from tests.made.networks import room_views

WH = (192, 108)
UNIT = 0.37
TORSO_M = 0.5


def person(camera: Camera, depth_m: float, torso_m: float) -> np.ndarray:
    """(25, 3) keypoints of somebody who faces the camera at ``depth_m``: shoulders above hips by ``torso_m``."""
    layout = LAYOUTS["body_25"]
    points = np.zeros((25, 3))
    for name, x, y in zip(network.TORSO, (0.2, -0.2, 0.1, -0.1), (-torso_m, -torso_m, 0.0, 0.0)):
        pixel = np.array([x, y]) * camera.focal_px[0] / depth_m + camera.principal_px
        points[layout.index(name)] = [*pixel, 0.9]
    return points


def planted(metric: bool = False, noise: float = 0.0) -> tuple[Reconstruction, list[Detections]]:
    """The room's cameras in another unit, at half the footage's size, and somebody three metres before each."""
    views = room_views(WH)
    first = views[0][0]
    cameras, depths, seen = [], [], []
    for k, (camera, _, _) in enumerate(views):
        pose = camera.camera_from_world @ first.world_from_camera
        pose[:3, 3] *= UNIT
        cameras.append(replace(camera.resized((96, 54)), camera_from_world=pose))
        depths.append(np.full((54, 96), 3.0 * UNIT * (1 + noise * k), np.float32))
        keypoints = person(camera, 3.0, TORSO_M)[None]
        seen.append(Detections(camera.name, "body_25", np.array([0]), np.array([0]), keypoints))
    return Reconstruction(cameras, depths, [np.ones((54, 96), np.float32)] * 4, [0.1] * 4, metric), seen


def test_torsos_say_how_long_a_unit_is() -> None:
    found, seen = planted()
    lengths = network.torso_lengths(found, [WH] * 4, seen, 0.4)
    np.testing.assert_allclose(lengths, TORSO_M * UNIT, rtol=1e-6)
    factor, reported = network.metres_per_unit(lengths, TORSO_M, False, "Pi3")
    assert factor == pytest.approx(1 / UNIT, rel=1e-6)
    assert "4 torsos" in reported
    # Held-out cameras bring none: those that do are told by their names.
    uneven, seen = planted(noise=0.1)
    some = network.torso_lengths(uneven, [WH] * 4, [seen[3], seen[1]], 0.4)
    np.testing.assert_allclose(some, TORSO_M * UNIT * np.array([1.3, 1.1]), rtol=1e-6)
    later = [replace(d, frame=np.array([5])) for d in seen]
    assert not len(network.torso_lengths(found, [WH] * 4, later, 0.4)), "only the frame that the network saw counts"


def test_a_keypoint_on_a_jump_in_depth_does_no_harm() -> None:
    found, seen = planted()
    layout, camera = LAYOUTS["body_25"], found.cameras[0]
    column, row = (seen[0].keypoints[0, layout.index("left_hip"), :2] / 2).astype(int)
    found.depths[0][row, column] = 9 * UNIT
    assert camera.wh == (96, 54)
    np.testing.assert_allclose(network.torso_lengths(found, [WH] * 4, seen, 0.4), TORSO_M * UNIT, rtol=1e-6)


def test_what_has_no_unit_is_refused() -> None:
    with pytest.raises(UserError, match="Pi3 has no unit"):
        network.metres_per_unit(np.zeros(0), TORSO_M, False, "Pi3")
    assert network.metres_per_unit(np.zeros(0), TORSO_M, True, "Pi3X")[0] == 1.0
    found, seen = planted(noise=0.8)
    with pytest.raises(UserError, match=r"differ by a factor of 1\.\d within the scene"):
        network.metres_per_unit(network.torso_lengths(found, [WH] * 4, seen, 0.4), TORSO_M, False, "Pi3")


def test_footage_becomes_a_calibration_in_metres(
    tmp_path: Path, root: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, seen = planted()
    truth = [c for c, _, _ in room_views(WH)]
    names = [c.name for c in truth]
    requested = []

    class Planted:
        def __init__(self, card: Card, weights: Path, where: str) -> None:
            assert card.name == "pi3x"

        def reconstruct(self, pictures: list[np.ndarray], cameras: list[str]) -> Reconstruction:
            requested.append((cameras, pictures))
            return found

    monkeypatch.setattr(pi3, "ADAPTER", Planted)
    starts = [0, 2, 0, 1]
    for (camera, rgb, _), detections, start in zip(room_views(WH), seen, starts):
        # Before the common start a camera shows something else.
        write_lossless(tmp_path / f"{camera.name}.mkv", [255 - to_bytes(rgb)] * start + [to_bytes(rgb)] * 2, 24.0)
        write_detections(tmp_path / f"{camera.name}.npz", detections)
    settings = load(network.Settings, default_settings("cameras", source="pi3x"), "cameras")
    model = tmp_path / "network/images.txt"
    # The last camera is held out.
    sources, sightings = [tmp_path / f"{n}.mkv" for n in names], [tmp_path / f"{n}.npz" for n in names[:-1]]
    # Every camera has two pictures of the room, after as many of something else as its start says.
    clocks = tuple(Clock(name, 24.0, start + 2, offset_s=-start / 24) for name, start in zip(names, starts))
    write_clocks(tmp_path / "clocks.json", Clocks(24.0, 0.0, 2, clocks))
    for path, start in zip(sightings, starts):
        write_detections(path, replace(read_detections(path), frame=read_detections(path).frame + start))
    network.run(
        settings,
        names,
        sources,
        tmp_path / "clocks.json",
        sightings,
        root / "resources/body.npz",
        tmp_path,
        "cpu",
        model,
        depths := [tmp_path / f"network/{n}.exr" for n in names],
    )
    ((cameras, pictures),) = requested
    assert cameras == names
    for picture, (_, rgb, _) in zip(pictures, room_views(WH), strict=True):
        np.testing.assert_array_equal(picture, to_bytes(rgb))
    files = [tmp_path / "network/cameras.txt", model]
    imported(
        load(calibration.Settings, default_settings("cameras"), "cameras"),
        files,
        names,
        "{}",
        tmp_path / "calibration.json",
    )
    lenses = [record(Lens, v) for v in json.loads((tmp_path / "calibration.json").read_text())["lenses"]]
    own = np.array([-lens.camera_from_world[:3, :3].T @ lens.camera_from_world[:3, 3] for lens in lenses])
    true = np.array([c.centre_m for c in truth])
    gaps, wanted = (np.linalg.norm(x[:, None] - x[None], axis=-1) for x in (own, true))
    factor = gaps[0, 1] / wanted[0, 1]
    np.testing.assert_allclose(gaps, factor * wanted, rtol=1e-6)
    # The bundled body's torso is not exactly half a metre: lengths follow it.
    assert 0.8 < factor < 1.25
    # Depth is in the metres of the cameras.
    for path in depths:
        np.testing.assert_allclose(read_depth(path)[0], 3.0 * factor, rtol=1e-4)
    assert np.ptp(own[:, 2]) < 1e-3, "z is up: the ring of cameras is level"
    for lens, camera in zip(lenses, truth):
        assert lens.wh == WH
        np.testing.assert_allclose(lens.intrinsics, camera.intrinsics, rtol=1e-9)
