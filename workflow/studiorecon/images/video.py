# SPDX-License-Identifier: Apache-2.0
"""Lossless working video (FFV1 in Matroska) and the H.264 files people watch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.scene.files import complete

# FFV1 keeps 8-bit RGB as bgr0 (a byte shuffle and a reversible transform, no colour matrix) and grey as it is.
_LOSSLESS = {(3, np.dtype(np.uint8)): ("rgb24", "bgr0"), (1, np.dtype(np.uint8)): ("gray", "gray"),
             (1, np.dtype(np.uint16)): ("gray16le", "gray16le")}  # fmt: skip


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 of a float image in [0, 1]: clamped, rounded to nearest; NaN becomes 0."""
    return np.rint(np.clip(np.nan_to_num(image, nan=0.0, posinf=1.0, neginf=0.0), 0, 1) * 255).astype(np.uint8)


def to_float(image: np.ndarray) -> np.ndarray:
    """float32 in [0, 1] of a uint8 image."""
    return image.astype(np.float32) * np.float32(1 / 255)


def write_lossless(path: Path, frames: Iterable[np.ndarray], fps: float) -> int:
    """Write frames as FFV1: (H, W, 3) uint8, (H, W) uint8 or (H, W) uint16; returns how many.

    Raises ValueError for frames of two sizes or none at all.
    """
    return _write(path, frames, fps, "ffv1", {"level": "3", "slices": "4", "slicecrc": "1"})


def write_watchable(path: Path, frames: Iterable[np.ndarray], fps: float, crf: int = 16) -> int:
    """Write (H, W, 3) uint8 frames as an H.264 mp4 that browsers play; odd sizes lose their last row or column.

    Raises ValueError for frames of two sizes or none at all.
    """
    even = (frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2] for frame in frames)
    return _write(path, even, fps, "libx264", {"crf": str(crf), "preset": "medium", "movflags": "+faststart"})


def _write(path: Path, frames: Iterable[np.ndarray], fps: float, codec: str, options: dict[str, str]) -> int:
    rate = Fraction(fps).limit_denominator(1001 * 60)
    count = 0
    with complete(path) as partial:
        form = "mp4" if codec == "libx264" else "matroska"
        container_options = {"movflags": options.pop("movflags")} if "movflags" in options else {"fflags": "+bitexact"}
        with av.open(str(partial), "w", format=form, options=container_options) as container:
            stream = None
            for frame in frames:
                frame = np.ascontiguousarray(frame)
                given, stored = _LOSSLESS[(1 if frame.ndim == 2 else frame.shape[2], frame.dtype)]
                if stream is None:
                    stream = container.add_stream(codec, rate=rate, options=options)
                    stream.width, stream.height = frame.shape[1], frame.shape[0]
                    stream.pix_fmt = "yuv420p" if codec == "libx264" else stored
                    stream.codec_context.thread_count = 1  # the same bytes on every machine
                    if codec == "libx264":
                        stream.codec_context.color_range, stream.codec_context.colorspace = 1, 1
                wh, film_wh = (frame.shape[1], frame.shape[0]), (stream.width, stream.height)
                if wh != film_wh:  # encoders would rescale silently
                    raise ValueError(f"{path}: frame {count} is {wh[0]}×{wh[1]} in a film of {film_wh[0]}×{film_wh[1]}")
                picture = av.VideoFrame.from_ndarray(frame, format=given)
                picture.pts = count
                picture.time_base = 1 / rate
                if codec == "libx264":
                    picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
                container.mux(stream.encode(picture))
                count += 1
            if stream is None:
                raise ValueError(f"no frames for {path}")
            container.mux(stream.encode(None))
    return count


def read_frames(path: Path, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
    """Frames ``start`` … ``stop`` - 1 of a working video, in order: (H, W, 3) uint8, or (H, W) for grey ones.

    Raises Refusal naming the file when it is missing, unreadable or ends early.
    """
    if not path.is_file():
        raise Refusal(f"{path} is missing")
    number = -1
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            for number, frame in enumerate(container.decode(stream)):
                if stop is not None and number >= stop:
                    return
                if number >= start:
                    name = frame.format.name
                    grey = name.startswith("gray")
                    yield frame.to_ndarray(format=("gray16le" if "16" in name else "gray") if grey else "rgb24")
    except (av.FFmpegError, IndexError) as error:
        raise Refusal(f"{path} cannot be read after frame {number} ({error}); it may be truncated: copy it again") from None
    if stop is not None and number + 1 < stop:
        raise Refusal(f"{path} ends after {number + 1} frames where {stop} are needed")


def read_frame(path: Path, index: int) -> np.ndarray:
    """One frame of a working video."""
    return next(read_frames(path, index, index + 1))


def read_stack(path: Path, start: int = 0, stop: int | None = None) -> np.ndarray:
    """(T, H, W[, 3]) all frames at once, as stored."""
    return np.stack(list(read_frames(path, start, stop)))
