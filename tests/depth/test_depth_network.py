# SPDX-License-Identifier: Apache-2.0
"""A network's depth: to metres by what stereo measured, files of any kind, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.settings import load
from studiorecon.depth import aligned, network
from studiorecon.depth.sweep_settings import DefaultConfidence
from studiorecon.errors import UserError
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
    """A model of four cameras, their plates, and the planes' depth: exact, measured on the left two thirds."""
    views = room_views(WH)
    write_model(tmp_path / "cameras", [c for c, _, _ in views])
    for camera, rgb, depth_m in views:
        write_plate(tmp_path / f"{camera.name}.plate.png", rgb, np.ones(camera.hw, bool))
        sure = np.full(camera.hw, 0.9, np.float32)
        sure[:, 64:] = 0.1
        planes = depth_m.copy()
        planes[:, 64:] *= 1.3
        write_depth(tmp_path / f"{camera.name}.planes.exr", planes, sure)
    return tmp_path


def align(folder: Path, settings: dict, estimate: Path) -> tuple[np.ndarray, np.ndarray]:
    model = folder / "cameras/images.txt"
    values = load(aligned.Settings, settings, "depth")
    aligned.run(values, "cam1", model, estimate, folder / "cam1.planes.exr", folder / "cam1.exr")
    return read_depth(folder / "cam1.exr")


def test_a_network_in_any_unit_ends_in_metres(
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
            depth = (self._left.pop(0)[1] - 0.4) / 3.7
            return np.where(np.arange(WH[0]) < 90, depth, 0).astype(np.float32)

    monkeypatch.setattr(moge, "ADAPTER", Planted)
    settings = default_settings("depth", source="moge")
    names = list(views)
    network.run(
        load(network.Settings, settings, "depth"),
        folder / "cameras/images.txt",
        [folder / f"{n}.plate.png" for n in names],
        folder,
        "cpu",
        # A camera that was left out when cameras were found: planned, and not in the model.
        [folder / f"{n}.estimate.exr" for n in ["gone", *names]],
    )
    assert not read_depth(folder / "gone.estimate.exr")[0].any()
    assert focals == pytest.approx([c.focal_px[0] for c, _ in views.values()])
    depth_m, sure = align(folder, settings, folder / "cam1.estimate.exr")
    truth = views["cam1"][1]
    np.testing.assert_allclose(depth_m[:, :90], truth[:, :90], rtol=0.01)
    assert not depth_m[:, 90:].any()
    assert not sure[:, 90:].any()
    # Where the planes only guessed, and guessed otherwise, the network stands alone: inferred, not measured.
    assert (sure[:, :64] > DefaultConfidence().default_confidence).mean() > 0.95
    assert (sure[:, 66:90] <= DefaultConfidence().default_confidence + 1e-6).all()


@pytest.mark.parametrize("kind", [".exr", ".npy", ".npz", ".png"])
def test_files_of_a_network_are_read_whatever_they_are(folder: Path, default_settings: Callable, kind: str) -> None:
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
    depth_m, _ = align(folder, default_settings("depth"), path)
    assert not depth_m[:9].any()
    assert np.median(np.abs(depth_m[11:] / room_views(WH)[0][2][11:] - 1)) < 0.01


def test_what_cannot_be_put_to_scale_is_refused(folder: Path, default_settings: Callable) -> None:
    settings = default_settings("depth")
    with pytest.raises(UserError, match=r"is missing; depth\.precomputed"):
        align(folder, settings, folder / "none.npy")
    np.save(folder / "square.npy", np.ones((50, 50)))
    with pytest.raises(UserError, match="another shape than camera cam1"):
        align(folder, settings, folder / "square.npy")
    np.save(folder / "blank.npy", np.zeros((54, 96)))
    with pytest.raises(UserError, match="is unknown: stereo measures only"):
        align(folder, settings, folder / "blank.npy")
    np.save(folder / "noise.npy", np.random.default_rng(0).uniform(0.01, 50, (54, 96)))
    with pytest.raises(UserError, match="not the same view"):
        align(folder, settings, folder / "noise.npy")
    np.savez(folder / "other.npz", colour=np.ones((54, 96)))
    with pytest.raises(UserError, match="holds colour"):
        align(folder, settings, folder / "other.npz")


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
    ((found, sure),) = network.estimates("pi3", [camera], [(rgb * 255).astype(np.uint8)], tmp_path, "cpu")
    assert found.shape == sure.shape == camera.hw
    assert np.median(np.abs(found / depth - 1)) < 0.02
