# SPDX-License-Identifier: Apache-2.0
"""``detect.chapters``: lists the files of one recording as one film, for a camera that splits its recording."""

from __future__ import annotations

from pathlib import Path

from studiorecon.footage.chapters import write_chapters
from studiorecon.progress import say
from studiorecon.signature import Written


def run(camera: str, films: list[Path], joined: Written) -> None:
    """Write to ``joined`` the list of ``films``, the chapters of ``camera`` in their order."""
    counts = write_chapters(joined, films)
    listed = ", ".join(f"{film.name} ({count} frames)" for film, count in zip(films, counts, strict=True))
    say(f"camera {camera}: {len(films)} chapters are one film: {listed}")
