# SPDX-License-Identifier: Apache-2.0
"""What counts is what a decoder shows, at the times at which it shows it."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.footage.frames import decode, read_stills, seek_frames, small_grey
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.plan.films import unreadable_footage

from tests.made.footage import smooth_pictures, write_video

COUNT, WH = 40, (96, 64)
PICTURES = smooth_pictures(COUNT)


def coded(pictures: np.ndarray, **options: str) -> tuple[av.VideoCodecContext, list[av.Packet]]:
    """Pictures as packets of H.264 at 30 per second, in the order in which they are decoded."""
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv420p"
    encoder.time_base, encoder.framerate = Fraction(1, 30), Fraction(30)
    encoder.options = {"crf": "8", "g": "10", "bf": "2", **options}
    packets = []
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture)
        frame.pts = number
        packets += encoder.encode(frame)
    return encoder, packets + encoder.encode(None)


def muxed(path: Path, codec: str, packets: list[av.Packet], wh: tuple[int, int] = WH) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = *wh, "yuv420p"
        for packet in packets:
            packet.stream = stream
            container.mux(packet)
    return path


def with_edit_list(path: Path) -> Path:
    """The last 30 frames of the film, as a phone's gallery trims: the others stay in the file."""
    write_video(path, PICTURES)
    data = bytearray(path.read_bytes())
    at = data.index(b"elst")
    # Version 0: one entry of duration (movie time scale: 1,000), media time (of the track) and rate.
    with av.open(str(path)) as container:
        ticks = int(1 / container.streams.video[0].time_base)
    data[at + 12 : at + 20] = (1000).to_bytes(4, "big") + (ticks * 10 // 30 + ticks * 2 // 30).to_bytes(4, "big")
    path.write_bytes(bytes(data))
    return path


def shown(source: FootageSource) -> list[int]:
    """Which of the pictures each frame is."""
    return [int(np.abs(PICTURES - p.astype(int)).mean((1, 2, 3)).argmin()) for p in decode(source, 0, 0)]


def test_an_edit_list_hides_frames(tmp_path: Path) -> None:
    source = open_source(with_edit_list(tmp_path / "a.mp4"), 30.0)
    numbers = shown(source)
    assert source.frames == source.announced == len(numbers) == len(source.times_s)
    assert 28 <= source.frames <= 31
    assert numbers == list(range(COUNT - source.frames, COUNT))
    assert not source.notes


def test_a_film_cut_at_a_frame_that_others_refer_to(tmp_path: Path) -> None:
    """An open group of pictures at the beginning: its first ones cannot be decoded."""
    _, packets = coded(PICTURES, **{"x264-params": "open-gop=1:keyint=10:scenecut=0"})
    key = [k for k, packet in enumerate(packets) if packet.is_keyframe][1]
    source = open_source(muxed(tmp_path / "a.ts", "h264", packets[key:]), 30.0)
    numbers = shown(source)
    assert len(numbers) == source.frames
    assert numbers == list(range(numbers[0], COUNT))
    assert numbers[0] >= 10


def test_fewer_frames_than_the_header_announces(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", PICTURES)
    with av.open(str(path)) as container:
        announced = container.streams.video[0].frames
    data = path.read_bytes()
    more = (announced + 2).to_bytes(4, "little")
    at = data.index(b"strh") + 8 + 32
    path.write_bytes(data[:at] + more + data[at + 4 :])
    source = open_source(path, 30.0)
    assert shown(source) == list(range(COUNT))
    assert source.announced > source.frames == COUNT
    assert any("announced" in note for note in source.notes)


@pytest.mark.parametrize("suffix", ["mkv", "ts", "mp4", "avi"])
def test_of_a_film_that_is_cut_off_the_part_that_is_there_is_used(suffix: str, tmp_path: Path) -> None:
    path = write_video(tmp_path / f"a.{suffix}", PICTURES)
    if suffix == "mp4":
        with av.open(str(path)) as old, av.open(str(tmp_path / "b.mp4"), "w", options={"movflags": "faststart"}) as new:
            stream = new.add_stream_from_template(old.streams.video[0])
            for packet in old.demux(video=0):
                if packet.dts is not None:
                    packet.stream = stream
                    new.mux(packet)
        path = tmp_path / "b.mp4"
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.6 * len(whole))])
    source = open_source(path, 30.0)
    assert 5 < source.frames < COUNT
    # What the last frame refers to may be cut off: a decoder then shows the one before, or the one after.
    numbers = shown(source)
    assert numbers[:-1] == list(range(source.frames - 1))
    assert numbers[-1] in (source.frames - 2, source.frames - 1, source.frames)
    assert len(list(small_grey(source, 48, COUNT))) == source.frames


