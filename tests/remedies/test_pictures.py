# SPDX-License-Identifier: Apache-2.0
"""Films, pictures, masks and depth that lead to a sentence: put right as it advises, they are read."""

from __future__ import annotations

import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.depth import given
from studiorecon.depth.estimates import read_camera_estimate, read_estimate
from studiorecon.footage.chapters import write_chapters
from studiorecon.footage.exr import read_depth, write_channels
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames_from, read_stack, write_lossless
from studiorecon.masks.user_masks import mask_pictures

from tests.defaults import loaded
from tests.made.cameras import look_at
from tests.made.footage import smooth_pictures, write_video
from tests.made.remedies import follow_row

Call = Callable[[Path], Any]
CAMERA = look_at("a", np.array([4.0, 0.0, 1.5]), [0, 0, 1], (64, 48))
FLAT = np.full((48, 64), 2.0, np.float32)
SOURCE, STILLS, VIDEO, MASKS = "footage/source.py", "footage/stills.py", "footage/video.py", "masks/user_masks.py"
ESTIMATES, GIVEN = "depth/estimates.py", "depth/given.py"


def film(count: int = 6, wh: tuple[int, int] = (64, 48), fps: int = 30) -> Callable[[Path], Path]:
    return lambda path: write_video(path, smooth_pictures(count, wh), fps=fps)


def decoded(write: Callable[[Path], object], first: int = 0, count: int = 0) -> Call:
    def call(folder: Path) -> None:
        write(folder / "a.mp4")
        list(decode(open_source(folder / "a.mp4", 30.0), first, count))

    return call


def numbered(*pictures: int, odd: tuple[int, Any] | None = None) -> Callable[[Path], None]:
    """A folder of pictures of these numbers; one of them replaced by bytes or by a picture of another size."""

    def write(path: Path) -> None:
        path.mkdir()
        for number in pictures:
            cv2.imwrite(str(path / f"{number}.png"), smooth_pictures(1, (64, 48))[0])
        if odd is not None:
            file, content = path / f"{odd[0]}.png", odd[1]
            file.write_bytes(content) if isinstance(content, bytes) else cv2.imwrite(str(file), content)

    return write


