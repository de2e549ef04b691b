# SPDX-License-Identifier: Apache-2.0
"""A camera's footage as the user has it: a video file, or a folder of pictures, read frame by frame the right way
up."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.container import films_of, opened, parts_of
from studiorecon.footage.stills import decoded
from studiorecon.machine.refusals import without_thread
from studiorecon.scene.dataset import PICTURE_SUFFIXES
from studiorecon.scene.numbered import gaps_named, pictures_in

if TYPE_CHECKING:
    from jaxtyping import Integer

_READ_BYTES = 1 << 20
# A container may announce one frame more than it holds (an edit list, a rounded duration) without having lost any.
_MISCOUNT_FRAMES = 1
# A gap of this many frame times between two pictures means that the recorder skipped some.
_GAP_FRAMES = 1.5


@dataclass(frozen=True)
class PictureRate:
    """What a folder of pictures cannot say itself; every step that opens footage is told."""

    picture_fps: float = setting(30.0, "Frame rate of footage that is a folder of pictures.", above=0, maximum=1000)


@dataclass(frozen=True)
class FootageSource:
    """What a video's header, or a folder's listing, says.

    Attributes:
        path: the video file or folder.
        wh: size after the rotation tag.
        fps: average frames per second.
        declared_frames: number of frames the header announces; None when it does not say.
        rotation_deg: counter-clockwise turn the rotation tag asks for: 0, 90, 180 or 270.
        pictures: the files of a folder in order; empty for a video.
        notes: sentences about what is unusual.
    """

    path: Path
    wh: tuple[int, int]
    fps: float
    declared_frames: int | None
    rotation_deg: int
    pictures: tuple[Path, ...]
    notes: tuple[str, ...]


def open_source(path: Path, picture_fps: float) -> FootageSource:
    """The footage at ``path``; ``picture_fps`` is the rate of a folder of pictures, which cannot say so itself.

    Raises UserError naming the file or folder and the remedy when it is missing, unreadable, empty or without a frame
    rate.
    """
    if path.is_dir():
        return _open_folder(path, picture_fps)
    if not path.is_file():
        raise UserError(
            f"footage {path} is missing; put the video back, or leave its camera out with train: [...] in capture.yaml"
        )
    try:
        with opened(path) as container:
            if not container.streams.video:
                raise UserError(f"{path} holds no video; put the camera's video there")
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            first = next(container.decode(stream), None)
            if first is None:
                raise UserError(f"{path} holds no frames; copy the recording again")
            if not rate:
                raise UserError(f"{path} does not say its frame rate; rewrite it with a constant one")
            rotation_deg = int(round(first.rotation / 90) * 90) % 360
            declared = stream.frames or _frames_by_duration(container, stream, float(rate))
            wh = (first.width, first.height) if rotation_deg % 180 == 0 else (first.height, first.width)
            notes = (
                "the footage is interlaced: moving edges are combed; a progressive recording is better",
            ) * first.interlaced_frame
    except (av.FFmpegError, IndexError) as error:
        if without_thread(error):
            raise
        raise UserError(
            f"{path} cannot be read as a video "
            f"({getattr(error, 'strerror', None) or error}); it may be truncated: copy it "
            "again"
        ) from None
    return FootageSource(path, wh, float(rate), declared, rotation_deg, (), notes)


def decode(source: FootageSource, first: int, count: int) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Frames ``first`` … ``first`` + ``count`` − 1 (``count`` 0 = to the end), (H, W, 3) uint8 RGB, rotation tag
    applied.

    Raises UserError naming file and frame when a frame is damaged, when the footage ends early, or when nothing is left
    of it. A damaged end does not matter when the chosen frames lie before it.
    """
    stop = first + count if count else None
    number = 0
    for frame in _decode_folder(source) if source.pictures else _decode_video(source):
        if stop is not None and number >= stop:
            return
        if number >= first:
            yield frame
        number += 1
    if number <= first or (stop is not None and number < stop):
        wanted = f"{first} to {stop - 1}" if stop is not None else f"{first} and after"
        raise UserError(
            f"{source.path} has {number} frames, but frames {wanted} were asked for; change frames: in capture.yaml"
        )
    if stop is None and source.declared_frames is not None and number < source.declared_frames - _MISCOUNT_FRAMES:
        raise UserError(
            f"{source.path} is truncated: its header announces {source.declared_frames} "
            f"frames and {number} are there; copy it again, "
            f"or use what is there with frames: {{first: {first}, count: {number - first}}} in capture.yaml"
        )


