# SPDX-License-Identifier: Apache-2.0
"""``detect.people``: detects the people in the footage of one camera, at its full resolution, before any
calibration.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, MASK_PX
from studiorecon.detector.film_rotation import film_from_turned, most_changed_frames, quarter_turns, rotate_picture
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import detect_people, keypoints_with_confidence
from studiorecon.errors import UserError
from studiorecon.footage.frames import decode, seek_frames, spread_frames
from studiorecon.footage.source import open_source
from studiorecon.keypoints.resampling import used_range
from studiorecon.progress import progress, say, warn
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.raw_detections import RawDetections, write_raw_detections
from studiorecon.signature import Written

# Pictures of a film that are compared, and those of them, where most moves, that show which way is up.
_COMPARED, _SHOW_UP = 25, 3


def run(
    camera: str,
    source: Path,
    clocks: list[Path],
    picture_fps: float,
    detector: DetectorFiles,
    found: Written,
) -> None:
    """Write who is in the frames of ``source`` to ``found`` (npz): in all, or in those that ``clocks`` (a file, or
    none) chooses."""
    try:
        footage = open_source(source, picture_fps)
    except UserError as refusal:
        # Decoding will raise an error with its name; the clocks of the other cameras need not wait for that.
        warn(f"camera {camera}: {refusal}; until then it has no detections")
        write_raw_detections(
            found, RawDetections.of(camera, LAYOUT, LANDMARKS, [], (0, 0), "footage that cannot be read")
        )
        return
    start, count = used_range(read_clocks(clocks[0]), camera) if clocks else (0, 0)
    total = count or max(footage.frames - start, 0)
    moments = sorted({start + round(k * max(total - 1, 0) / (_COMPARED - 1)) for k in range(_COMPARED)})
    network, worth = detector.detector(), detector.worth()
    shown = moments
    if len(moments) > _SHOW_UP:
        shown = [moments[k] for k in most_changed_frames(spread_frames(footage, moments), _SHOW_UP)]
    turns, seen_there = quarter_turns(network, seek_frames(footage, shown))
    # Nobody is looked for twice in one picture.
    first = seen_there[0] if shown[:1] == [start] else None
    if turns:
        say(f"camera {camera}: its pictures are turned by {90 * turns}° counter-clockwise, so that people are upright")
    linear, offset = np.split(film_from_turned(footage.wh, turns), [2], axis=1)
    pictures = (rotate_picture(p, turns) for p in progress(decode(footage, start, count), f"frames of {camera}", total))
    width, height = footage.wh
    wh = (height, width) if turns % 2 else (width, height)
    rows, frames = [], 0
    for frame, seen in enumerate(detect_people(pictures, network, footage.fps, first), start):
        frames += 1
        for person in seen:
            keypoints = keypoints_with_confidence(person, wh, worth)
            keypoints[:, :2] = keypoints[:, :2] @ linear.T + offset[:, 0]
            points_m = np.column_stack([person.points_m[:, :2] @ linear.T, person.points_m[:, 2]])
            affine = person.region.crop_from_picture(MASK_PX)
            affine = np.column_stack([affine[:, :2] @ linear.T, affine[:, 2] - affine[:, :2] @ linear.T @ offset[:, 0]])
            rows.append((frame, keypoints, person.presence, points_m, person.mask, affine))
    looked = f"{network.placer.title} at {footage.wh[0]}×{footage.wh[1]}, {frames} frames at {footage.fps:g} per second"
    write_raw_detections(found, RawDetections.of(camera, LAYOUT, LANDMARKS, rows, (start, frames), looked))
    if rows:
        say(f"camera {camera}: {len(rows)} detections in {len({row[0] for row in rows})} of {frames} frames ({looked})")
    else:
        warn(f"camera {camera}: no person was detected in its {frames} frames ({looked})")
