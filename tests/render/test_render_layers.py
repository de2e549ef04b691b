# SPDX-License-Identifier: Apache-2.0
"""render: a film split into OpenEXR layers, read back with the OpenEXR package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.exr import write_channels
from studiorecon.footage.video import read_stack, to_bytes
from studiorecon.render import layers as render_layers
from studiorecon.render import shot as render_shot

from tests.made.render_layers import channels_of
from tests.made.scene import render_options, write_scene
from tests.made.steps import call

HALF = (
    "R",
    "G",
    "B",
    "A",
    "NX",
    "NY",
    "NZ",
    "truth.measured",
    "truth.inferred",
    "truth.invented",
    "matte.room",
    "matte.p0",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, filmed=False)
    section = default_settings("render")
    section["shots"] = {"orbit": {**section["shots"]["orbit"], "frames": 3}}
    settings = settings_module.load(render_shot.Settings, section, "render")
    options = render_options(folder, "orbit")
    call(render_shot.run, settings, **options)
    stale = folder / "render/orbit.layers/000007.exr"
    stale.parent.mkdir()
    stale.write_bytes(b"of an earlier, longer film")
    inputs = {
        name: options[name] for name in ("shot", "path", "background", "provenance", "gaussians", "avatars", "body")
    }
    settings = settings_module.load(render_layers.Settings, section, "render")
    call(render_layers.run, settings, **inputs, folder=folder / "render/orbit.layers")
    return folder


def test_every_picture_has_its_file_with_named_channels_of_the_right_type(folder: Path) -> None:
    files = sorted((folder / "render/orbit.layers").iterdir())
    assert [f.name for f in files] == ["000000.exr", "000001.exr", "000002.exr"]
    for file in files:
        channels = channels_of(file)
        assert set(channels) == {*HALF, "Z"}
        assert all(channels[name].dtype == np.float16 for name in HALF)
        assert channels["Z"].dtype == np.float32


def test_the_layers_are_the_film(folder: Path) -> None:
    """Composited over black they equal the picture, and their depth is the film's to a millimetre."""
    film, depths = read_stack(folder / "render/orbit.mkv"), read_stack(folder / "render/orbit.depth.mkv")
    for index in range(3):
        channels = channels_of(folder / f"render/orbit.layers/{index:06d}.exr")
        picture = np.stack([channels[c].astype(np.float32) for c in "RGB"], axis=-1)
        assert np.abs(to_bytes(picture).astype(int) - film[index]).max() <= 1
        known = (depths[index] > 0) & (depths[index] < 65535)
        np.testing.assert_allclose(channels["Z"][known] * 1000, depths[index][known], atol=0.51)
        alpha = channels["A"].astype(np.float32)
        for group in ("truth.", "matte."):
            together = sum(c.astype(np.float32) for name, c in channels.items() if name.startswith(group))
            np.testing.assert_allclose(together, alpha, atol=4e-3)
        assert channels["matte.p0"].max() > 0.9, "the person is in the picture"
        assert channels["matte.room"].max() > 0.9


def test_channels_of_other_types_or_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="channel A is float64"):
        write_channels(tmp_path / "a.exr", {"A": np.zeros((4, 4))})
    with pytest.raises(ValueError, match="B has shape"):
        write_channels(tmp_path / "a.exr", {"A": np.zeros((4, 4), np.float16), "B": np.zeros((4, 5), np.float16)})