def uneven(times_s: Sequence[float], first: int) -> str | None:
    """What is odd about the times (seconds) of successive frames from ``first`` on: a dropped frame puts all that
    follow out of step."""
    gaps = np.diff(np.asarray(times_s, dtype=float))
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    if usual <= 0:
        return None
    odd = np.flatnonzero((gaps > _GAP_FRAMES * usual) | (gaps < usual / _GAP_FRAMES))
    if not len(odd):
        return None
    worst = odd[np.argmax(np.abs(gaps[odd] - usual))]
    return (
        f"frames do not come evenly: {len(odd)} of {len(gaps)} steps differ from the usual "
        f"{1000 * usual:.0f} ms, most after frame "
        f"{first + worst} ({1000 * gaps[worst]:.0f} ms)"
    )


def digest(source: FootageSource) -> str:
    """SHA-256 of the video file, or of the digests of a folder's pictures, or a recording's chapters, in order."""
    files = source.pictures or films_of(source.path)
    if files == (source.path,):
        return _file_digest(source.path)
    whole = hashlib.sha256()
    for picture in files:
        whole.update(_file_digest(picture).encode())
    return whole.hexdigest()


def stills(source: FootageSource, wanted: Sequence[int]) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """The frames numbered ``wanted`` (ascending, maybe twice), as ``decode`` gives them; numbers past the end are left
    out.

    Raises UserError as ``decode`` does, but for damage after the last of them.
    """
    chosen = Counter(wanted)
    if source.pictures:
        wanted = [number for number in wanted if number < len(source.pictures)]
        yield from _decode_folder(replace(source, pictures=tuple(source.pictures[number] for number in wanted)))
        return
    for number, frame in enumerate(_video_frames(source)):
        if chosen[number]:
            yield from [_upright(frame, source)] * chosen[number]
        if number == max(chosen, default=-1):
            return


def glimpses(source: FootageSource, wanted: Sequence[int]) -> list[Integer[np.ndarray, "H W 3"]]:
    """The frames numbered ``wanted`` (ascending; beyond the end: the last one that can be read), as ``decode`` gives
    them.

    A video is sought to the key frame before each, unless the last one lies behind that, so a frame costs at most one
    group of pictures. Raises UserError when nothing can be read.
    """
    if source.pictures:
        last = len(source.pictures) - 1
        shown = tuple(source.pictures[min(number, last)] for number in wanted)
        return list(_decode_folder(replace(source, pictures=shown)))
    if len(chapters := parts_of(source.path)) > 1:
        # FFmpeg's list of films cannot be sought to the key frame before a time.
        return _glimpses_of_chapters(source, chapters, wanted)
    try:
        with opened(source.path) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            found = list(_frames_at(container, stream, wanted, source.fps))
    except (av.FFmpegError, IndexError) as error:
        if without_thread(error):
            raise
        raise UserError(f"{source.path} cannot be read as a video ({error}); copy it again") from None
    frames = [frame for frame in found if frame is not None]
    if len(frames) < len(found):
        raise UserError(f"{source.path} holds no readable frame; copy the recording again")
    return [_upright(frame, source) for frame in frames]


def _glimpses_of_chapters(
    source: FootageSource, chapters: Sequence[tuple[Path, float]], wanted: Sequence[int]
) -> list[Integer[np.ndarray, "H W 3"]]:
    ends = np.cumsum([round(seconds * source.fps) for _, seconds in chapters])
    within = np.minimum(np.searchsorted(ends, wanted, side="right"), len(chapters) - 1)
    found = []
    for number, (film, _) in enumerate(chapters):
        before = int(ends[number - 1]) if number else 0
        if here := [frame - before for frame, at in zip(wanted, within, strict=True) if at == number]:
            found += glimpses(replace(source, path=film), here)
    return found


