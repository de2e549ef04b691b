# SPDX-License-Identifier: Apache-2.0
"""Working video, lossless (H.264 in RGB, grey as FFV1, in Matroska), and watchable H.264: written and read.

Reading starts at the first frame, at any other, or is frame by frame at any time. Colour was FFV1 too. H.264 without
quantiser and without a colour matrix keeps every bit as well and predicts from the picture before: takes and renders
are written and read in a half to a fifth of the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.container import open_container
from studiorecon.machine.resource_errors import lacks_thread
from studiorecon.scene.capture import read_footage
from studiorecon.scene.files import atomic_path
from studiorecon.scene.step_files import expect, step_file_context
from studiorecon.scene.user_files import read_bytes

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


@dataclass(frozen=True)
class Codec:
    """How a film is encoded: the pixel formats of the frames and of the encoder, and the containers."""

    name: str
    given: str
    stored: str
    options: Mapping[str, str]
    form: str = "matroska"
    form_options: Mapping[str, str] = field(default_factory=lambda: {"fflags": "+bitexact"})


# Matroska keeps the length of a frame in whole nanoseconds, others in ticks of their clock.
_SAME_RATE = 1e-3
# Users provide films of masks, too.
_CURE = "delete it, and the next run makes it again, or copy it again if it is yours"
_FFV1 = {"level": "3", "slices": "4", "slicecrc": "1"}
# A key frame every twelve, so that a single frame is read quickly.
_LOSSLESS = {
    (3, np.dtype(np.uint8)): Codec("libx264rgb", "rgb24", "rgb24", {"qp": "0", "preset": "ultrafast", "g": "12"}),
    (1, np.dtype(np.uint8)): Codec("ffv1", "gray", "gray", _FFV1),
    (1, np.dtype(np.uint16)): Codec("ffv1", "gray16le", "gray16le", _FFV1),
}


def to_bytes(image: Float[np.ndarray, " ..."]) -> Integer[np.ndarray, " ..."]:
    """uint8 of a float image in [0, 1]: clamped, rounded to nearest; NaN becomes 0."""
    return np.rint(np.clip(np.nan_to_num(image, nan=0.0, posinf=1.0, neginf=0.0), 0, 1) * 255).astype(np.uint8)


def to_float(image: Integer[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """float32 in [0, 1] of a uint8 image."""
    return image.astype(np.float32) * np.float32(1 / 255)


def write_lossless(path: Path, frames: Iterable[Integer[np.ndarray, "H W ..."]], fps: float, title: str = "") -> int:
    """Number of frames (colour or grey) that were written losslessly; ``title``: kept in the file (``camera_title``).

    Raises ValueError for frames of two sizes or none at all.
    """
    return write_film(path, frames, fps, None, title)


def camera_title(camera: str, source_sha256: str) -> str:
    """The title of a camera's working video, different for every camera and recording."""
    return f"{camera} {source_sha256}"


def write_watchable(path: Path, frames: Iterable[Integer[np.ndarray, "H W 3"]], fps: float, crf: int = 16) -> int:
    """Write frames as an H.264 mp4 that browsers play; odd sizes lose their last row or column.

    Raises ValueError for frames of two sizes or none at all.
    """
    even = (frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2] for frame in frames)
    # x264's macroblock tree gives different bytes from run to run where it uses AVX-512; films are no larger without
    # it.
    options = {"crf": str(crf), "preset": "medium", "x264-params": "mbtree=0"}
    return write_film(path, even, fps, Codec("libx264", "rgb24", "yuv420p", options, "mp4", {"movflags": "+faststart"}))


def write_film(
    path: Path, frames: Iterable[Integer[np.ndarray, "H W ..."]], fps: float, codec: Codec | None, title: str = ""
) -> int:
    """Number of frames that were written with ``codec``, or losslessly; raises ValueError for two sizes or no frame."""
    rate = Fraction(fps).limit_denominator(1001 * 60)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ValueError(f"no frames for {path}")
    codec = codec or _LOSSLESS[(1 if first.ndim == 2 else first.shape[2], first.dtype)]
    with (
        atomic_path(path) as partial,
        av.open(str(partial), "w", format=codec.form, options=dict(codec.form_options)) as container,
    ):
        container.metadata.update({"title": title} if title else {})
        stream = container.add_stream(codec.name, rate=rate, options=dict(codec.options))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = first.shape[1], first.shape[0], codec.stored
        stream.codec_context.thread_count = 1  # the same bytes on every machine
        if codec.stored == "yuv420p":
            stream.codec_context.color_range, stream.codec_context.colorspace = 1, 1
        for count, frame in enumerate(chain([first], frames), 1):
            wh, film_wh = (frame.shape[1], frame.shape[0]), (stream.width, stream.height)
            if wh != film_wh:  # encoders would rescale silently
                raise ValueError(f"{path}: frame {count - 1} is {wh[0]}×{wh[1]} in a film of {film_wh[0]}×{film_wh[1]}")
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format=codec.given)
            picture.pts = count - 1
            picture.time_base = 1 / rate
            if codec.stored == "yuv420p":
                picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return count


def frame_pixels(frame: av.VideoFrame) -> Integer[np.ndarray, "H W ..."]:
    """(H, W, 3) uint8 colours of a decoded frame, or (H, W) as stored for a grey one."""
    name = frame.format.name
    if name == "gbrp":  # as working videos are; the converter takes two to three times as long for the same bytes
        green, blue, red = (
            np.frombuffer(memoryview(p), np.uint8).reshape(-1, p.line_size)[: p.height, : p.width] for p in frame.planes
        )
        return cv2.merge((red, green, blue))
    if name.startswith("gray"):
        return frame.to_ndarray(format="gray16le" if "16" in name else "gray")
    return frame.to_ndarray(format="rgb24")


