# SPDX-License-Identifier: Apache-2.0
"""The lens's focal length in a file's metadata, as phones and cameras write it.

QuickTime: the key ``com.apple.quicktime.camera.focal_length.35mm_equivalent`` among the film's or the picture track's
metadata (Apple, QuickTime File Format, Metadata: atoms ``keys`` and ``ilst``). Photos: EXIF 2.32's tag
``FocalLengthIn35mmFilm``. Both mean the focal length at which 35 mm film, 36 by 24 mm, shows the same diagonal.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np

from studiorecon.footage.container import open_container, read_film_list

_KEY = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
_FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))
# Outside of these no lens films people: a tag that was left at 0, or in another unit.
_SHORTEST_MM, _LONGEST_MM = 8.0, 600.0
_HOLDERS = (b"moov", b"trak")
# EXIF: the pointer to the picture's own tags, and the tag.
_EXIF_TAGS, _FOCAL_IN_35MM = 0x8769, 0xA405
# A larger index belongs to no film of this project's length.
_MAX_BYTES = 1 << 28


def focal_px_from_metadata(path: Path, wh: tuple[int, int]) -> float | None:
    """Focal length in pixels of footage of size ``wh`` from the file's metadata; None without it.

    An initial value: it is the lens's nominal length, and a phone's stabilisation crops up to a tenth of the picture.
    """
    path = read_film_list(path)[0]
    film_mm = _of_photo(path) if path.suffix.lower() in (".jpg", ".jpeg", ".png", ".webp", ".tif") else _of_film(path)
    if film_mm is None or not _SHORTEST_MM <= film_mm <= _LONGEST_MM:
        return None
    return film_mm * float(np.hypot(*wh)) / _FILM_DIAGONAL_MM


def _of_film(path: Path) -> float | None:
    try:
        with open_container(path) as container:
            tags = dict(container.metadata)
            for stream in container.streams.video:
                tags |= dict(stream.metadata)
    except (av.FFmpegError, OSError):
        return None
    return _number(tags.get(_KEY) or _track_tag(path))


def _number(text: str | None) -> float | None:
    """The number in forms such as 27, 27.0 and 50.00mm; None for other text."""
    found = re.match(r"\s*(\d+(?:\.\d+)?)", text or "")
    return float(found.group(1)) if found else None


def _track_tag(path: Path) -> str | None:
    """The key's value in the metadata of any track, which the demuxer does not pass on."""
    with path.open("rb") as file:
        head = file.read(16)
        if head[4:8] not in (b"ftyp", b"moov", b"wide", b"mdat", b"free", b"skip"):
            return None
        file.seek(0)
        while len(head := file.read(16)) >= 8:
            size, kind, skipped = *struct.unpack(">I4s", head[:8]), 8
            if size == 1 and len(head) == 16:
                size, skipped = struct.unpack(">Q", head[8:])[0], 16
            if kind == b"moov" and skipped <= size <= _MAX_BYTES:
                file.seek(skipped - len(head), 1)
                return _value_in(file.read(size - skipped))
            if size < skipped:
                return None
            file.seek(size - len(head), 1)
    return None


def _atoms(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        if size < 8:
            return
        yield kind, data[at + 8 : at + size]
        at += size


def _value_in(data: bytes) -> str | None:
    for kind, inner in _atoms(data):
        if kind in _HOLDERS and (found := _value_in(inner)):
            return found
        if kind == b"meta" and (found := _tag_value(dict(_atoms(inner)))):
            return found
    return None


def _tag_value(meta: dict[bytes, bytes]) -> str | None:
    """The value of the key: ``keys`` lists names from 1 on; an atom of ``ilst`` is named by such a number."""
    names = [value for _, value in _atoms(meta.get(b"keys", b"")[8:])]
    if _KEY.encode() not in names:
        return None
    wanted = struct.pack(">I", names.index(_KEY.encode()) + 1)
    for kind, inner in _atoms(meta.get(b"ilst", b"")):
        if kind == wanted:
            return next((v[8:].decode("utf-8", "replace") for k, v in _atoms(inner) if k == b"data"), None)
    return None


def _of_photo(path: Path) -> float | None:
    try:
        _, kinds, blocks = cv2.imreadWithMetadata(str(path), cv2.IMREAD_REDUCED_COLOR_8)
    except cv2.error:
        return None
    for kind, block in zip(kinds if kinds is not None else (), blocks if blocks is not None else ()):
        if kind == cv2.IMAGE_METADATA_EXIF:
            return _in_exif(bytes(np.asarray(block, dtype=np.uint8).ravel()))
    return None


def _in_exif(block: bytes) -> float | None:
    """The value of the tag in a TIFF block (TIFF 6.0: byte order, then directories of entries of twelve bytes)."""
    block = block[6:] if block.startswith(b"Exif\0\0") else block
    order = {b"II": "<", b"MM": ">"}.get(block[:2])
    if order is None or len(block) < 8:
        return None
    first = _directory(block, order, struct.unpack(order + "I", block[4:8])[0])
    inner = _directory(block, order, first[_EXIF_TAGS][1]) if _EXIF_TAGS in first else {}
    return float(inner[_FOCAL_IN_35MM][0]) if _FOCAL_IN_35MM in inner else None


def _directory(block: bytes, order: str, at: int) -> dict[int, tuple[int, int]]:
    """Tag → its value as a short, and as a long."""
    if at + 2 > len(block):
        return {}
    (count,) = struct.unpack(order + "H", block[at : at + 2])
    entries = [block[at + 2 + 12 * k : at + 14 + 12 * k] for k in range(count)]
    return {
        struct.unpack(order + "H", e[:2])[0]: (
            struct.unpack(order + "H", e[8:10])[0],
            struct.unpack(order + "I", e[8:12])[0],
        )
        for e in entries
        if len(e) == 12
    }
