# SPDX-License-Identifier: Apache-2.0
"""Number and times of a film's frames as a decoder shows them, whatever the header says."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.container import film_stream, film_streams, open_container
from studiorecon.machine.resource_errors import lacks_thread

if TYPE_CHECKING:
    from jaxtyping import Float

# Times in a file are rounded to its time base, a millisecond in Matroska: steps within this tolerance are even.
EVEN_S = 2e-3
# The header's rate is used if it is nearer than this share: the difference is jitter.
_RATE_SHARE = 0.02
# Number of frames decoded to check a decoder against the packets: more than open groups of pictures lead with, or
# codecs reorder.
_HEAD_FRAMES = 20
# People are never filmed at more than 1,000 frames per second (the maximum of ``capture.picture_fps``): smaller steps
# are frame counts, not times.
_MIN_STEP_S = 1e-3


@dataclass(frozen=True)
class Timing:
    """The frames that a decoder shows, up to the first of another size.

    Attributes:
        times_s: of every frame on the file's own time line, which its sound shares; strictly ascending.
        fps: frames per second; the header's where the times agree with it.
        announced: number of frames in the header, without those that an edit list hides; ``times_s`` may have fewer.
        carried: whether frames carry these times when they are decoded, so that each can be sought.
        notes: sentences about contradictions in the header.
    """

    times_s: tuple[float, ...]
    fps: float
    announced: int
    carried: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Packets:
    """The frames of a film in its file, without decoding: times in order, NaN where there are none.

    ``hidden`` counts frames that an edit list leaves out or that repeat the one before; ``whole``: none is damaged.
    """

    shown_s: Float[np.ndarray, " T"]
    decoded_s: Float[np.ndarray, " T"]
    hidden: int
    whole: bool


@dataclass(frozen=True)
class _Decoded:
    """Decoded frames: their times (T,), NaN where they have none, and the size that ended them, if one did."""

    times_s: Float[np.ndarray, " T"]
    other_wh: tuple[int, int] | None = None


def read_timing(path: Path) -> Timing:
    """The timing of the film in ``path``: from its packets if its first and last frames agree with them.

    Else it is that of the undamaged frames after decoding all of it. Raises ValueError when nothing can be decoded,
    UserError naming the file when neither its times nor its header give a rate.
    """
    with open_container(path) as container:
        stream = film_stream(container)
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        # QuickTime's index excludes frames that its edit list hides at the ends, its count includes them.
        stated = min(stream.frames, len(stream.index_entries)) if "mov" in container.format.name else stream.frames
        announced = stated or _frames_by_duration(container, rate)
    packets = _packets(path)
    times, carried, other = packets.shown_s, True, None
    whole = packets.whole and stated in (0, len(times) + packets.hidden)
    if whole and _promised(_decoded(path, most=_HEAD_FRAMES), times, _HEAD_FRAMES) and _ends(path, times):
        count, other = _of_one_size(path, times)
    else:
        decoded = _decoded(path)
        count, other = len(decoded.times_s), decoded.other_wh
        # Where decoded frames carry no times, or wrong ones (AVI with reordered frames), their packets' are as good.
        found = [t for t in (decoded.times_s, packets.shown_s, packets.decoded_s) if len(t) == count and _ascending(t)]
        carried, times = _ascending(decoded.times_s), found[0] if found else decoded.times_s
    if not count:
        raise ValueError("no frame can be decoded")
    notes = []
    announced = max(announced - packets.hidden, len(packets.shown_s), count)
    if other is not None:
        notes.append(f"from frame {count} on it is {other[0]}×{other[1]}, another size: only the part before is used")
    elif announced > count + (not stated):
        notes.append(
            f"{announced} frames are announced and {count} can be decoded: these are used, each at its own time"
        )
    regular = _repaired(times[:count])
    if regular is None and not rate:
        raise UserError(
            f"{path} has neither a frame rate nor timestamps; bring its frames as pictures in images/<camera>/, whose "
            "rate is the setting capture.picture_fps"
        )
    if regular is None:
        notes.append(f"its frames have no usable times: {rate:g} per second is used, from its header")
        return Timing(tuple((np.arange(count) / rate).tolist()), rate, announced, False, tuple(notes))
    fps = _rate(regular, rate)
    if abs(rate / fps - 1) > _RATE_SHARE:
        notes.append(f"its header has {rate:g} frames per second, its time stamps {fps:.4g}, which is used")
    carried = carried and np.array_equal(regular, times[:count])
    return Timing(tuple(regular.tolist()), fps, announced, carried, tuple(notes))


def film_frames(path: Path) -> Iterator[av.VideoFrame]:
    """All undamaged frames of the film in ``path``; none where the file no longer holds one.

    From a damaged frame on one thread decodes: with several, the frames lost with it vary by chance.
    """
    done = 0
    for threads in ("AUTO", "SLICE"):
        with open_container(path) as container:
            if not film_streams(container):
                return
            stream = film_stream(container)
            stream.thread_type = threads
            try:
                for frame in islice(shown_frames(container, stream, to_damage=threads == "AUTO"), done, None):
                    yield frame
                    done += 1
                return
            except DamagedFrameError:
                continue


class DamagedFrameError(Exception):
    """A frame could not be decoded."""


def shown_frames(
    container: av.container.InputContainer,
    stream: av.VideoStream,
    to_damage: bool = False,
    needed: Collection[int] | None = None,
) -> Iterator[av.VideoFrame]:
    """The undamaged frames from the current position of ``container``.

    ``to_damage``: raises DamagedFrameError for a damaged or lost frame, except for the first ones, whose reference is
    cut off. ``needed``: time stamps of the frames that must be among them; others that no frame refers to are skipped.
    """
    # In H.264 every frame states whether others refer to it; in HEVC it does so within its temporal layer only.
    skips = needed is not None and stream.codec_context.name == "h264"
    begun, missing = False, 0
    for packet in _readable(container, stream):
        if begun and to_damage and packet.is_corrupt:
            raise DamagedFrameError
        if skips and needed is not None:
            stream.codec_context.skip_frame = "DEFAULT" if packet.pts in needed else "NONREF"
        else:
            missing += bool(packet.size) and not packet.is_discard
        try:
            frames = packet.decode()
        except av.FFmpegError as error:
            if lacks_thread(error):
                raise
            if begun and to_damage:
                raise DamagedFrameError from None
            continue
        for frame in frames:
            assert isinstance(frame, av.VideoFrame)
            if not frame.is_corrupt:
                begun = True
                yield frame
            elif begun and to_damage:
                raise DamagedFrameError
        missing -= len(frames)
    if begun and to_damage and missing > 0:
        raise DamagedFrameError


def _readable(container: av.container.InputContainer, stream: av.VideoStream) -> Iterator[av.Packet[av.VideoStream]]:
    """The packets up to the first place where the container itself is damaged."""
    try:
        yield from container.demux(stream)
    except av.FFmpegError as error:
        if lacks_thread(error):
            raise


def _frames_by_duration(container: av.container.InputContainer, rate: float) -> int:
    """Number of frames by the container's duration (of its longest stream) and ``rate``; 0 where unknown."""
    if len(container.streams) > 1 or container.duration is None:
        return 0
    return round((container.duration - (container.start_time or 0)) / av.time_base * rate)


