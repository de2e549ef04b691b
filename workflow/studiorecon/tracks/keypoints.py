# SPDX-License-Identifier: Apache-2.0
"""``tracks.keypoints``: converts recorded 2D keypoints of one camera to undistorted working pixels, tracked
over time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.camera_files.calibration import find_lens
from studiorecon.errors import UserError
from studiorecon.keypoints.detections import Settings, detections_from_detector, detections_from_recorded
from studiorecon.keypoints.hands import with_recorded_hands
from studiorecon.keypoints.resampling import at_working_frames, part_used
from studiorecon.progress import say, warn
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.raw_detections import is_detector_file, read_raw_detections
from studiorecon.scene.recorded_keypoints import read_recorded
from studiorecon.signature import Written


def run(
    settings: Settings,
    camera: str,
    keypoints: Path,
    footage: Path,
    calibration: Path,
    detections: Written,
    clocks: Path | None = None,
) -> None:
    """Write ``detections`` (npz) from the ``keypoints`` of ``camera``: those of ``detect.keypoints`` or the detector's.

    ``clocks`` assign pictures to the scene's moments; without them all pictures count in order. Raises UserError when
    recorded keypoints do not fit the film.
    """
    used = read_footage(footage)
    common = read_clocks(clocks) if clocks else None
    part = part_used(used, common)
    lens = find_lens(calibration, camera)
    if is_detector_file(keypoints):
        whole = read_raw_detections(keypoints)
        found, kind = detections_from_detector(whole, lens, part, settings), whole.note
    else:
        recorded = read_recorded(keypoints)
        if recorded.refusal:
            raise UserError(recorded.refusal)
        found, kind = detections_from_recorded(recorded, lens, part, settings), recorded.program
        if len(recorded.frame) and not len(found.frame):
            warn(
                f"camera {camera}: its {len(recorded.frame)} recorded people, in frames {recorded.frame[0]} to "
                f"{recorded.frame[-1]} of its film, are outside the frames in use; it only shows the room"
            )
    result = with_recorded_hands(at_working_frames(found, used, common))
    _log_detections(result, kind, used)
    write_detections(detections, result)


def _log_detections(result: Detections, kind: str, footage: Footage) -> None:
    seen = len(np.unique(result.frame))
    say(
        f"camera {footage.camera}: {len(result.frame)} detections ({kind}, "
        f"{result.layout}) in {seen} of {footage.frames} frames, "
        f"{len(np.unique(result.track))} tracks"
    )
