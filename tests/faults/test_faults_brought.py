# SPDX-License-Identifier: Apache-2.0
"""Pictures, films and arrays of users and of networks that ran elsewhere, damaged: one sentence, or a right result."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from studiorecon.body.model import BodyModel
from studiorecon.depth.aligned import read_estimate
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.stills import read_plate
from studiorecon.footage.told_lens import told_focal_px
from studiorecon.footage.video import write_watchable
from studiorecon.masks.given import pictures_of
from studiorecon.models.adapters.comotion import Comotion
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.studio.description import read_description
from studiorecon.tracks.bodies import read_bodies

from tests.faults import damage
from tests.faults.readers import NIGHTLY, SAMPLE, Reader, damaged, npy, npz, survives

BODY = Path(__file__).parents[2] / "resources" / "body.npz"
STUDIO = Path(__file__).parents[2] / "resources" / "studio" / "demo.yaml"


def plate_right(path: Path) -> None:
    rgb, measured = read_plate(path)
    assert np.isfinite(rgb).all()
    assert measured.shape == rgb.shape[:2]


def estimate_right(path: Path) -> None:
    depth, sure = read_estimate(path)
    assert np.isfinite(depth).all()
    assert (depth >= 0).all()
    assert sure.shape == depth.shape


def depth_right(path: Path) -> None:
    depth_m, sure = read_depth(path)
    assert np.isfinite(depth_m).all()
    assert np.isfinite(sure).all()


def masks_right(path: Path) -> None:
    assert all(picture.dtype == np.uint8 and picture.ndim == 2 for picture in pictures_of(path.parent))


def gaussians_right(path: Path) -> None:
    assert read_ply(path).means_m.shape[1] == 3


def bodies_right(path: Path) -> None:
    for frame, bodies in read_bodies(path, Comotion):
        assert isinstance(frame, int)
        assert np.isfinite(bodies.poses_rad).all()


def film_right(path: Path) -> None:
    source = open_source(path, 30.0)
    assert np.isfinite(source.fps)
    assert source.fps > 0
    for frame in decode(source, 0, 0):
        assert frame.shape == (source.wh[1], source.wh[0], 3)
    told_focal_px(path, source.wh)


def body_right(path: Path) -> None:
    model = BodyModel.load(path)
    assert np.isfinite(model.rest_joints(np.zeros(model.shapes))).all()


def studio_right(path: Path) -> None:
    read_description(path)


def picture(suffix: str, values: np.ndarray) -> bytes:
    return cv2.imencode(suffix, values)[1].tobytes()


def written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write(path := Path(folder) / f"file{suffix}")
        return path.read_bytes()


def torch_file(rows: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    torch.save({name: torch.from_numpy(values) for name, values in rows.items()}, stream)
    return stream.getvalue()


RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (12, 16), np.uint8)
FILM = [np.repeat(np.roll(GREY, k, 1).repeat(4, 0).repeat(4, 1)[..., None], 3, -1) for k in range(8)]
DEPTH = (1 + RNG.random((12, 16))).astype(np.float32)
ROWS = {
    "id": np.arange(3),
    "frame_idx": np.array([0, 0, 1]),
    "pose": np.zeros((3, 72), np.float32),
    "betas": np.zeros((3, 10), np.float32),
    "trans": np.ones((3, 3), np.float32),
    "conf": np.ones(3, np.float32),
    "pred_2d": np.ones((3, 27, 2), np.float32),
    "pred_3d": np.ones((3, 27, 3), np.float32),
}
CLOUD = Gaussians(
    RNG.normal(size=(5, 3)).astype(np.float32),
    np.tile(np.float32([1, 0, 0, 0]), (5, 1)),
    np.full((5, 3), -3, np.float32),
    np.zeros(5, np.float32),
    np.zeros((5, 4, 3), np.float32),
)
READERS = {
    "plate": Reader("plate.png", picture(".png", np.dstack([GREY] * 4)), plate_right, text=False),
    "plate of 16 bits": Reader("plate.png", picture(".png", GREY.astype(np.uint16) * 257), plate_right, text=False),
    "photograph": Reader("plate.jpg", picture(".jpg", GREY), plate_right, text=False),
    "mask": Reader("masks/0.png", picture(".png", GREY), masks_right, text=False),
    "depth": Reader("cam.exr", written(lambda p: write_depth(p, DEPTH, DEPTH - 1), ".exr"), depth_right, text=False),
    "depth npy": Reader("cam.npy", npy(DEPTH), estimate_right, text=False),
    "depth npz": Reader("cam.npz", npz(depth=DEPTH), estimate_right, text=False),
    "depth png": Reader("cam.png", picture(".png", (DEPTH * 1000).astype(np.uint16)), estimate_right, text=False),
    "gaussians": Reader("cloud.ply", written(lambda p: write_ply(p, CLOUD), ".ply"), gaussians_right, text=False),
    "bodies npz": Reader("cam.npz", npz(**ROWS), bodies_right, text=False),
    "bodies pt": Reader("cam.pt", torch_file(ROWS), bodies_right, text=False),
    "film": Reader("cam.mp4", written(lambda p: write_watchable(p, FILM, 30.0), ".mp4"), film_right, text=False),
    "studio": Reader("studio.yaml", STUDIO.read_bytes(), studio_right),
}
EVERY = pytest.mark.parametrize("reader", READERS.values(), ids=READERS)


@EVERY
def test_the_whole_file_is_right(reader: Reader, tmp_path: Path) -> None:
    assert survives(reader, reader.written(tmp_path, reader.whole)) == "right"


@EVERY
@pytest.mark.parametrize("kind", damage.ENCODINGS)
def test_what_is_no_such_file_is_refused(reader: Reader, kind: str, tmp_path: Path) -> None:
    path = reader.written(tmp_path, damage.ENCODINGS[kind](reader.whole))
    said = survives(reader, path)
    # Half a photograph or film is still pictures, an archive may stand behind other bytes, none is the default studio.
    whole = {("plate.jpg", "half"), ("cam.mp4", "half"), ("cam.mp4", "zero inside"), ("plate.jpg", "zero inside")}
    archives = path.suffix in (".npz", ".pt") and kind in ("latin-1", "zero inside")
    if (reader.name, kind) not in whole and not archives and reader.name != "studio.yaml":
        assert said != "right"
        assert path.name in said


@EVERY
def test_damage_ends_in_a_sentence_or_a_right_result(reader: Reader, tmp_path: Path) -> None:
    damaged(reader, reader.written(tmp_path, reader.whole), SAMPLE, 0)


@pytest.mark.slow
@EVERY
def test_damage_ends_in_a_sentence_or_a_right_result_ten_thousand_times(reader: Reader, tmp_path: Path) -> None:
    damaged(reader, reader.written(tmp_path, reader.whole), NIGHTLY, 1)


@pytest.mark.parametrize("kind", [*damage.ENCODINGS, "an array less", "text"])
def test_a_body_model_that_is_none_is_refused(kind: str, tmp_path: Path) -> None:
    path, whole = tmp_path / "body.npz", BODY.read_bytes()
    reader = Reader("body.npz", whole, body_right, text=False)
    if kind in damage.ENCODINGS:
        path.write_bytes(damage.ENCODINGS[kind](whole))
    else:
        with np.load(BODY) as stored:
            held = {name: stored[name] for name in stored.files}
        name = next(name for name in held if held[name].dtype.kind == "f")
        held[name] = np.array("text")
        if kind == "an array less":
            del held[name]
        path.write_bytes(npz(**held))
    said = survives(reader, path)
    assert kind in ("latin-1", "zero inside") or (said != "right" and "body.npz" in said)
