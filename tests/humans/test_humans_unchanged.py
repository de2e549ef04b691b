# SPDX-License-Identifier: Apache-2.0
"""humans: what was trained stands exactly as long as nothing that training looked at has changed."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import Avatar, write_avatar
from studiorecon.body.model import BodyModel
from studiorecon.humans.crops import IGNORED, HeldCrop, classify_crops, person_crops
from studiorecon.humans.result_cache import cache_key, is_up_to_date, store_result
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians

from tests.made.scene import ring

CAMERA = ring([0], "cam", wh=(160, 100))[0]


@dataclass(frozen=True)
class Options:
    iterations: int = 5


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


def crops(body: BodyModel, neighbour_at: int) -> list[HeldCrop]:
    """One frame of person 1 in the middle of a picture, and of person 2, four columns from ``neighbour_at`` on."""
    pose = np.zeros((1, 72))
    pose[0, 0] = np.pi / 2
    vertices = body.vertices(pose, np.zeros(10), np.array([[0, 0, 0.95]]))
    pixels = CAMERA.project(vertices[0])[0]
    low, high = np.floor(pixels.min(0)).astype(int), np.ceil(pixels.max(0)).astype(int)
    labels = np.zeros(CAMERA.hw, np.uint8)
    labels[low[1] : high[1], low[0] : high[0]] = 1
    labels[:, neighbour_at : neighbour_at + 4] = 2
    picture = np.full((*CAMERA.hw, 3), 90, np.uint8)
    looks = person_crops(0, CAMERA, iter([picture]), iter([labels]), vertices, np.array([True]), 1, 4, 5)
    return list(classify_crops(looks, 1, 1, 3, 0))


def test_only_what_happens_within_the_crop_counts(body: BodyModel, tmp_path: Path) -> None:
    fit = tmp_path / "p0.npz"
    fit.write_bytes(b"fit")

    def mark(found: list[HeldCrop], options: Options = Options(), code: str = "code", person: str = "p0") -> str:
        return cache_key(options, found, [fit], code, person)

    far, moved = crops(body, 2), crops(body, 8)
    (crop,) = far
    before = mark(far)
    assert mark(moved) == before, "somebody else moved where this person's training does not look"
    left = round(CAMERA.principal_px[0] - crop.camera.principal_px[0])
    touched = crops(body, left + 1)
    assert (touched[0].verdict == IGNORED).sum() > (crop.verdict == IGNORED).sum()
    others = [
        mark(touched),
        mark([replace(crop, frame=1)]),
        mark([replace(crop, rgb=crop.rgb + np.uint8(1))]),
        mark([replace(crop, camera=_nearer(crop.camera))]),
        mark([]),
        mark(far, Options(6)),
        mark(far, code="other"),
        mark(far, person="p1"),
    ]
    fit.write_bytes(b"another fit")
    others.append(mark(far))
    assert len({before, *others}) == len(others) + 1


def _nearer(camera: Camera) -> Camera:
    moved = camera.camera_from_world.copy()
    moved[2, 3] -= 1e-6
    return replace(camera, camera_from_world=moved)


def test_files_stand_only_together_and_become_new(body: BodyModel, tmp_path: Path) -> None:
    ply, npz, working = tmp_path / "p0.ply", tmp_path / "p0.npz", tmp_path / "working"
    assert not is_up_to_date("m", ply, npz, working), "nothing was trained yet"
    rows = np.zeros((4, 3), np.float32)
    gaussians = Gaussians(
        rows, np.tile(np.float32([1, 0, 0, 0]), (4, 1)), rows, np.zeros(4, np.float32), np.zeros((4, 1, 3), np.float32)
    )
    avatar = Avatar(
        person="p0",
        model=body,
        gaussians=gaussians,
        bones=np.zeros((4, 4), np.uint8),
        weights=np.full((4, 4), 0.25, np.float32),
        provenance=np.zeros(4, np.uint8),
        poses=np.zeros((2, 72)),
        trans=np.zeros((2, 3)),
        betas=np.zeros(10),
        valid=np.ones(2, bool),
        fps=30.0,
        metric=True,
    )
    write_avatar(ply, npz, avatar, "m")
    assert not is_up_to_date("m", ply, npz, working), "nobody asked for it to be kept"
    store_result(ply, npz, working)
    written = [path.read_bytes() for path in (ply, npz)]
    for path in (ply, npz):
        os.utime(path, (1, 1))
        path.unlink()  # as the workflow does before it runs the step again
    assert not is_up_to_date("other", ply, npz, working)
    assert not ply.exists()
    assert is_up_to_date("m", ply, npz, working)
    assert [path.read_bytes() for path in (ply, npz)] == written
    assert min(ply.stat().st_mtime, npz.stat().st_mtime) > 1, "the workflow compares times"
    last = working / "last.ply"
    last.write_bytes(written[0][:-1] + b"x")
    assert not is_up_to_date("m", ply, npz, working), "half of it was replaced"
    last.write_bytes(written[0])
    (working / "last.npz").write_bytes(written[1][:100])
    assert not is_up_to_date("m", ply, npz, working)