def stamped(path: Path, times: Iterator[int] | None, rate: int = 30) -> Path:
    """The film with other times: of its packets in order, in 1/90,000 s."""
    _, packets = coded(PICTURES, bf="0")
    for packet, time in zip(packets, times or [0] * COUNT):
        packet.time_base, packet.pts, packet.dts = Fraction(1, 90_000), time, time
    return muxed(path, "h264", packets)


@pytest.mark.parametrize("suffix", ["mkv", "ts"])
def test_times_that_are_all_zero_are_the_header_s(suffix: str, tmp_path: Path) -> None:
    source = open_source(stamped(tmp_path / f"a.{suffix}", None), 30.0)
    assert (source.frames, source.fps) == (COUNT, 30.0)
    np.testing.assert_allclose(np.diff(source.times_s), 1 / 30)
    assert any("no usable times" in note for note in source.notes)
    assert shown(source) == list(range(COUNT))
    np.testing.assert_array_equal(seek_frames(source, [7, 31]), list(read_stills(source, [7, 31])))


def test_the_rate_is_that_of_the_times_and_not_the_header_s(tmp_path: Path) -> None:
    source = open_source(stamped(tmp_path / "a.mkv", iter(range(0, 3600 * COUNT, 3600))), 30.0)
    assert source.fps == pytest.approx(25.0, abs=0.01)
    assert shown(source) == list(range(COUNT))


def test_a_film_of_uneven_times_keeps_them(tmp_path: Path) -> None:
    steps = np.where(np.arange(COUNT) % 7 == 3, 9000, 3000)
    times = np.concatenate([[0], np.cumsum(steps)[:-1]])
    source = open_source(stamped(tmp_path / "a.mkv", iter(times.tolist())), 30.0)
    np.testing.assert_allclose(np.array(source.times_s) - source.times_s[0], times / 90_000, atol=2e-3)
    assert source.fps == pytest.approx(30.0, rel=0.02)
    np.testing.assert_array_equal(seek_frames(source, [4, 20, 33]), list(read_stills(source, [4, 20, 33])))


@pytest.mark.parametrize("suffix", ["mkv", "ts"])
def test_from_a_change_of_size_on_a_film_is_not_used(suffix: str, tmp_path: Path) -> None:
    before, after = (coded(smooth_pictures(30, wh), bf="0")[1] for wh in (WH, (48, 32)))
    for number, packet in enumerate([*before, *after]):
        packet.pts = packet.dts = number
    source = open_source(muxed(tmp_path / f"a.{suffix}", "h264", [*before, *after]), 30.0)
    assert (source.frames, source.announced, source.wh) == (30, 60, WH)
    assert len(list(decode(source, 0, 0))) == 30
    assert any("48×32" in note for note in source.notes)


def test_a_size_that_changes_back_is_named_where_it_is_read(tmp_path: Path) -> None:
    parts = [coded(smooth_pictures(20, wh), bf="0")[1] for wh in (WH, (48, 32), WH)]
    packets = [packet for part in parts for packet in part]
    for number, packet in enumerate(packets):
        packet.pts = packet.dts = number
    source = open_source(muxed(tmp_path / "a.mkv", "h264", packets), 30.0)
    with pytest.raises(UserError, match=r"frame 20 is 48×32 in a film of 96×64.*count: 20"):
        list(decode(source, 0, 0))
    assert len(list(decode(source, 0, 20))) == 20
    with pytest.raises(UserError, match="frame 20 is 48×32"):
        list(read_stills(source, [25]))
    assert len(list(small_grey(source, 48, 60))) == 20


