# SPDX-License-Identifier: Apache-2.0
"""Reads the pictures of a camera's footage as shown: in order, some of them, or small and grey."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
from av.video.reformatter import VideoReformatter

from studiorecon.errors import UserError
from studiorecon.footage.container import film_stream, open_container
from studiorecon.footage.source import FootageSource, film_context
from studiorecon.footage.stills import read_image
from studiorecon.footage.timing import DamagedFrameError, film_frames, shown_frames
from studiorecon.machine.resource_errors import lacks_thread
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Integer

# Times are sums of ticks of a container's clock; its finest tick is far longer than this.
_TICK_S = 1e-6
# Ways to read a picture in grey: whole, at a half, a quarter, an eighth.
_HALVED = (
    cv2.IMREAD_GRAYSCALE,
    cv2.IMREAD_REDUCED_GRAYSCALE_2,
    cv2.IMREAD_REDUCED_GRAYSCALE_4,
    cv2.IMREAD_REDUCED_GRAYSCALE_8,
)


def decode(
    source: FootageSource, first: int, count: int, damaged: list[int] | None = None
) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Frames ``first`` … ``first`` + ``count`` − 1 (``count`` 0 = to the end), as shown.

    A damaged frame of a video is replaced by the one before; its number is appended to ``damaged``, or, without such a
    list, a warning follows at the end. Raises UserError naming file and frame when a picture of a folder is damaged,
    when a frame is of another size, and when the footage has no such frames.
    """
    stop = first + count if count else source.frames
    if first >= source.frames or stop > source.frames:
        wanted = f"{first} to {stop - 1}" if count else f"{first} and after"
        raise UserError(
            f"{source.path} has {source.frames} frames, but frames {wanted} were requested; change frames: in "
            "capture.yaml"
        )
    if source.pictures:
        yield from _decode_folder(source, source.pictures[first:stop])
        return
    form = source.form
    assert form is not None
    missing: list[int] = []
    yield from form.pictures(_frames_from(source, first, stop, missing))
    missing = [number for number in missing if number >= first]
    if damaged is not None:
        damaged += missing
    elif missing:
        warn(f"{source.path}: {damage_note(missing, stop - first)}")


def damage_note(damaged: Sequence[int], count: int) -> str:
    """The sentence about the numbers of ``damaged`` frames among ``count``."""
    return (
        f"{len(damaged)} of {count} frames are damaged, frame {damaged[0]} first: the picture before each is "
        "repeated; if the original is whole, copy it again"
    )


def read_stills(source: FootageSource, wanted: Sequence[int]) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """The frames numbered ``wanted`` (ascending, maybe twice) as from ``decode``, without those past the end.

    Raises UserError as ``decode`` does.
    """
    chosen = Counter(number for number in wanted if number < source.frames)
    if source.pictures:
        yield from _decode_folder(source, [source.pictures[number] for number in chosen.elements()])
        return
    form = source.form
    assert form is not None
    shown = enumerate(islice(_video_frames(source), max(chosen, default=-1) + 1))
    yield from form.pictures(frame for number, frame in shown for _ in range(chosen[number]))


def seek_frames(source: FootageSource, wanted: Sequence[int]) -> list[Integer[np.ndarray, "H W 3"]]:
    """``spread_frames`` as a list."""
    return list(spread_frames(source, wanted))


def spread_frames(source: FootageSource, wanted: Sequence[int]) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """The frames numbered ``wanted`` (ascending; beyond the end: the last one), as from ``decode``.

    A video is sought to the key frame before each, so a frame costs at most one group of pictures. Raises UserError
    when nothing can be read.
    """
    wanted = [min(number, source.frames - 1) for number in wanted]
    if source.pictures or not source.carried:
        yield from read_stills(source, wanted)
        return
    begin = 0
    for part in source.parts:
        yield from spread_frames(part, [number - begin for number in wanted if begin <= number < begin + part.frames])
        begin += part.frames
    if source.parts:
        return
    assert source.form is not None
    done = 0
    for picture in source.form.pictures(_sought(source, wanted)):
        yield picture
        done += 1
    yield from read_stills(source, wanted[done:])


def _sought(source: FootageSource, wanted: Sequence[int]) -> Iterator[av.VideoFrame]:
    """The frames numbered ``wanted`` (ascending) up to one that is damaged, or where a container does not seek.

    From a damaged frame on one thread decodes, as in ``film_frames``.
    """
    done = 0
    for threads in ("AUTO", "SLICE"):
        try:
            with open_container(source.path) as container:
                film_stream(container).thread_type = threads
                for frame in _frames_at(source, container, wanted[done:], to_damage=threads == "AUTO"):
                    if frame is None:
                        return
                    yield frame
                    done += 1
            return
        except DamagedFrameError:
            continue
        except (av.FFmpegError, IndexError) as error:
            if lacks_thread(error):
                raise
            return


def small_grey(source: FootageSource, width: int, count: int) -> Iterator[Integer[np.ndarray, "h w"]]:
    """The first ``count`` frames in grey, at most ``width`` pixels along the longer side, not turned upright.

    Ends at the first unreadable frame, which proper decoding reports.
    """
    shrink = max(1.0, max(source.wh) / width)
    small = _small(source.form.square_wh if source.form else source.wh, shrink)
    with suppress(UserError):
        if source.pictures:
            # A JPEG read grey and small takes a fraction of the time.
            halved = min(int(np.log2(shrink)), len(_HALVED) - 1)
            for path in source.pictures[:count]:
                yield cv2.resize(read_image(path, _HALVED[halved]), small, interpolation=cv2.INTER_AREA)
            return
        # One for all frames: its setup takes several times as long as a frame.
        shrinking = VideoReformatter()
        for frame in islice(_video_frames(source), count):
            grey = shrinking.reformat(frame, width=small[0], height=small[1], format="gray", interpolation="AREA")
            yield grey.to_ndarray()


