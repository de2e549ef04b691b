# SPDX-License-Identifier: Apache-2.0
"""A film's pictures are what a player shows: square pixels, the right way up, BT.709, one moment."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from studiorecon.footage.frames import decode, seek_frames, small_grey
from studiorecon.footage.source import open_source

from tests.made.footage import smooth_pictures

WH = (96, 64)
HLG, PQ, BT2020 = 18, 16, 9


def written(
    path: Path, pictures: np.ndarray, aspect: Fraction | None = None, turn: tuple[int, bool] = (0, False)
) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv420p"
        if aspect:
            stream.sample_aspect_ratio = aspect
        if turn != (0, False):
            stream.set_display_rotation(turn[0], hflip=turn[1])
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture))))
        container.mux(stream.encode(None))
    return path


def close(found: np.ndarray, expected: np.ndarray, levels: float = 6.0) -> None:
    assert found.shape == expected.shape
    assert float(np.abs(found.astype(int) - expected).mean()) < levels


@pytest.mark.parametrize(("aspect", "wide"), [(Fraction(4, 3), 128), (Fraction(8, 9), 85), (Fraction(1), 96)])
@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_pixels_become_square(aspect: Fraction, wide: int, suffix: str, tmp_path: Path) -> None:
    pictures = smooth_pictures(5)
    source = open_source(written(tmp_path / f"a.{suffix}", pictures, aspect), 30.0)
    assert (source.wh, source.stored_wh) == ((wide, 64), WH)
    shown = [cv2.resize(picture, (wide, 64), interpolation=cv2.INTER_CUBIC) for picture in pictures]
    for found, expected in zip(decode(source, 0, 0), shown, strict=True):
        close(found, expected)
    close(seek_frames(source, [3])[0], shown[3])
    assert any("shown as" in note for note in source.notes) == (wide != 96)


def test_pixels_that_no_camera_has_are_not_believed(tmp_path: Path) -> None:
    source = open_source(written(tmp_path / "a.mp4", smooth_pictures(3), Fraction(40, 1)), 30.0)
    assert source.wh == WH
    assert any("which no camera has" in note for note in source.notes)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("degrees", [0, 90, 180, -90])
def test_turned_and_mirrored_films_are_shown_as_players_do(degrees: int, mirrored: bool, tmp_path: Path) -> None:
    """Turned counter-clockwise, and then mirrored; its pixels are made square before that."""
    pictures = smooth_pictures(3)
    source = open_source(written(tmp_path / "a.mp4", pictures, Fraction(4, 3), (degrees, mirrored)), 30.0)
    upright = np.rot90(cv2.resize(pictures[1], (128, 64), interpolation=cv2.INTER_CUBIC), degrees // 90)
    upright = upright[:, ::-1] if mirrored else upright
    assert source.wh == (upright.shape[1], upright.shape[0])
    assert source.stored_wh == (WH if degrees % 180 == 0 else WH[::-1])
    close(next(decode(source, 1, 1)), upright)
    assert any("mirrored" in note for note in source.notes) == mirrored


def linear_of_srgb(levels: np.ndarray) -> np.ndarray:
    """BT.709's own transfer, undone: light of the scene, white 1."""
    signal = levels / 255
    return np.where(signal < 0.081, signal / 4.5, ((signal + 0.099) / 1.099) ** (1 / 0.45))


def hlg_of(light: np.ndarray) -> np.ndarray:
    """BT.2100: of light whose white has 75 % of the signal."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    e = light * 0.26496256
    return np.where(e <= 1 / 12, np.sqrt(3 * e), a * np.log(np.maximum(12 * e - b, 1e-9)) + c)


def pq_of(light: np.ndarray) -> np.ndarray:
    """BT.2100: of light as a display of BT.1886 shows it, white at 203 cd/m²."""
    signal = np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
    y = (203 / 10_000 * np.maximum(signal, 0) ** 2.4) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * y) / (1 + 18.6875 * y)) ** 78.84375


def of_transfer(path: Path, pictures: np.ndarray, transfer: int) -> Path:
    """The same scene through a camera of BT.2020's colours and another transfer: 10 bits, lossless."""
    from_709 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
    light = linear_of_srgb(pictures.astype(np.float64)) @ from_709.T
    signal = {HLG: hlg_of, PQ: pq_of}[transfer](np.clip(light, 0, None))
    red, green, blue = np.moveaxis(signal, -1, 0)
    luma = 0.2627 * red + 0.6780 * green + 0.0593 * blue
    planes = [64 + 876 * luma, 512 + 896 * (blue - luma) / 1.8814, 512 + 896 * (red - luma) / 1.4746]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv444p10le"
        context = stream.codec_context
        context.color_trc, context.color_primaries, context.colorspace, context.color_range = transfer, BT2020, 9, 1
        for number in range(len(pictures)):
            frame = av.VideoFrame(pictures.shape[2], pictures.shape[1], "yuv444p10le")
            frame.color_trc, frame.color_primaries, frame.colorspace, frame.color_range = transfer, BT2020, 9, 1
            for plane, values in zip(frame.planes, planes, strict=True):
                rows = np.zeros((plane.height, plane.line_size // 2), np.uint16)
                rows[:, : plane.width] = np.rint(values[number])
                plane.update(rows.tobytes())
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(("transfer", "name"), [(HLG, "HLG"), (PQ, "PQ")])
def test_hdr_cameras_come_out_like_the_others(transfer: int, name: str, tmp_path: Path) -> None:
    pictures = np.clip(smooth_pictures(3), 40, 215)
    source = open_source(of_transfer(tmp_path / "a.mkv", pictures, transfer), 30.0)
    for found, expected in zip(decode(source, 0, 0), pictures, strict=True):
        assert abs(float(found.mean()) - expected.mean()) < 8
        close(found, expected, 12)
    close(seek_frames(source, [2])[0], pictures[2], 12)
    assert any(name in note and "BT.709" in note for note in source.notes)


def test_an_unknown_transfer_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = *WH, "yuv420p"
        stream.codec_context.color_trc = 9
        for picture in smooth_pictures(3):
            frame = av.VideoFrame.from_ndarray(picture).reformat(format="yuv420p")
            frame.color_trc = 9
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    assert any("LOG" in note and "not converted" in note for note in open_source(path, 30.0).notes)


def test_interlaced_films_show_one_moment(tmp_path: Path) -> None:
    """A bar that moves six pixels a field: woven together its edges are combs."""
    fields = np.full((24, 64, 96, 3), 30, np.uint8)
    for number, field in enumerate(fields):
        field[:, 6 + 3 * number : 18 + 3 * number] = 220
    woven = fields[::2].copy()
    woven[:, 1::2] = fields[1::2, 1::2]
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "4", "x264-params": "interlaced=1:tff=1"})
        stream.width, stream.height, stream.pix_fmt = *WH, "yuv420p"
        for picture in woven:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(stream.encode(None))
    source = open_source(path, 30.0)
    found = np.stack(list(decode(source, 0, 0))).astype(int)
    assert source.frames == len(found) == len(woven) == len(list(small_grey(source, 48, 100)))
    combs = [float(np.abs(np.diff(film[2:-2].mean(-1), axis=1)).mean()) for film in (woven.astype(int), found)]
    assert combs[1] < 0.4 * combs[0]
    assert min(float(np.abs(found[5] - field).mean()) for field in fields[10:12].astype(int)) < 6
    close(seek_frames(source, [6])[0], found[6], 3)
    assert any("interlaced" in note for note in source.notes)
