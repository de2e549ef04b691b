# SPDX-License-Identifier: Apache-2.0
"""``detect.moments``: detects the people in some stretches of one camera's footage, at its full resolution, before
any calibration: as many as show people long enough to check cameras and clocks on them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from pathlib import Path

from studiorecon.detector.blazepose import LANDMARKS, LAYOUT
from studiorecon.detector.film_detection import FilmDetector
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.errors import UserError
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.progress import progress, say, warn
from studiorecon.scene.moments import read_moments, unseen
from studiorecon.scene.raw_detections import RawDetections, write_raw_detections
from studiorecon.signature import Written

# Stretches that are searched in any case: the start, the middle and the end of a take.
_MIN_STRETCHES = 3
# Detections after which no more stretches are searched: one person for three seconds at 30 per second. Clocks and
# calibrations are judged on 24 frames.
_ENOUGH = 100


def run(camera: str, source: Path, moments: Path, picture_fps: float, detector: DetectorFiles, found: Written) -> None:
    """Write who is in the first of the stretches ``moments`` of ``source`` to ``found`` (npz)."""
    try:
        footage = open_source(source, picture_fps)
    except UserError as refusal:
        # Decoding will raise an error with its name; the clocks of the other cameras need not wait for that.
        warn(f"camera {camera}: {refusal}; until then it has no detections")
        write_raw_detections(found, RawDetections.of(camera, LAYOUT, LANDMARKS, [], [], "footage that cannot be read"))
        return
    wanted = read_moments(moments, camera)
    film = FilmDetector(detector.detector(), detector.worth(), footage, 0)
    film = film.turned([(first, count) for number, first, count in wanted if number < _MIN_STRETCHES])
    if film.turns:
        say(
            f"camera {camera}: its pictures are turned by {90 * film.turns}° counter-clockwise, so that people are "
            "upright"
        )
    rows: list[tuple] = []
    looked: list[tuple[int, int]] = []
    for number, parts in groupby(wanted, lambda part: part[0]):
        if number >= _MIN_STRETCHES and len(rows) >= _ENOUGH:
            break
        for first, count in [new for _, *part in parts for new in unseen(looked, *part)]:
            pictures = progress(decode(footage, first, count), f"frames of {camera}", count)
            rows += film.rows(pictures, first)
            looked.append((first, count))
    total = sum(count for _, count in looked)
    title = (
        f"{film.network.placer.title} at {footage.wh[0]}×{footage.wh[1]}, {total} frames at {footage.fps:g} per second"
    )
    nobody = RawDetections.of(camera, LAYOUT, LANDMARKS, [], [], title)
    write_raw_detections(found, replace(nobody, turns=film.turns).completed(rows, looked))
    if rows:
        say(f"camera {camera}: {len(rows)} detections in {len({row[0] for row in rows})} of {total} frames ({title})")
    else:
        warn(f"camera {camera}: no person was detected in {total} of its {footage.frames} frames ({title})")
