# SPDX-License-Identifier: Apache-2.0
"""Opens a film's container with any PyAV version and tag encoding, and selects the video stream that is the film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
from av.codec.codec import Properties
from av.stream import Disposition

from studiorecon.scene.user_files import read_text

# Until PyAV 19 a tag that is not UTF-8 makes opening fail without this argument; from 19 on such bytes become lone
# surrogates, and the argument is gone.
_TAGS: dict[str, Any] = {} if int(av.__version__.partition(".")[0]) >= 19 else {"metadata_errors": "replace"}
_COVERS = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image

CHAPTERS = ".ffconcat"
"""Suffix of a list of films that are one recording (``chapters``)."""


def open_container(path: Path | str) -> av.container.InputContainer:
    """The container at ``path``, for use in a ``with``; raises av.FFmpegError when it is none."""
    if Path(path).suffix == CHAPTERS:
        # safe: its films are in other folders, and the list is our own.
        return av.open(str(path), "r", format="concat", options={"safe": "0"}, **_TAGS)
    return av.open(str(path), "r", **_TAGS)


def read_film_list(path: Path) -> tuple[Path, ...]:
    """The films of the list at ``path``; of any other path the path alone. Raises UserError for an unreadable list."""
    return tuple(film for film, _ in read_parts(path))


def read_parts(path: Path) -> tuple[tuple[Path, float], ...]:
    """(film, seconds) of the list at ``path``; the path alone with 0 where it is none. Raises UserError if
    unreadable."""
    if path.suffix != CHAPTERS:
        return ((path, 0.0),)
    lines = read_text(path).split("\n")
    quoted = [line.removeprefix("file '").removesuffix("'") for line in lines if line.startswith("file '")]
    lasting = [float(line.removeprefix("duration ")) for line in lines if line.startswith("duration ")]
    return tuple((path.parent / film.replace("'\\''", "'"), s) for film, s in zip(quoted, lasting, strict=True))


def film_streams(container: av.container.InputContainer) -> list[av.VideoStream]:
    """The video streams with a decoder, the film first: more than one picture, then the largest; no cover pictures."""
    found = [s for s in container.streams.video if s.codec_context is not None and not s.disposition & _COVERS]
    return sorted(found, key=lambda s: (s.frames != 1, s.width * s.height), reverse=True)


def film_stream(container: av.container.InputContainer) -> av.VideoStream:
    """The film stream of a container that has one, decoded by several threads; raises IndexError when it has none."""
    stream = film_streams(container)[0]
    stream.thread_type = "AUTO"
    return stream


def is_lossless(film: Path) -> bool:
    """Whether a film is stored losslessly."""
    try:
        with open_container(film) as container:
            context = film_stream(container).codec_context
    except (av.FFmpegError, IndexError):
        return False
    # H.264 can be both: our lossless films are H.264 of RGB, watchable films are YUV.
    kinds: list[Any] = [context.codec.properties, Properties.LOSSLESS, Properties.LOSSY]
    has, lossless, lossy = (int(getattr(kind, "value", kind)) for kind in kinds)
    always = bool(has & lossless) and not has & lossy
    return always or (context.format is not None and context.format.is_rgb)
