# SPDX-License-Identifier: Apache-2.0
"""Cameras from people with something measured: a height, a distance, a focal length that the file tells."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import av
import cv2
import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.calibration import from_people
from studiorecon.errors import UserError
from studiorecon.footage.lens_metadata import focal_px_from_metadata
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.metric_scale import GivenLengths, stature_m
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections
from studiorecon.studio.description import RESOURCES, read_description
from studiorecon.studio.performance import random_betas

from tests.defaults import loaded
from tests.made.take import after_similarity, made_take

KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"
DIAGONAL_MM = np.hypot(36, 24)


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def take() -> tuple[list[Camera], list[Detections]]:
    return made_take(occluded=False)


def heights_m(body: BodyModel) -> list[float]:
    """The two people of the take, head to heel."""
    seed = read_description(RESOURCES / "studio/defaults.yaml").seed
    return [float(np.ptp(body.rest_vertices(random_betas(seed, k))[:, 1])) for k in range(2)]


@pytest.fixture(scope="module")
def found(take: tuple[list[Camera], list[Detections]], body: BodyModel) -> Callable[..., tuple[list[Camera], dict]]:
    """Cameras and report by given lengths. They only scale the arrangement, which is found once for known lenses and
    once for told ones."""
    (truth, seen), solved = take, {}
    settings, template_m = loaded(from_people.Settings), from_people.mean_body(body)

    def once(name: str, known: bool) -> Callable:
        solve = getattr(from_people, name)

        def solve_once(*problem: Any) -> Any:
            if (name, known) not in solved:
                solved[name, known] = solve(*problem)
            return solved[name, known]

        return solve_once

    def posed(given: GivenLengths, metadata_px: dict | None = None, known: bool = True) -> tuple[list[Camera], dict]:
        focal_px = {c.name: c.focal_px[0] for c in truth} if known else {}
        kept = ("find_pose_consensus", "estimate_rig", "camera_intervals")
        about = metadata_px, given, stature_m(body)
        with mock.patch.multiple(from_people, **{name: once(name, known) for name in kept}):
            return from_people.pose_cameras(seen, [c.wh for c in truth], focal_px, 60, template_m, settings, *about)

    return posed


def test_a_measured_distance_decides_the_scale(take, body: BodyModel, found) -> None:
    truth = take[0]
    apart = float(np.linalg.norm(truth[0].centre_m - truth[2].centre_m))
    cameras, report = found(GivenLengths(between=(truth[0].name, truth[2].name), distance_m=apart))
    assert after_similarity(cameras, truth)[2] == pytest.approx(1.0, abs=0.005)
    assert f"{apart:.2f} m between" in report["scale"]
    assert report["scale_sigma"] < 0.01


def test_a_height_decides_the_scale_and_says_whose_it_is(take, body: BodyModel, found) -> None:
    """Bar: 3 % with one height given. The mean body's bones leave more where people are no mean adults."""
    heights = heights_m(body)
    scales = {}
    for name, height in zip(("p0", "p1"), heights):
        cameras, report = found(GivenLengths({name: height}))
        scales[name] = after_similarity(cameras, take[0])[2]
        assert f"{name} is {height:.2f} m tall ({name}: at (" in report["scale"]
    assert np.abs(np.array(list(scales.values())) - 1).max() < 0.03, (scales, heights)
    cameras, _ = found(GivenLengths({"p0": heights[0], "p1": heights[1]}))
    assert after_similarity(cameras, take[0])[2] == pytest.approx(1.0, abs=0.03)
    taller, _ = found(GivenLengths({"": 2 * float(np.mean(heights))}))
    assert after_similarity(taller, take[0])[2] == pytest.approx(0.5, abs=0.02), "all lengths follow the height"


def test_heights_that_cannot_be_true_together_and_names_of_nobody_are_refused(take, body: BodyModel, found) -> None:
    with pytest.raises(UserError, match="contradict one another"):
        found(GivenLengths({"p0": 1.2, "p1": 2.1}))
    with pytest.raises(UserError, match="height_m of p7, but the cameras were estimated from p0, p1"):
        found(GivenLengths({"p7": 1.8}))
    for advised in ("", "p1"):
        assert len(found(GivenLengths({advised: 1.7}))[0]) == len(take[0])
    with pytest.raises(UserError, match="from camera left"):
        found(GivenLengths(between=("left", take[0][0].name), distance_m=3.0))


def test_a_focal_length_is_a_start_that_people_correct(take, body: BodyModel, found) -> None:
    """The nominal lens is 4 % longer than the picture that a phone which steadies its film leaves."""
    truth = take[0]
    reported = {c.name: 1.04 * c.focal_px[0] for c in truth}
    cameras, report = found(GivenLengths(), reported, known=False)
    assert set(report["focal_from"].values()) == {"the file"}
    off = [c.focal_px[0] / t.focal_px[0] - 1 for c, t in zip(cameras, truth)]
    assert np.abs(off).max() < 0.02, off
    assert after_similarity(cameras, truth)[0].max() < 0.5


