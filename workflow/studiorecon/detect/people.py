# SPDX-License-Identifier: Apache-2.0
"""``detect.people``: detects the people in the rest of one camera's footage, beside the moments that are known."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from studiorecon.detector.film_detection import FilmDetector
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.keypoints.resampling import used_range
from studiorecon.progress import progress, say
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.moments import unseen
from studiorecon.scene.raw_detections import read_raw_detections, write_raw_detections
from studiorecon.signature import Written


def run(
    camera: str,
    source: Path,
    known: Path,
    clocks: list[Path],
    picture_fps: float,
    detector: DetectorFiles,
    found: Written,
) -> None:
    """Write who is in the frames of ``source`` to ``found`` (npz): in all, or in those that ``clocks`` (a file, or
    none) chooses. ``known``: the result of ``detect.moments``, which is kept."""
    before = read_raw_detections(known, masks=True)
    if not before.looked:  # the film cannot be read
        write_raw_detections(found, before)
        return
    footage = open_source(source, picture_fps)
    first, count = used_range(read_clocks(clocks[0]), camera) if clocks else (0, footage.frames)
    rows, rest = list[tuple](), unseen(before.looked, first, count)
    if rest:
        rows = _rows(FilmDetector(detector.detector(), detector.worth(), footage, before.turns), rest)
    write_raw_detections(found, before.completed(rows, [*before.looked, *rest]))
    searched = sum(length for _, length in rest)
    say(f"camera {camera}: {len(rows)} more detections in the {searched} frames that were not searched before")


def _rows(film: FilmDetector, rest: Sequence[tuple[int, int]]) -> list[tuple]:
    """Who is in the stretches ``rest``; people are followed from the frame before each and back from the one after."""
    rows, at = list[tuple](), max(rest[0][0] - 1, 0)
    stop = min(sum(rest[-1]) + 1, film.footage.frames)
    pictures = progress(decode(film.footage, at, stop - at), f"frames of {film.footage.path.name}", stop - at)
    for first, count in rest:
        begin, end = max(first - 1, at), min(first + count + 1, stop)
        own = islice(islice(pictures, begin - at, None), end - begin)
        rows += [row for row in film.rows(own, begin) if first <= row[0] < first + count]
        at = end
    return rows
