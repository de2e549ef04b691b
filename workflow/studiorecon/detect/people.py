# SPDX-License-Identifier: Apache-2.0
"""``detect.people``: detects the people in the footage of one camera, at its full resolution, before any
calibration.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, MASK_PX, BlazePose
from studiorecon.detector.film_rotation import film_from_turned, quarter_turns, rotate_picture
from studiorecon.detector.following import detect_people, is_short_clip, keypoints_with_confidence
from studiorecon.detector.second_network import second_network
from studiorecon.detector.windows import small, usual
from studiorecon.errors import UserError
from studiorecon.footage.frames import decode, glimpses, stills
from studiorecon.footage.source import open_source
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import to_bytes
from studiorecon.keypoints.resampling import used_range
from studiorecon.progress import progress, say, warn
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.files import read_json
from studiorecon.scene.raw_detections import RawDetections, write_raw_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Integer

# Number of pictures whose median is the background, and number of those with most motion that determine the upright
# direction.
_USUAL, _SHOW_UP = 25, 3


def run(
    camera: str,
    source: Path,
    clocks: list[Path],
    picture_fps: float,
    plate: list[Path],
    networks: list[Path],
    second: list[Path],
    layout: str,
    found: Written,
) -> None:
    """Write the people in the frames of ``source`` to ``found`` (npz): in all frames, or in those that ``clocks``
    selects.

    ``clocks`` is a file or none. Pixels that differ from the user's own clean ``plate`` (a picture, or none) are
    searched more closely. ``networks``: the detector's file, the landmarks', and the table of the confidence by their
    visibility; ``second``: the user's own network, or none, and ``layout``: of its points.
    """
    detection, landmarks, table = networks
    try:
        footage = open_source(source, picture_fps)
    except UserError as refusal:
        # Decoding will raise an error with its name; the clocks of the other cameras need not wait for that.
        warn(f"camera {camera}: {refusal}; until then it sees nobody")
        write_raw_detections(
            found, RawDetections.of(camera, LAYOUT, LANDMARKS, [], (0, 0), "footage that cannot be read")
        )
        return
    start, count = used_range(read_clocks(clocks[0]), camera) if clocks else (0, 0)
    total = count or max(footage.frames - start, 0)
    sampling = sorted({start + round(k * max(total - 1, 0) / (_USUAL - 1)) for k in range(_USUAL)})
    glances = [small(picture) for picture in stills(footage, sampling)]
    own = second_network(second, layout)
    network = BlazePose(detection, landmarks, own)
    worth = read_json(table)
    backgrounds = [usual(glances)] if len(glances) > 2 else []
    backgrounds += [room for path in plate for room in _empty_room(path, footage.wh)]
    room = usual(glances).astype(float)
    busiest = np.argsort([-np.abs(glance - room).mean() for glance in glances], kind="stable")[:_SHOW_UP]
    turns = quarter_turns(network, glimpses(footage, sorted(sampling[k] for k in busiest)))
    if turns:
        say(f"camera {camera}: people are upright once its pictures are turned by {90 * turns}° counter-clockwise")
    linear, offset = np.split(film_from_turned(footage.wh, turns), [2], axis=1)
    pictures = (rotate_picture(p, turns) for p in progress(decode(footage, start, count), f"frames of {camera}", total))
    backgrounds = [rotate_picture(background, turns) for background in backgrounds]
    width, height = footage.wh
    wh = (height, width) if turns % 2 else (width, height)
    few = is_short_clip(total, footage.fps)
    rows, frames = [], 0
    for frame, seen in enumerate(detect_people(pictures, network, backgrounds, footage.fps, few), start):
        frames += 1
        for person in seen:
            keypoints = keypoints_with_confidence(person, wh, worth)
            keypoints[:, :2] = keypoints[:, :2] @ linear.T + offset[:, 0]
            points_m = np.column_stack([person.points_m[:, :2] @ linear.T, person.points_m[:, 2]])
            affine = person.region.crop_from_picture(MASK_PX)
            affine = np.column_stack([affine[:, :2] @ linear.T, affine[:, 2] - affine[:, :2] @ linear.T @ offset[:, 0]])
            rows.append((frame, keypoints, person.presence, points_m, person.mask, affine))
    with_what = f"{landmarks.stem} and {own.note} ({own.layout})" if own else landmarks.stem
    looked = f"{with_what} at {footage.wh[0]}×{footage.wh[1]}, {frames} frames at {footage.fps:g} per second"
    write_raw_detections(found, RawDetections.of(camera, LAYOUT, LANDMARKS, rows, (start, frames), looked))
    if rows:
        say(f"camera {camera}: {len(rows)} detections in {len({row[0] for row in rows})} of {frames} frames ({looked})")
    else:
        warn(f"camera {camera}: nobody was found in any of its {frames} frames ({looked})")


def _empty_room(plate: Path, wh: tuple[int, int]) -> list[Integer[np.ndarray, "h w 3"]]:
    """The user's clean plate at the size for comparison with films.

    None where its shape is another, because it has the calibration's pixels.
    """
    width, height = wh
    room = to_bytes(read_plate(plate)[0])
    if abs(room.shape[1] * height - room.shape[0] * width) > width:
        say(f"{plate} has another shape than the film ({width}×{height}): people are not looked for against it")
        return []
    return [small(cv2.resize(room, wh, interpolation=cv2.INTER_AREA))]
