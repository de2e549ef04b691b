# SPDX-License-Identifier: Apache-2.0
"""A network's depth of every camera, files of it of any kind, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.settings import load
from studiorecon.depth import network
from studiorecon.depth.estimates import read_camera_estimate
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.images.plate import write_plate
from studiorecon.models.adapters import moge, pi3
from studiorecon.models.catalogue.card import Card
from studiorecon.models.protocols import Reconstruction
from studiorecon.scene.camera import Camera

from tests.made.networks import room_views

WH = (96, 54)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model of four cameras and their plates."""
    views = room_views(WH)
    write_model(tmp_path / "cameras", [c for c, _, _ in views])
    for camera, rgb, _ in views:
        write_plate(tmp_path / f"{camera.name}.plate.png", rgb, np.ones(camera.hw, bool))
    return tmp_path


def test_every_camera_has_its_estimate(
    folder: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    views = {c.name: (c, d) for c, _, d in room_views(WH)}
    focals = []

    class Planted:
        def __init__(self, card: Card, weights: Path, where: str) -> None:
            assert (card.name, where) == ("moge", "cpu")
            self._left = list(views.values())

        def depth(self, picture: np.ndarray, focal_px: float | None) -> np.ndarray:
            focals.append(focal_px)
            return np.where(np.arange(WH[0]) < 90, self._left.pop(0)[1] / 3.7, 0).astype(np.float32)

    monkeypatch.setattr(moge, "ADAPTER", Planted)
    names = list(views)
    network.run(
        load(network.Settings, default_settings("depth", source="moge"), "depth"),
        folder / "cameras/images.txt",
        [folder / f"{n}.plate.png" for n in names],
        [],
        folder,
        "cpu",
        # A camera that was left out when cameras were found: planned, and not in the model.
        [folder / f"{n}.estimate.exr" for n in ["gone", *names]],
    )
    assert not read_depth(folder / "gone.estimate.exr")[0].any()
    assert focals == pytest.approx([c.focal_px[0] for c, _ in views.values()])
    depth, sure = read_depth(folder / "cam1.estimate.exr")
    np.testing.assert_allclose(depth[:, :90], views["cam1"][1][:, :90] / 3.7, rtol=1e-3)
    assert not depth[:, 90:].any()
    assert not sure[:, 90:].any()


@pytest.mark.parametrize("kind", [".exr", ".npy", ".npz", ".png"])
def test_files_of_a_network_are_read_whatever_they_are(folder: Path, kind: str) -> None:
    depth = room_views((192, 108))[0][2].astype(np.float32) * 0.5
    depth[:20] = np.inf if kind != ".png" else 0
    path = folder / f"mine{kind}"
    if kind == ".exr":
        write_depth(path, np.where(np.isfinite(depth), depth, 0), np.ones_like(depth))
    elif kind == ".npy":
        np.save(path, depth[None, ..., None])
    elif kind == ".npz":
        np.savez(path, depth=depth)
    else:
        cv2.imwrite(str(path), np.rint(depth * 1000).astype(np.uint16))
    found = read_camera_estimate(path, room_views(WH)[0][0])
    assert not found[:9].any()
    assert np.median(np.abs(2 * found[11:] / room_views(WH)[0][2][11:] - 1)) < 0.01


DEPTH = np.full((54, 96), 2.0, np.float32)


def text(path: Path, content: np.ndarray) -> None:
    np.save(path, content.astype(str))


def test_pi3s_depth_comes_at_the_pictures_size(
    default_settings: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    camera, rgb, depth = room_views(WH)[0]

    class Planted:
        def __init__(self, *_: object) -> None: ...

        def reconstruct(self, pictures: list[np.ndarray], names: list[str]) -> Reconstruction:
            small = Camera(names[0], (48, 27), camera.resized((48, 27)).intrinsics, np.eye(4))
            return Reconstruction([small], [depth[::2, ::2]], [np.full((27, 48), 0.5, np.float32)], [0.1], False)

    monkeypatch.setattr(pi3, "ADAPTER", Planted)
    ((found, sure),) = network.estimate_depths("pi3", [camera], [(rgb * 255).astype(np.uint8)], [], tmp_path, "cpu")
    assert found.shape == sure.shape == camera.hw
    assert np.median(np.abs(found / depth - 1)) < 0.02
