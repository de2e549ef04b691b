# SPDX-License-Identifier: Apache-2.0
"""``tracks.keypoints``: recorded 2D keypoints of one camera → undistorted working pixels, followed through time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.camera_files.calibration import lens_of
from studiorecon.errors import UserError
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.keypoints.reading import Settings, detections_of, detections_of_found
from studiorecon.keypoints.retiming import at_the_scene_s_moments, part_used
from studiorecon.progress import say
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.raw_detections import is_found, read_raw_detections
from studiorecon.signature import Written


def run(
    settings: Settings,
    camera: str,
    keypoints: Path,
    layout: str,
    first_frame: int,
    footage: Path,
    calibration: Path,
    detections: Written,
    clocks: Path | None = None,
) -> None:
    """Read the ``keypoints`` of ``camera``, recorded (numbered from ``first_frame`` on) or the detector's; write
    ``detections`` (npz).

    ``clocks`` say which picture shows which of the scene's moments; without them one after the other, as the footage
    was used.
    """
    used = read_footage(footage)
    common = read_clocks(clocks) if clocks else None
    found = part_used(used, common)
    lens = lens_of(calibration, camera)
    if is_found(keypoints):
        whole = read_raw_detections(keypoints)
        result = at_the_scene_s_moments(detections_of_found(whole, lens, found, settings), used, common)
        _tell(result, whole.note, used)
        write_detections(detections, result)
        return
    entries, kind = read_keypoints(keypoints, used.source_wh)
    if not entries:
        say(f"{keypoints} ({kind}) holds no person: camera {camera} sees nobody")
        chosen = "body_25" if layout == "auto" else layout
    else:
        chosen, note = choose_layout(np.stack([e.keypoints for e in entries]), layout, str(keypoints))
        if note:
            say(note)
    result = at_the_scene_s_moments(detections_of(entries, chosen, lens, found, first_frame, settings), used, common)
    if entries and not len(result.frame):
        numbers = sorted({e.frame for e in entries})
        raise UserError(
            f"{keypoints}: no detection falls into the {found.frames} working frames of "
            f"camera {camera} (files are numbered "
            f"{numbers[0]} to {numbers[-1]}); write the number of the video's first frame into capture.yaml as "
            "keypoint_first_frame"
        )
    _tell(result, kind, used)
    write_detections(detections, result)


def _tell(result: Detections, kind: str, footage: Footage) -> None:
    seen = len(np.unique(result.frame))
    say(
        f"camera {footage.camera}: {len(result.frame)} detections ({kind}, "
        f"{result.layout}) in {seen} of {footage.frames} frames, "
        f"{len(np.unique(result.track))} tracks"
    )
