# SPDX-License-Identifier: Apache-2.0
"""Which cameras show people at all: people say nothing of where the others stand, which serve the room all the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.scene.people import Detections

# What a detector sees in furniture lasts for some frames. It is no witness of where a camera stands when it is seen for
# less than this, and in less than such a share of the frames in which the camera that shows most of people does.
_LONG_S, _HARDLY = 1.0, 0.2


def active_cameras(detections: Sequence[Detections], fps: float) -> list[int]:
    """Indices of the cameras that show people for more than some frames; ``fps`` 0: nobody knows how long these are."""
    frames = _frames(detections)
    least = _HARDLY * max(frames, default=0)
    return [v for v, count in enumerate(frames) if count and count >= (min(least, _LONG_S * fps) if fps else least)]


def inactive_camera_notes(detections: Sequence[Detections], fps: float) -> dict[str, str]:
    """Camera → one sentence about it, for every one that shows nobody, or hardly anybody, where another does."""
    frames, watched = _frames(detections), active_cameras(detections, fps)
    if not watched:
        return {}
    sighted = ", ".join(detections[v].camera for v in watched)
    return {
        d.camera: f"camera {d.camera} sees "
        + (f"somebody in {count} frames only" if count else "nobody")
        + f": it only shows the room, from the pose it was given, which people cannot check, and who is who comes from "
        f"{sighted}; if somebody is in its picture, bring keypoints of another detector"
        for v, (d, count) in enumerate(zip(detections, frames))
        if v not in watched
    }


def _frames(detections: Sequence[Detections]) -> list[int]:
    """In how many frames every camera shows somebody."""
    return [len(np.unique(d.frame)) for d in detections]