# ---- what files tell ----


def atom(kind: bytes, inner: bytes) -> bytes:
    return struct.pack(">I", 8 + len(inner)) + kind + inner


def tag(value: bytes) -> bytes:
    keys = bytes(4) + struct.pack(">I", 2) + atom(b"mdta", b"com.apple.quicktime.make") + atom(b"mdta", KEY)
    entries = [
        atom(struct.pack(">I", k), atom(b"data", struct.pack(">II", 1, 0) + v)) for k, v in ((1, b"A"), (2, value))
    ]
    handler = atom(b"hdlr", bytes(8) + b"mdta" + bytes(13))
    return atom(b"meta", handler + atom(b"keys", keys) + atom(b"ilst", b"".join(entries)))


def film(path: Path, value: bytes | None, of_track: bool = False) -> Path:
    """A film of 64 × 48 pixels with the key in the film's metadata, or in its track's."""
    whole = io.BytesIO()
    with av.open(whole, "w", format="mov") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 9 * level, np.uint8))))
        container.mux(stream.encode())
    data = whole.getvalue()
    at = data.index(b"moov") - 4
    inner = data[at + 8 :]
    if value is not None and of_track:
        track = inner.index(b"trak") - 4
        (size,) = struct.unpack(">I", inner[track : track + 4])
        inner = inner[:track] + atom(b"trak", inner[track + 8 : track + size] + tag(value)) + inner[track + size :]
    elif value is not None:
        inner += tag(value)
    path.write_bytes(data[:at] + atom(b"moov", inner))
    return path


def photo(path: Path, film_mm: int) -> Path:
    """A JPEG with an EXIF block of the one tag, big-endian."""
    _, jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))
    entry = struct.pack(">HHIHH", 0xA405, 3, 1, film_mm, 0)
    first = struct.pack(">HHHII", 1, 0x8769, 4, 1, 26) + bytes(4)
    block = b"Exif\0\0MM" + struct.pack(">HI", 42, 8) + first + struct.pack(">H", 1) + entry + bytes(4)
    path.write_bytes(jpeg.tobytes()[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + jpeg.tobytes()[2:])
    return path


@pytest.mark.parametrize("of_track", [False, True])
@pytest.mark.parametrize(("value", "film_mm"), [(b"27", 27.0), (b"50.00mm", 50.0)])
def test_a_film_tells_its_focal_length(tmp_path: Path, of_track: bool, value: bytes, film_mm: float) -> None:
    path = film(tmp_path / "a.mov", value, of_track)
    assert focal_px_from_metadata(path, (1920, 1080)) == pytest.approx(film_mm * np.hypot(1920, 1080) / DIAGONAL_MM)


def test_a_photo_tells_its_focal_length(tmp_path: Path) -> None:
    assert focal_px_from_metadata(photo(tmp_path / "a.jpg", 26), (64, 48)) == pytest.approx(26 * 80 / DIAGONAL_MM)


def test_files_that_tell_nothing_or_nonsense_tell_nothing(tmp_path: Path) -> None:
    assert focal_px_from_metadata(film(tmp_path / "a.mov", None), (64, 48)) is None
    assert focal_px_from_metadata(film(tmp_path / "b.mov", b"0"), (64, 48)) is None
    assert focal_px_from_metadata(film(tmp_path / "c.mov", b"unknown", True), (64, 48)) is None
    assert focal_px_from_metadata(photo(tmp_path / "a.jpg", 0), (64, 48)) is None
    (tmp_path / "e.mp4").write_bytes(b"no film")
    assert focal_px_from_metadata(tmp_path / "e.mp4", (64, 48)) is None


# ---- what capture.yaml says ----


def dataset(folder: Path, text: str):
    (folder / "videos").mkdir(parents=True, exist_ok=True)
    for name in ("left", "right"):
        (folder / "videos" / f"{name}.mp4").write_bytes(b"")
    (folder / "capture.yaml").write_text(text)
    return open_dataset(folder)


def test_lengths_are_read_from_capture_yaml(tmp_path: Path) -> None:
    assert dataset(tmp_path, "height_m: {p0: 1.78}").lengths == {"height_m": {"p0": 1.78}}
    assert dataset(tmp_path, "height_m: 1.7").lengths == {"height_m": {"": 1.7}}
    both = dataset(tmp_path, "distance_m: [left, right, 3.2]").lengths
    assert GivenLengths(**both) == GivenLengths(between=["left", "right"], distance_m=3.2)
    assert dataset(tmp_path, "people: 1").lengths == {}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("height_m: {p0: 178}", "height_m of p0 is 178"),
        ("height_m: tall", "height_m is 'tall'"),
        ("distance_m: 3.2", "must have the form"),
        ("distance_m: [left, middle, 3.2]", "'middle'"),
        ("distance_m: [left, left, 3.2]", "itself"),
        ("distance_m: [left, right, -1]", "must be"),
    ],
)
def test_lengths_that_cannot_be_are_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        dataset(tmp_path, text)