def read_frames(path: Path, start: int = 0, stop: int | None = None) -> Iterator[Integer[np.ndarray, "H W ..."]]:
    """Frames ``start`` … ``stop`` - 1 of a working video, in order, as stored.

    Raises UserError naming the file when it is missing, unreadable or ends early.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing")
    number = -1
    try:
        with open_container(path) as container:
            stream = container.streams.video[0]
            held = _as_captured(path, container, stream)
            stop = held if stop is None else stop
            stream.thread_type = "AUTO"
            for number, frame in enumerate(container.decode(stream)):
                if stop is not None and number >= stop:
                    return
                if number >= start:
                    yield frame_pixels(frame)
    except (av.FFmpegError, IndexError) as error:
        if lacks_thread(error):
            raise
        raise UserError(f"{path} cannot be read after frame {number} ({error}); it may be truncated: {_CURE}") from None
    if stop is not None and number + 1 < stop:
        raise UserError(f"{path} ends after {number + 1} frames where {stop} are needed; {_CURE}")


def read_frames_from(path: Path, start: int, stop: int) -> Iterator[Integer[np.ndarray, "H W ..."]]:
    """Frames ``start`` … ``stop`` - 1 as from ``read_frames``, after seeking to the key frame before.

    Only for videos that this package wrote, whose frames are on a regular grid of times. Raises UserError naming the
    file when it is missing, unreadable or ends early.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing")
    expected = start
    try:
        with open_container(path) as container:
            stream = container.streams.video[0]
            _as_captured(path, container, stream)
            stream.thread_type = "AUTO"
            seconds_per_tick, rate = stream.time_base, stream.average_rate
            assert seconds_per_tick is not None
            assert rate is not None
            container.seek(int(start / rate / seconds_per_tick), stream=stream, backward=True)
            for frame in container.decode(stream):
                number = round((frame.pts or 0) * seconds_per_tick * rate)
                if expected == stop:
                    return
                if number < expected:
                    continue
                if number > expected:
                    break
                yield frame_pixels(frame)
                expected += 1
    except (av.FFmpegError, IndexError) as error:
        if lacks_thread(error):
            raise
        raise UserError(f"{path} cannot be read at frame {expected} ({error}); it may be truncated: {_CURE}") from None
    if expected < stop:
        raise UserError(f"{path} has no frame {expected} where frames up to {stop - 1} are needed; {_CURE}")


def _as_captured(path: Path, container: av.container.InputContainer, stream: av.VideoStream) -> int | None:
    """Number of frames of a camera's working video, by the sidecar file of its name; None for any other video.

    Raises UserError naming the video when its camera or recording, length, size or rate differs from the sidecar's.
    """
    about = path.with_suffix(".json")
    if path.parent.name != "capture" or not about.is_file():
        return None
    footage = read_footage(about)
    title, rate, lasts = container.metadata.get("title", ""), stream.average_rate, container.duration
    with step_file_context(path):
        size = f"{stream.width}×{stream.height}, {about.name} says {footage.wh[0]}×{footage.wh[1]}"
        expect((stream.width, stream.height) == footage.wh, f"it is {size}")
        expect(
            title in ("", camera_title(footage.camera, footage.source_sha256)),
            f"it is of {title.rpartition(' ')[0]} or of another recording",
        )
        expect(
            rate is not None and abs(float(rate) / footage.fps - 1) < _SAME_RATE,
            f"it has {float(rate or 0):g} frames per second, {about.name} says {footage.fps:g}",
        )
        if lasts is not None and rate is not None:
            frames = round(lasts / av.time_base * rate)
            expect(frames == footage.frames, f"it has {frames} frames, {about.name} says {footage.frames}")
    return footage.frames


def read_frame(path: Path, index: int) -> Integer[np.ndarray, "H W ..."]:
    """One frame of a working video."""
    return next(read_frames_from(path, index, index + 1))


def read_stack(path: Path, start: int = 0, stop: int | None = None) -> Integer[np.ndarray, "T H W ..."]:
    """(T, H, W[, 3]) all frames at once, as stored."""
    return np.stack(list(read_frames(path, start, stop)))


def encoded_film(path: Path) -> bytes:
    """The bytes of a step's film, for a page that holds it; raises UserError where they cannot be read."""
    return read_bytes(path)


class Playback:
    """One video from frame ``first`` on, for ``count`` frames: ``at(i)`` is frame ``first + i``.

    The training shot holds all cameras one after the other, so each camera's part is a Playback of its own.
    """

    def __init__(self, path: Path, first: int, count: int) -> None:
        self._path, self._first, self._count = path, first, count
        self._frames: Iterator[np.ndarray] = iter(())
        self._index = -1
        self._current: np.ndarray | None = None
        self._rewind()

    def at(self, index: int) -> Integer[np.ndarray, "H W ..."]:
        """Frame ``index`` as stored; IndexError outside 0 … count - 1."""
        if not 0 <= index < self._count:
            raise IndexError(f"{self._path} has {self._count} frames from {self._first}, not {index}")
        if index < self._index:
            self._rewind()
        while self._index < index:
            self._current = next(self._frames)
            self._index += 1
        assert self._current is not None
        return self._current

    def _rewind(self) -> None:
        self._frames = read_frames_from(self._path, self._first, self._first + self._count)
        self._index = -1