def _packets(path: Path) -> _Packets:
    shown: list[float] = []
    decoded: list[float] = []
    hidden, whole = 0, True
    try:
        with open_container(path) as container:
            stream = film_stream(container)
            base = stream.time_base
            for packet in container.demux(stream):
                whole = whole and not packet.is_corrupt
                if packet.size and not packet.is_discard:
                    shown.append(_time_s(packet.pts, base))
                    decoded.append(_time_s(packet.dts, base))
                else:  # the last packet only marks the end
                    hidden += bool(packet.size) or packet.dts is not None
    except av.FFmpegError as error:
        if lacks_thread(error):
            raise
        whole = False
    ordered, order = np.sort(np.array(shown, dtype=np.float64)), np.array(decoded, dtype=np.float64)
    # Raw streams and some containers only store presentation times.
    known = order[np.isfinite(order)]
    return _Packets(ordered, order, hidden, whole and _ascending(ordered) and bool((np.diff(known) > 0).all()))


def _decoded(path: Path, most: int | None = None) -> _Decoded:
    """The first ``most`` undamaged frames (None: all), of one size."""
    return _timed(islice(film_frames(path), most))


def _timed(frames: Iterator[av.VideoFrame]) -> _Decoded:
    times: list[float] = []
    wh = None
    for frame in frames:
        wh = wh or (frame.width, frame.height)
        if (frame.width, frame.height) != wh:
            return _Decoded(np.array(times, dtype=np.float64), (frame.width, frame.height))
        times.append(_time_s(frame.pts, frame.time_base))
    return _Decoded(np.array(times, dtype=np.float64))


