# SPDX-License-Identifier: Apache-2.0
"""Selects the cameras that see people; the others' poses are not estimated, but they show the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer

# False detections in furniture last for some frames. They are no evidence of a camera's pose if they last less than
# this, and for less than such a share of the frames in which the camera that shows most of people does.
_LONG_S, _HARDLY = 1.0, 0.2


def shared_frames(detections: Sequence[Detections], wanted: int) -> Integer[np.ndarray, " F"]:
    """At most ``wanted`` frames, evenly spread over those in which two cameras show people."""
    shown = [np.unique(d.frame) for d in detections]
    frames, cameras = np.unique(np.concatenate([*shown, np.zeros(0, int)]), return_counts=True)
    frames = frames[cameras > 1]
    chosen: np.ndarray = frames[spread_indices(len(frames), wanted)]
    return chosen


def active_cameras(detections: Sequence[Detections], fps: float) -> list[int]:
    """Indices of the cameras that show people for more than some frames; ``fps`` is 0 if unknown."""
    frames = _frames(detections)
    least = _HARDLY * max(frames, default=0)
    return [v for v, count in enumerate(frames) if count and count >= (min(least, _LONG_S * fps) if fps else least)]


def inactive_camera_notes(detections: Sequence[Detections], fps: float) -> dict[str, str]:
    """Camera → one sentence, for every camera that shows no people, or hardly any, where another does."""
    frames, watched = _frames(detections), active_cameras(detections, fps)
    if not watched:
        return {}
    sighted = ", ".join(detections[v].camera for v in watched)
    return {
        d.camera: f"camera {d.camera} sees "
        + (f"a person in {count} frames only" if count else "nobody")
        + ": it shows only the room, its given pose is unchecked, and identities come from "
        f"{sighted}; if a person is in its picture, add keypoints of another detector"
        for v, (d, count) in enumerate(zip(detections, frames))
        if v not in watched
    }


def _frames(detections: Sequence[Detections]) -> list[int]:
    """Number of frames in which every camera shows a person."""
    return [len(np.unique(d.frame)) for d in detections]
