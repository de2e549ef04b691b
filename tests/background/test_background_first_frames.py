# SPDX-License-Identifier: Apache-2.0
"""The room trained on the first pictures, people and what lies about them left out (paper, Eq. 5)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studiorecon.background import preparation
from studiorecon.errors import UserError
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.images.metrics import psnr
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import NONE
from studiorecon.scene.gaussians_ply import read_ply

from tests.made.background import WH, cameras, capture, look, run, settings
from tests.made.gaussians import rasterise

__all__ = ["cameras", "capture", "settings"]

TOP, LEFT, SIDE = 18, 40, 16
MAGENTA = np.array([255, 0, 255], np.uint8)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory, cameras: list[Camera]) -> dict[str, list[Path]]:
    """First pictures with a magenta person, whose mask lacks 4 pixels on every side; later ones show nothing else."""
    folder, found = tmp_path_factory.mktemp("filmed"), {"videos": [], "masks": []}
    for camera in cameras:
        picture, mask = to_bytes(look(camera)[0]), np.zeros(camera.hw, np.uint8)
        picture[TOP : TOP + SIDE, LEFT : LEFT + SIDE] = MAGENTA
        mask[TOP + 4 : TOP + SIDE - 4, LEFT + 4 : LEFT + SIDE - 4] = 2
        for kind, first in (("videos", picture), ("masks", mask)):
            found[kind].append(folder / f"{camera.name}.{kind}.mkv")
            write_lossless(found[kind][-1], [first, np.full_like(first, 255)], 30.0)
    return found


def photos_of(cameras: list[Camera]) -> list[preparation.Photo]:
    return [
        preparation.Photo(c, np.zeros((*c.hw, 3), np.float32), np.zeros(c.hw, bool), look(c)[1], np.ones(c.hw))
        for c in cameras
    ]


@pytest.mark.parametrize(("size_px", "reach"), [(21, 10), (9, 4), (1, 0)])
def test_a_square_about_people_is_unknown(
    cameras: list[Camera], filmed: dict[str, list[Path]], size_px: int, reach: int
) -> None:
    found = preparation.mask_people(photos_of(cameras), **filmed, dilation_px=size_px, gains=NONE)
    for camera, photo in zip(cameras, found, strict=True):
        assert photo.camera is camera
        unknown = np.zeros(camera.hw, bool)
        unknown[TOP + 4 - reach : TOP + SIDE - 4 + reach, LEFT + 4 - reach : LEFT + SIDE - 4 + reach] = True
        np.testing.assert_array_equal(~photo.known, unknown)
        magenta = (to_bytes(photo.rgb) == MAGENTA).all(-1)
        assert (magenta & photo.known).any() == (reach < 4)


def test_without_dilation_people_are_baked_into_the_room(
    settings: Callable, capture: dict, filmed: dict[str, list[Path]], cameras: list[Camera], tmp_path: Path
) -> None:
    values = {}
    for size_px in (1, 21):
        folder = tmp_path / str(size_px)
        folder.mkdir()
        run(settings(120, room_targets="first_frames", dilation_px=size_px, views_share=0.5), capture | filmed, folder)
        room = read_ply(folder / "scene.ply")
        around = np.zeros(WH[::-1], bool)
        around[TOP : TOP + SIDE, LEFT : LEFT + SIDE] = True
        seen = [psnr(rasterise(room, c, near_m=0.1).rgb, look(c)[0], around) for c in cameras]
        values[size_px] = float(np.mean(seen))
    assert values[21] > values[1] + 3


def test_a_picture_of_people_alone_and_a_missing_video_are_refused(
    cameras: list[Camera], filmed: dict[str, list[Path]], tmp_path: Path
) -> None:
    everywhere = tmp_path / "all.mkv"
    write_lossless(everywhere, [np.ones(cameras[0].hw, np.uint8)], 30.0)
    with pytest.raises(UserError, match=r"cam0 shows only people"):
        preparation.mask_people(photos_of(cameras), filmed["videos"], [everywhere] * 4, 21, NONE)
    with pytest.raises(UserError, match=r"3 videos for 4"):
        preparation.mask_people(photos_of(cameras), filmed["videos"][:3], filmed["masks"], 21, NONE)
