# SPDX-License-Identifier: Apache-2.0
"""Joins the files of one recording as one film: a list in FFmpeg's concat format."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.scene.files import write_text


def write_chapters(path: Path, films: Sequence[Path]) -> tuple[int, ...]:
    """Number of frames of each of ``films``, whose list is written to ``path``.

    Every chapter begins one frame time after the last picture of the one before, whatever the length of its sound.
    Raises UserError naming the film that cannot be read, or whose size, rate or rotation is not that of the first.
    """
    sources = [open_source(film, 0.0) for film in films]
    lines, counts = ["ffconcat version 1.0"], []
    for source in sources:
        _check_like(source, sources[0])
        times_s = source.times_s
        counts.append(source.frames)
        film = source.path if source.path.is_absolute() else Path(os.path.relpath(source.path, path.parent))
        quoted = str(film).replace("'", "'\\''")
        lines += [f"file '{quoted}'", f"duration {times_s[-1] - times_s[0] + 1 / source.fps:.6f}"]
    write_text(path, "\n".join(lines) + "\n")
    return tuple(counts)


def _check_like(source: FootageSource, first: FootageSource) -> None:
    for what in ("wh", "rotation_deg"):
        one, two = getattr(first, what), getattr(source, what)
        if one != two:
            raise UserError(
                f"{first.path} and {source.path} are named as chapters of one recording, and their pictures differ "
                f"({what} {one} and {two}); rename the film that is not a chapter, or name its camera in "
                "capture.yaml: chapters"
            )
    if abs(source.fps - first.fps) > 0.01 * first.fps:
        raise UserError(
            f"{first.path} and {source.path} are named as chapters of one recording, and have {first.fps:g} and "
            f"{source.fps:g} frames per second; rename the film that is not a chapter"
        )