def _frames_from(source: FootageSource, first: int, stop: int, damaged: list[int]) -> Iterator[av.VideoFrame]:
    """The frames ``first`` to ``stop`` − 1; frames deep in a film are reached by seeking where that works."""
    begin = 0
    for part in source.parts:
        low, high = max(first - begin, 0), min(stop - begin, part.frames)
        if low < high:
            own: list[int] = []
            yield from _frames_from(part, low, high, own)
            damaged += [begin + number for number in own]
        begin += part.frames
    if source.parts:
        return
    done = first
    if first and source.carried:
        for frame in _sought(source, range(first, stop)):
            yield frame
            done += 1
    yield from islice(_video_frames(source, damaged), done, stop) if done < stop else ()


def _small(wh: tuple[int, int], shrink: float) -> tuple[int, int]:
    return max(2, round(wh[0] / shrink)), max(2, round(wh[1] / shrink))


def _frames_at(
    source: FootageSource, container: av.container.InputContainer, wanted: Sequence[int], to_damage: bool
) -> Iterator[av.VideoFrame | None]:
    """The frames numbered ``wanted`` (ascending), by their times; None for one that seeking does not reach.

    ``to_damage``: as of ``shown_frames``.
    """
    assert source.form is not None
    stream = film_stream(container)
    assert stream.time_base is not None
    half_s = 0.5 / source.fps
    # Deinterlacing needs the frames between.
    needed = None if source.form.deinterlacing else {round(source.times_s[n] / stream.time_base) for n in wanted}
    last: av.VideoFrame | None = None
    frames: Iterator[av.VideoFrame] = iter(())
    for before, index in zip([-1, *wanted], wanted):
        target_s = source.times_s[index]
        half_s = 0.5 * min(np.diff(source.times_s[max(index - 1, 0) : index + 2]), default=1 / source.fps)
        if last is None or (index > before + 1 and _key_frame_between(stream, last.time, target_s)):
            container.seek(int(target_s / stream.time_base), stream=stream, backward=True)
            shown = shown_frames(container, stream, to_damage, needed)
            frames, last = source.form.without_fields(_of_one_size(source, shown)), None
        while last is None or last.time < target_s - half_s:
            following = next(frames, None)
            if following is None:
                break
            last = following
        yield last if last is not None and abs(last.time - target_s) < half_s else None


def _key_frame_between(stream: av.VideoStream, after_s: float, target_s: float) -> bool:
    """Whether decoding on from ``after_s`` takes longer than from the key frame before ``target_s``, if indexed."""
    assert stream.time_base is not None
    index, after, target = stream.index_entries, after_s / stream.time_base, target_s / stream.time_base
    if not len(index) or index[-1].timestamp < target:
        return True
    return any(entry.is_keyframe and after < entry.timestamp <= target for entry in index)


def _video_frames(source: FootageSource, damaged: list[int] | None = None) -> Iterator[av.VideoFrame]:
    """All frames that ``source`` counts, without fields and in stored colours.

    A frame missing at its time is replaced by the one before (or the first); its number goes into ``damaged``.
    """
    assert source.form is not None
    damaged = [] if damaged is None else damaged
    if source.parts:
        begin = 0
        for part in source.parts:
            own: list[int] = []
            for frame in _video_frames(part, own):
                damaged += [begin + number for number in own]
                own.clear()
                yield frame
            begin += part.frames
        return
    done, last = 0, None
    with film_context(source.path):
        shown = _of_one_size(source, film_frames(source.path))
        for frame in source.form.without_fields(shown):
            number = int(np.searchsorted(source.times_s, frame.time - _TICK_S)) if source.carried else done
            while done < min(number, source.frames):
                damaged.append(done)
                done += 1
                yield last or frame
            if number == done < source.frames:
                done, last = done + 1, frame
                yield frame
        if last is None:
            raise ValueError("no frame can be decoded")
    for number in range(done, source.frames):
        damaged.append(number)
        yield last


def _or_the_part_before(frames: int) -> str:
    """The advice to use so many first frames, of which one alone is refused."""
    return f", or use the part before with frames: {{count: {frames}}} in capture.yaml" if frames > 1 else ""


def _of_one_size(source: FootageSource, frames: Iterator[av.VideoFrame]) -> Iterator[av.VideoFrame]:
    """``frames`` up to the last one that ``source`` counts; raises UserError for a frame of another size."""
    assert source.form is not None
    for number, frame in enumerate(frames):
        if source.carried and frame.pts is None:  # concealed, at an unknown time
            continue
        # After a jump the number is that of the frame's time.
        at = int(np.searchsorted(source.times_s, frame.time - _TICK_S)) if source.carried else number
        if at >= source.frames:
            return
        if (frame.width, frame.height) != source.form.wh:
            (width, height), (expected, high) = (frame.width, frame.height), source.form.wh
            raise UserError(
                f"{source.path}: frame {at} is {width}×{height} in a film of {expected}×{high}; cut the film there"
                f"{_or_the_part_before(at)}"
            )
        yield frame


def _decode_folder(source: FootageSource, paths: Sequence[Path]) -> Iterator[np.ndarray]:
    for path in paths:
        picture = read_image(path, cv2.IMREAD_COLOR, "replace it, or leave its frame out with frames: in capture.yaml")
        if (picture.shape[1], picture.shape[0]) != source.wh:
            size = f"{picture.shape[1]}×{picture.shape[0]}"
            raise UserError(
                f"{path} is {size}, but the first picture of its folder is {source.wh[0]}×{source.wh[1]}; use one size"
            )
        yield np.ascontiguousarray(picture[..., ::-1])
