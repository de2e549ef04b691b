# SPDX-License-Identifier: Apache-2.0
"""Decides which files are films by the container library; no other module lists suffixes."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import av
from av.format import ContainerFormat

from studiorecon.footage.container import film_streams, open_container

# The library's names of the containers of recorded films, with their suffixes. Its other ones hold single pictures,
# text, sound, or pictures without a size.
_CONTAINERS = frozenset(
    {
        "mov",
        "mp4",
        "m4a",
        "3gp",
        "3g2",
        "mj2",
        "ismv",
        "f4v",
        "psp",
        "ipod",
        "matroska",
        "webm",
        "avi",
        "mpegts",
        "mpeg",
    }
    | {"mpegvideo", "mpeg1video", "mpeg2video", "dvd", "vob", "svcd", "asf", "mxf", "flv", "ogv", "ogg", "dv", "gxf"}
    | {"nut", "rm", "wtv", "ivf", "dhav", "h264", "hevc", "m4v", "mjpeg", "yuv4mpegpipe"}
)
# Suffixes of theirs that are for sound.
_SOUND = frozenset({".m4a", ".m4b", ".isma", ".wma", ".ogg", ".ra"})
# Incomplete downloads.
_UNFINISHED = frozenset({".part", ".crdownload", ".tmp", ".download"})


def is_film(path: Path) -> bool:
    """Whether a file is a film: by its suffix, so that a damaged one is reported, else by its content."""
    if path.suffix.lower() in film_suffixes():
        return True
    # Files of /proc have no bytes, and opening some of them never returns.
    if path.suffix.lower() in _SOUND | _UNFINISHED or not path.is_file() or not path.stat().st_size:
        return False
    try:
        with open_container(path) as container:
            return not _CONTAINERS.isdisjoint(container.format.name.split(",")) and bool(film_streams(container))
    except (av.FFmpegError, OSError, ValueError):
        return False


@cache
def film_suffixes() -> frozenset[str]:
    """Lower-case suffixes of films, such as ``.mp4``: those of writers, because readers claim pictures' too."""
    writers = (ContainerFormat(name, "w") for name in _CONTAINERS & av.formats_available if _is_written(name))
    return frozenset(f".{suffix}" for writer in writers for suffix in writer.extensions) - _SOUND


def _is_written(name: str) -> bool:
    try:
        return ContainerFormat(name, "w").is_output
    except ValueError:
        return False