def _promised(head: _Decoded, times_s: np.ndarray, most: int) -> bool:
    return head.other_wh is None and np.array_equal(head.times_s, times_s[:most])


def _ends(path: Path, times_s: np.ndarray) -> bool:
    """Whether decoding from the last key frame on ends as the packets state."""
    with open_container(path) as container:
        stream = film_stream(container)
        needed: set[int] | None = None
        if (base := stream.time_base) is not None:
            container.seek(int(times_s[-1] / base), stream=stream, backward=True)
            needed = {round(time_s / base) for time_s in times_s[-_HEAD_FRAMES:].tolist()}
        tail = _timed(shown_frames(container, stream, needed=needed)).times_s[-_HEAD_FRAMES:]
    return len(tail) > 0 and np.array_equal(tail, times_s[-len(tail) :])


def _of_one_size(path: Path, times_s: np.ndarray) -> tuple[int, tuple[int, int] | None]:
    """How many frames have the size of the first one, and the size of the next one, if there is one.

    A film changes its size at key frames only, and rarely back: where the last one's differs, they are bisected.
    """
    with open_container(path) as container:
        stream = film_stream(container)
        assert stream.time_base is not None
        first = next(shown_frames(container, stream))
        wh, found = (first.width, first.height), None
        same, other, looked = 0, len(times_s), len(times_s) - 1
        while other - same > 1:
            container.seek(int(times_s[looked] / stream.time_base), stream=stream, backward=True)
            frame = next(shown_frames(container, stream), None)
            if frame is None or (found is None and (frame.width, frame.height) == wh):
                return len(times_s), None
            if (frame.width, frame.height) == wh:
                same = looked
            else:
                found = frame.width, frame.height
                other = min(int(np.searchsorted(times_s, _time_s(frame.pts, frame.time_base) - 1e-6)), looked)
            looked = (same + other) // 2
        return other, found


def _time_s(stamp: int | None, time_base: Fraction | None) -> float:
    # As float(stamp * time_base), without making a fraction per frame.
    return np.nan if stamp is None or time_base is None else stamp * time_base.numerator / time_base.denominator


def _ascending(times_s: np.ndarray) -> bool:
    return bool(np.isfinite(times_s).all() and (np.diff(times_s) > 0).all())


def _repaired(times_s: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"] | None:
    """The times, with missing or repeated ones interpolated; None where most are, or steps are too small."""
    highest = np.maximum.accumulate(np.nan_to_num(times_s, nan=-np.inf))
    good = np.isfinite(times_s) & np.concatenate([[True], highest[1:] > highest[:-1]])
    if 2 * good.sum() < len(times_s) or not (good[0] and good[-1]):
        return None
    repaired = np.interp(np.arange(len(times_s)), np.flatnonzero(good), times_s[good])
    return repaired if len(repaired) < 2 or np.median(np.diff(repaired)) >= _MIN_STEP_S else None


def _rate(times_s: Float[np.ndarray, " T"], header: float) -> float:
    """Frames per second: the header's where it roughly agrees, else that of even steps, else of the median one."""
    own, count = times_s - times_s[0], np.arange(len(times_s))
    if len(own) < 2 or (header and np.abs(own - count / header).max() <= EVEN_S):
        return header or 1.0
    slope = float(np.polyfit(count, own, 1)[0])
    if np.abs(own - slope * count).max() <= EVEN_S:
        return 1 / slope
    usual = float(1 / np.median(np.diff(own)))
    return header if header and abs(header / usual - 1) < _RATE_SHARE else usual
