# SPDX-License-Identifier: Apache-2.0
"""``detect.people``: detects the people in the rest of one camera's footage, beside the moments that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from studiorecon.detector.film_detection import FilmDetector
from studiorecon.detector.film_search import Search
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.keypoints.resampling import used_range
from studiorecon.progress import progress, say
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.raw_detections import read_raw_detections, unseen, write_raw_detections
from studiorecon.signature import Written


def run(
    camera: str,
    source: Path,
    known: list[Path],
    clocks: list[Path],
    picture_fps: float,
    detector: DetectorFiles,
    found: Written,
) -> None:
    """Write who is in the frames of ``source`` to ``found`` (npz): in all, or in those that ``clocks`` (a file, or
    none) chooses. ``known``: what ``clocks.moments`` found (a file, or none), which is kept."""
    footage = open_source(source, picture_fps)
    first, count = used_range(read_clocks(clocks[0]), camera) if clocks else (0, footage.frames)
    network, worth = detector.detector(), detector.worth()
    begun = Search.of(camera, footage, network, worth).found
    before = read_raw_detections(known[0], masks=True) if known else begun
    rows, rest = list[tuple](), unseen(before.looked, first, count)
    if rest:
        film = FilmDetector(network, worth, footage, before.turns)
        film = film if known else film.turned(rest)
        before, rows = replace(before, turns=film.turns), _rows(film, rest)
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