@pytest.mark.parametrize(
    ("content", "reported"),
    [(b"", "empty"), (b"these are not frames", "cannot be read as a video"), (None, "single frame")],
    ids=["empty", "text", "one"],
)
def test_what_is_no_film_is_refused_in_one_sentence(content: bytes | None, reported: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    if content is None:
        write_video(path, PICTURES[:1])
    else:
        path.write_bytes(content)
    with pytest.raises(UserError, match=reported):
        open_source(path, 30.0)


def with_bit_errors(path: Path, numbers: set[int]) -> Path:
    """The film with errors in the packets of these numbers, in the order in which they are decoded."""
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(0)
    with av.open(str(path)) as container:
        held = [bytes(p) for k, p in enumerate(container.demux(video=0)) if k in numbers]
    for raw in held:
        begin = data.index(raw)
        for at in rng.integers(min(6, len(raw) - 1), len(raw), 30):
            data[begin + int(at)] ^= 0xFF
    path.write_bytes(bytes(data))
    return path


@pytest.mark.parametrize("codec", ["libx264", "libx265", "mjpeg"])
@pytest.mark.parametrize("damaged", [{26}, {23, 24, 25}], ids=["one", "three"])
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_frame_is_replaced_by_the_one_before(
    codec: str, damaged: set[int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mp4"
    options = {"x265-params": "keyint=10:log-level=none", "g": "10"} if codec == "libx265" else {"g": "10"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = *WH, "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for picture in PICTURES:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(stream.encode(None))
    source = open_source(with_bit_errors(path, damaged), 30.0)
    found: list[int] = []
    pictures = list(decode(source, 0, 0, found))
    assert len(pictures) == source.frames == COUNT
    assert set(range(20)).isdisjoint(found)
    assert 0 < len(found) < 20
    for number in found:
        np.testing.assert_array_equal(pictures[number], pictures[number - 1])
    np.testing.assert_array_equal(seek_frames(source, [found[0], 39]), [pictures[found[0]], pictures[39]])
    assert len(list(small_grey(source, 48, COUNT))) == COUNT
    list(decode(source, 0, 0))
    assert f"{len(found)} of {COUNT} frames are damaged" in capsys.readouterr().out


def sound_alone(path: Path) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        for number in range(20):
            piece = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            piece.rate, piece.pts = 8000, 1024 * number
            container.mux(stream.encode(piece))
        container.mux(stream.encode(None))
    return path


def announcing(path: Path, wh: tuple[int, int]) -> Path:
    """A film of 96×64 whose header says ``wh``."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = *WH, "yuv420p"
        for picture in PICTURES[:5]:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(stream.encode(None))
    own, other = (b"".join(n.to_bytes(4, "little") for n in size) for size in (WH, wh))
    path.write_bytes(path.read_bytes().replace(own, other))
    return path


def test_unreadable_footage_is_named_before_anything_runs(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "good.mp4", PICTURES)
    index = whole.read_bytes().index(b"moov") - 4
    (tmp_path / "text.mp4").write_bytes(b"these are not frames")
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[:index])
    sound_alone(tmp_path / "sound.mp4")
    announcing(tmp_path / "large.avi", (65535, 65535))
    announcing(tmp_path / "wide.avi", (20000, 20000))
    films = {path.stem: [path] for path in sorted(tmp_path.iterdir())}
    found = unreadable_footage(films)
    assert [sentence.partition(":")[0] for sentence in found] == [f"camera {name}" for name in films if name != "good"]
    assert all("train: [...]" in sentence and "\n" not in sentence for sentence in found)
    for path in (path for [path] in films.values() if path != whole):
        with pytest.raises(UserError, match=path.name):
            open_source(path, 30.0)
