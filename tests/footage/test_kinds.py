# SPDX-License-Identifier: Apache-2.0
"""Which files are films, whatever they are called."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from studiorecon.footage.container import film_streams, open_container
from studiorecon.footage.kinds import is_film

from tests.made.footage import smooth_pictures, write_video

SUFFIXES = "mp4 mov m4v MTS m2ts ts mpg wmv 3gp mxf mkv webm avi flv vob dv ogv"


def test_a_film_s_suffix_is_enough(tmp_path: Path) -> None:
    for suffix in SUFFIXES.split():
        (tmp_path / f"a.{suffix}").touch()
        assert is_film(tmp_path / f"a.{suffix}"), suffix


@pytest.mark.parametrize("name", ["VID_0001.insv", "clip", "GL010001.LRV", "cam1.mod"])
def test_a_film_with_a_suffix_of_its_maker_is_one(name: str, tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", smooth_pictures(3)).rename(tmp_path / name)
    assert is_film(tmp_path / name)


@pytest.mark.parametrize("name", ["a.txt", "a.json", "a.yaml", "a.npz", "a.md", "a.insv", "a.png", "a.gif", "a"])
def test_what_is_no_film_is_none(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if path.suffix == ".npz":
        np.savez(path, keypoints=np.zeros((3, 2, 25, 3)))
    elif path.suffix in (".png", ".gif"):
        cv2.imwrite(str(path), smooth_pictures(1)[0])
    else:
        path.write_text("camera: 1\n" * 100)
    assert not is_film(path)


@pytest.mark.parametrize("name", ["a.m4a", "a.wma"])
def test_sound_beside_the_films_is_none(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    assert not is_film(tmp_path / name)


@pytest.mark.parametrize("cover_first", [False, True])
def test_a_cover_picture_is_not_the_film(cover_first: bool, tmp_path: Path) -> None:
    """As music players and DJI write them: one large still picture as a further video stream."""
    cover = np.full((400, 600, 3), 200, np.uint8)

    def add(container: av.container.OutputContainer, codec: str, wh: tuple[int, int]) -> av.VideoStream:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = *wh, "yuvj420p" if codec == "mjpeg" else "yuv420p"
        return stream

    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        kinds = [("mjpeg", (600, 400)), ("libx264", (96, 64))]
        streams = {kind: add(container, kind, wh) for kind, wh in (kinds if cover_first else kinds[::-1])}
        for kind, pictures in (("mjpeg", cover[None]), ("libx264", smooth_pictures(5))):
            for picture in pictures:
                container.mux(streams[kind].encode(av.VideoFrame.from_ndarray(picture)))
            container.mux(streams[kind].encode(None))
    with open_container(tmp_path / "a.mp4") as container:
        assert film_streams(container)[0].codec_context.name == "h264"