def text(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def halved(path: Path) -> None:
    film(30)(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def sound(path: Path) -> None:
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(bytes(16000))


def working(read: Callable[[Path], Any], share: float = 1.0, count: int = 12) -> Call:
    def call(folder: Path) -> None:
        write_lossless(folder / "a.mkv", iter(smooth_pictures(count, (64, 48))), 30)
        whole = (folder / "a.mkv").read_bytes()
        (folder / "a.mkv").write_bytes(whole[: int(share * len(whole))])
        read(folder / "a.mkv")

    return call


def joined(*films: Callable[[Path], Path]) -> Call:
    def call(folder: Path) -> None:
        write_chapters(folder / "x.ffconcat", [write(folder / f"{n}.mp4") for n, write in enumerate(films)])

    return call


def picture(values: np.ndarray, suffix: str = ".png", read: Callable[[Path], Any] = read_plate) -> Call:
    def call(folder: Path) -> None:
        cv2.imwrite(str(folder / f"a{suffix}"), values)
        read(folder / f"a{suffix}")

    return call


def saved(values: Any, read: Callable[[Path], Any] = read_estimate, name: str = "") -> Call:
    def call(folder: Path) -> None:
        file = folder / ("a.npz" if name else "a.npy")
        np.savez(file, **{name: values}) if name else np.save(file, values)
        read(file)

    return call


def exr(read: Callable[[Path], Any] = read_depth, **channels: np.ndarray) -> Call:
    def call(folder: Path) -> None:
        write_channels(folder / "a.exr", channels)
        read(folder / "a.exr")

    return call


def given_depth(path: Path) -> None:
    write_model(path.parent / "cameras", [CAMERA])
    given.run(loaded(given.Settings), "a", path.parent / "cameras/images.txt", path, path.parent / "out.exr")


def masks(*pictures: np.ndarray, numbers: tuple[int, ...] = (0, 1, 2)) -> Call:
    def call(folder: Path) -> None:
        for number, values in zip(numbers, pictures, strict=True):
            cv2.imwrite(str(folder / f"{number}.png"), values)
        list(mask_pictures(folder))

    return call


MASK = np.zeros((48, 64), np.uint8)
WHOLE = decoded(film())
FOLDER = decoded(numbered(0, 1, 2))
READ = working(read_stack)
FROM = working(lambda p: list(read_frames_from(p, 2, 8)))
# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    (f"{SOURCE} _stamp 1", decoded(lambda _: None), WHOLE),
    (f"{SOURCE} _stamp 2", decoded(text(b"")), WHOLE),
    (f"{SOURCE} _open_film", decoded(film(1)), WHOLE),
    (f"{SOURCE} _probe_first_frame", decoded(sound), WHOLE),
    (f"{SOURCE} film_context", decoded(text(b"no film" * 99)), WHOLE),
    (f"{SOURCE} film_context", decoded(halved), WHOLE),
    (f"{SOURCE} _open_folder 1", decoded(numbered()), FOLDER),
    (f"{SOURCE} _open_folder 2", decoded(numbered(0, 1, 3)), FOLDER),
    (f"{STILLS} read_image", decoded(numbered(0, 1, 2, odd=(1, b"x"))), FOLDER,
     decoded(numbered(0, 1, 2, odd=(1, b"x")), 0, 1)),
    ("footage/frames.py _decode_folder", decoded(numbered(0, 1, odd=(1, smooth_pictures(1, (32, 24))[0]))), FOLDER),
    ("footage/frames.py decode 1", decoded(film(), 3, 7), decoded(film(), 3, 3)),
    ("footage/chapters.py _check_like 1", joined(film(), film(6, (32, 24))), joined(film(), film())),
    ("footage/chapters.py _check_like 2", joined(film(), film(fps=25)), joined(film(), film())),
    (f"{VIDEO} read_frames 1", lambda f: read_stack(f / "gone.mkv"), READ),
    (f"{VIDEO} read_frames 2", working(read_stack, 0.0), READ),
    (f"{VIDEO} read_frames 3", working(lambda p: read_stack(p, 0, 20)),
     working(lambda p: read_stack(p, 0, 20), count=20)),
    (f"{VIDEO} read_frames_from 1", lambda f: list(read_frames_from(f / "gone.mkv", 0, 1)), FROM),
    (f"{VIDEO} read_frames_from 2", working(lambda p: list(read_frames_from(p, 2, 8)), 0.0), FROM),
    (f"{VIDEO} read_frames_from 3", working(lambda p: list(read_frames_from(p, 2, 40))), FROM),
    (f"{STILLS} read_plate", picture(FLAT, ".tiff"), picture(MASK), picture(MASK.astype(np.uint16))),
    ("footage/exr.py read_depth 1", lambda f: read_depth(f / "gone.exr"), exr(Z=FLAT)),
    ("footage/exr.py read_depth 2", lambda f: (text(b"x")(f / "a.exr"), read_depth(f / "a.exr")), exr(Z=FLAT)),
    ("footage/exr.py read_depth 3", exr(other=FLAT), exr(Z=FLAT), exr(Y=FLAT), exr(R=FLAT), exr(depth=FLAT)),
    (f"{ESTIMATES} read_camera_estimate", saved(FLAT[:20], lambda p: read_camera_estimate(p, CAMERA)),
     saved(FLAT, lambda p: read_camera_estimate(p, CAMERA))),
    (f"{ESTIMATES} read_estimate 1", lambda f: read_estimate(f / "a.exr"), exr(read_estimate, Z=FLAT), saved(FLAT)),
    (f"{ESTIMATES} read_estimate 2", picture(MASK, read=read_estimate),
     picture(MASK.astype(np.uint16), read=read_estimate)),
    (f"{ESTIMATES} read_estimate 3", saved(np.ones((3, 48, 64))), saved(FLAT)),
    (f"{ESTIMATES} read_estimate 4", saved(-FLAT), saved(FLAT)),
    (f"{ESTIMATES} _numbers 1", saved(FLAT, name="far"), saved(FLAT, name="depth"), saved(FLAT, name="depths"),
     saved(FLAT, name="arr_0")),
    (f"{ESTIMATES} _numbers 2", saved(np.full((48, 64), "a")), saved(FLAT)),
    ("scene/user_files.py _array 1", saved(np.array([{}], object)), saved(FLAT)),
    (f"{GIVEN} run 1", exr(given_depth, Z=FLAT[:20]), exr(given_depth, Z=FLAT)),
    (f"{GIVEN} run 2", exr(given_depth, Z=np.zeros_like(FLAT)), exr(given_depth, Z=FLAT)),
    (f"{MASKS} mask_pictures 1", masks(MASK, MASK, MASK, numbers=(0, 1, 3)), masks(MASK, MASK, MASK)),
    (f"{MASKS} mask_pictures 2", masks(MASK.astype(np.uint16), numbers=(0,)), masks(MASK, numbers=(0,))),
    (f"{MASKS} mask_pictures 3", masks(MASK, MASK[:9], MASK), masks(MASK, MASK, MASK)),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_pictures_put_right_as_advised_are_read(row: int, tmp_path: Path) -> None:
    follow_row(ROWS[row], tmp_path)