def _frames_at(
    container: av.container.InputContainer, stream: av.VideoStream, wanted: Sequence[int], fps: float
) -> Iterator[av.VideoFrame | None]:
    """The frames shown at ``wanted`` (ascending) / ``fps``, each the last one before the footage ends where it does."""
    assert stream.time_base is not None
    half = 0.5 / fps / float(stream.time_base)
    last: av.VideoFrame | None = None
    frames: Iterator[av.VideoFrame] = iter(())
    for index in wanted:
        target = (stream.start_time or 0) + round(index / fps / stream.time_base)
        if last is None or last.pts is None or _key_frame_between(stream, last.pts, target):
            container.seek(target, stream=stream, backward=True)
            frames, last = container.decode(stream), None
        while last is None or (last.pts is not None and last.pts < target - half):
            following = next(frames, None)
            if following is None:
                break
            last = following
        yield last


def _key_frame_between(stream: av.VideoStream, after: int, target: int) -> bool:
    """Whether decoding on from ``after`` takes longer than from the key frame before ``target``; also where the file's
    index does not reach that far."""
    index = stream.index_entries
    if not len(index) or index[-1].timestamp < target:
        return True
    return any(entry.is_keyframe and after < entry.timestamp <= target for entry in index)


def _decode_video(source: FootageSource) -> Iterator[np.ndarray]:
    for frame in _video_frames(source):
        yield _upright(frame, source)


def _upright(frame: av.VideoFrame, source: FootageSource) -> np.ndarray:
    picture = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(picture, source.rotation_deg // 90)) if source.rotation_deg else picture


def _video_frames(source: FootageSource) -> Iterator[av.VideoFrame]:
    number = -1
    try:
        with opened(source.path) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            for number, frame in enumerate(container.decode(stream)):
                if frame.is_corrupt:
                    raise UserError(
                        f"{source.path}: frame {number} is damaged; copy it again, or choose "
                        "others with frames: in capture.yaml"
                    )
                yield frame
    except av.FFmpegError as error:
        if without_thread(error):
            raise
        raise UserError(
            f"{source.path} cannot be read after frame {number} ({error.strerror or error}); "
            "copy it again, or use what is there with "
            f"frames: {{count: {number + 1}}} in capture.yaml"
        ) from None


def _decode_folder(source: FootageSource) -> Iterator[np.ndarray]:
    for path in source.pictures:
        picture = decoded(path, cv2.IMREAD_COLOR, "replace it, or leave its frame out with frames: in capture.yaml")
        if (picture.shape[1], picture.shape[0]) != source.wh:
            size = f"{picture.shape[1]}×{picture.shape[0]}"
            raise UserError(
                f"{path} is {size}, but the first picture of its folder is {source.wh[0]}×{source.wh[1]}; use one size"
            )
        yield np.ascontiguousarray(picture[..., ::-1])


def _open_folder(path: Path, picture_fps: float) -> FootageSource:
    pictures = pictures_in(path)
    if not pictures:
        raise UserError(f"{path} holds no pictures; put the camera's frames there ({', '.join(PICTURE_SUFFIXES)})")
    if missing := gaps_named(pictures):
        raise UserError(
            f"{path} lacks the pictures {missing}, and every later one would stand at another moment than in the other "
            "cameras; copy them again, or number the pictures without a gap"
        )
    first = decoded(pictures[0], cv2.IMREAD_COLOR)
    note = f"a folder of pictures has no frame rate: {picture_fps:g} per second, as capture.picture_fps says"
    return FootageSource(
        path, (first.shape[1], first.shape[0]), picture_fps, len(pictures), 0, tuple(pictures), (note,)
    )


def _frames_by_duration(container: av.container.InputContainer, stream: av.VideoStream, fps: float) -> int | None:
    if stream.duration is not None and stream.time_base is not None:
        return int(stream.duration * stream.time_base * fps)
    # A container lasts as long as its longest stream, which may be the sound.
    if len(container.streams) > 1 or container.duration is None:
        return None
    return int(container.duration / av.time_base * fps)


def _file_digest(path: Path) -> str:
    whole = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(_READ_BYTES):
            whole.update(block)
    return whole.hexdigest()
