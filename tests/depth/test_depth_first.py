# SPDX-License-Identifier: Apache-2.0
"""depth.first: the first moment's depth by the network that found the cameras, in working metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.depth import first
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth

from tests.made.networks import room_views

WH, SCALE = (96, 54), 1.7


def planted(folder: Path, focal: float = 1.0) -> tuple[Path, Path, list[str]]:
    """Working cameras, the network's in other metres and in another world, and its depth at half the size."""
    views = room_views(WH)
    cameras, found = [c for c, _, _ in views], []
    for camera in cameras:
        pose = camera.camera_from_world @ cameras[0].world_from_camera
        pose[:3, 3] /= SCALE
        lens = camera.intrinsics * np.array([[focal], [focal], [1.0]])
        lens[:2, 2] = camera.intrinsics[:2, 2]
        found.append(replace(camera, camera_from_world=pose, intrinsics=lens))
    write_model(folder / "cameras", cameras)
    write_model(folder / "network", found)
    for camera, _, depth in views:
        small = depth[::2, ::2] / SCALE
        sure = np.full(small.shape, 0.6)
        small[:3], sure[:3] = 0, 0
        write_depth(folder / f"network/{camera.name}.exr", small, sure)
    return folder / "cameras/images.txt", folder / "network/images.txt", [c.name for c in cameras]


def test_depth_is_the_networks_in_the_metres_of_the_cameras_in_use(tmp_path: Path) -> None:
    model, found, names = planted(tmp_path)
    for name, (_, _, depth) in zip(names, room_views(WH)):
        first.run(name, model, tmp_path / f"network/{name}.exr", found, tmp_path / f"{name}.exr")
        depth_m, sure = read_depth(tmp_path / f"{name}.exr")
        known = depth_m > 0
        assert depth_m.shape == WH[::-1]
        assert not known[:6].any()
        assert known[8:].all()
        np.testing.assert_allclose(sure[known], 0.6, atol=1e-3)
        # Read at the nearest pixel of half the size, so within what a pixel changes.
        assert np.median(np.abs(depth_m[known] / depth[known] - 1)) < 0.01


def test_another_picture_and_a_network_that_knows_nothing_are_refused(tmp_path: Path) -> None:
    model, found, names = planted(tmp_path, focal=1.3)
    about = tmp_path / f"network/{names[0]}.exr", found, tmp_path / "out.exr"
    with pytest.raises(UserError, match=r"has 1\.30 times its focal length .* set depth\.reference to planes"):
        first.run(names[0], model, *about)
    model, found, names = planted(tmp_path)
    write_depth(about[0], np.zeros((27, 48)), np.zeros((27, 48)))
    with pytest.raises(UserError, match="has no depth for camera"):
        first.run(names[0], model, *about)
    with pytest.raises(UserError, match="no camera nobody"):
        first.run("nobody", model, *about)
