# SPDX-License-Identifier: Apache-2.0
"""A camera's footage as the user has it: a video file, or a folder of pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import av
import cv2
import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.container import film_stream, film_streams, open_container, read_film_list
from studiorecon.footage.stills import read_image
from studiorecon.footage.stored_format import StoredFormat, stored_format
from studiorecon.footage.timing import read_timing, shown_frames
from studiorecon.machine.resource_errors import lacks_thread
from studiorecon.scene.dataset import PICTURE_SUFFIXES
from studiorecon.scene.numbered_files import missing_numbers_text, pictures_in

# Cameras film 80 megapixels at most (12K); a decoder allocates several times the size in the header.
_MAX_PIXELS = 100_000_000
# A gap of this many frame times between two pictures means that the recorder dropped some.
_GAP_FRAMES = 1.5


@dataclass(frozen=True)
class PictureRate:
    """The frame rate of a folder of pictures, which has none itself; a setting of every step that opens footage."""

    picture_fps: float = setting(30.0, "Frame rate of footage given as pictures.", above=0, maximum=1000)


@dataclass(frozen=True)
class FootageSource:
    """The frames that a decoder shows of a video, or the pictures in a folder.

    Attributes:
        wh: size as shown: upright, with square pixels.
        announced: number of frames in the video's header; more than ``frames`` where its end cannot be used.
        times_s: time of each on the video's own time line; empty for a folder.
        carried: whether decoded frames carry these times, so that each can be sought.
        form: how a video's frames are stored; None for a folder.
        parts: the chapters of a recording in several files, in order; else empty.
        pictures: the files of a folder in order; empty for a video.
        notes: sentences about unusual properties.
    """

    path: Path
    wh: tuple[int, int]
    fps: float
    frames: int
    announced: int
    times_s: tuple[float, ...] = ()
    carried: bool = True
    form: StoredFormat | None = None
    parts: tuple[FootageSource, ...] = ()
    pictures: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def rotation_deg(self) -> int:
        """Counter-clockwise turn by the rotation tag: 0, 90, 180 or 270."""
        return self.form.rotation_deg if self.form else 0

    @property
    def stored_wh(self) -> tuple[int, int]:
        """Size upright, with pixels as stored: often the only one that other programs know."""
        return self.form.stored_wh if self.form else self.wh


def open_source(path: Path, picture_fps: float) -> FootageSource:
    """The footage at ``path``; ``picture_fps`` is the rate of a folder of pictures, which has none itself.

    Raises UserError naming the file or folder and the remedy when it is missing, unreadable, empty or without a rate.
    """
    if path.is_dir():
        return _open_folder(path, picture_fps)
    if path.is_file() and (films := read_film_list(path)) != (path,):
        return _joined(path, [open_source(film, picture_fps) for film in films])
    return _open_film(path, _stamp(path))


def check_readable(path: Path) -> None:
    """Raise UserError as ``open_source`` does if the first picture of the footage at ``path`` cannot be decoded."""
    if path.is_dir():
        _open_folder(path, 1.0)
    else:
        _probe_first_frame(path, _stamp(path))


def _stamp(path: Path) -> tuple[int, int]:
    """A film's modification time (ns) and its size in bytes; raises UserError where there is none."""
    if not path.is_file():
        raise UserError(
            f"footage {path} is missing; put the video back, or leave its camera out with train: [...] in capture.yaml"
        )
    about = path.stat()
    if not about.st_size:
        raise UserError(f"{path} is an empty file; copy the recording again")
    return about.st_mtime_ns, about.st_size


def _joined(path: Path, parts: Sequence[FootageSource]) -> FootageSource:
    """The film of a list of chapters, each of which begins one frame time after the last frame of the one before."""
    times_s: list[float] = []
    for part in parts:
        begin_s = times_s[-1] + 1 / parts[0].fps if times_s else part.times_s[0]
        times_s += [begin_s + time_s - part.times_s[0] for time_s in part.times_s]
    return replace(
        parts[0],
        path=path,
        frames=len(times_s),
        announced=sum(part.announced for part in parts),
        times_s=tuple(times_s),
        parts=tuple(parts),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


@lru_cache(maxsize=64)
def _open_film(path: Path, stamp: tuple[int, int]) -> FootageSource:
    """The film at ``path``; every packet is examined, once per version of the file."""
    form, notes = _probe_first_frame(path, stamp)
    with film_context(path):
        timing = read_timing(path)
    frames = len(timing.times_s)
    if frames == 1:
        raise UserError(f"{path} holds a single frame; put the camera's video there")
    return FootageSource(
        path,
        form.shown_wh,
        timing.fps,
        frames,
        timing.announced,
        timing.times_s,
        timing.carried,
        form,
        notes=(*notes, *timing.notes),
    )


@lru_cache(maxsize=64)
def _probe_first_frame(path: Path, _: tuple[int, int]) -> tuple[StoredFormat, tuple[str, ...]]:
    """How the frames of a film are stored, by its header and its first picture, and sentences about that."""
    with film_context(path), open_container(path) as container:
        streams = film_streams(container)
        if not streams:
            kinds = "sound" if container.streams.audio else "none"
            raise UserError(f"{path} holds no video ({kinds} only); put the camera's video there")
        width, height = streams[0].width, streams[0].height
        if width * height > _MAX_PIXELS:
            raise ValueError(f"its header declares pictures of {width}×{height}, larger than any camera's")
        first = next(shown_frames(container, film_stream(container)), None)
        if first is None:
            raise ValueError("no frame can be decoded")
        form, notes = stored_format(streams[0], first)
        if len(streams) > 1:
            sizes = ", ".join(f"{s.index} ({s.width}×{s.height})" for s in streams[1:])
            notes = (f"of its video streams number {streams[0].index} is used, and not {sizes}", *notes)
        return form, notes


@contextmanager
def film_context(path: Path) -> Iterator[None]:
    """A context in which errors of the film library become a UserError that names the film."""
    try:
        yield
    except (av.FFmpegError, IndexError, ValueError) as error:
        if lacks_thread(error):
            raise
        raise UserError(
            f"{path} cannot be read as a video ({getattr(error, 'strerror', None) or error}); it may be truncated: "
            "copy it again"
        ) from None


def timing_irregularities(times_s: Sequence[float], first: int) -> str | None:
    """A sentence about uneven times (seconds) of successive frames from ``first`` on; None if they are even."""
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
    files = source.pictures or read_film_list(source.path)
    if files == (source.path,):
        return _file_digest(source.path)
    whole = hashlib.sha256()
    for picture in files:
        whole.update(_file_digest(picture).encode())
    return whole.hexdigest()


def _open_folder(path: Path, picture_fps: float) -> FootageSource:
    pictures = pictures_in(path)
    if not pictures:
        raise UserError(f"{path} holds no pictures; put the camera's frames there ({', '.join(PICTURE_SUFFIXES)})")
    if missing := missing_numbers_text(pictures):
        raise UserError(
            f"{path} lacks the pictures {missing}, so every later frame would be at another time than in the other "
            "cameras; copy the pictures again, or number them without a gap"
        )
    first = read_image(pictures[0], cv2.IMREAD_COLOR)
    note = f"a folder of pictures has no frame rate: {picture_fps:g} per second is used (capture.picture_fps)"
    return FootageSource(
        path,
        (first.shape[1], first.shape[0]),
        picture_fps,
        len(pictures),
        len(pictures),
        pictures=tuple(pictures),
        notes=(note,),
    )


def _file_digest(path: Path) -> str:
    whole = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            whole.update(block)
    return whole.hexdigest()
