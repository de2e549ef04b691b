# SPDX-License-Identifier: Apache-2.0
"""Which cameras show people at all: people say nothing of where the others stand, which serve the room all the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.scene.people import Detections

# What a detector sees in furniture lasts for some frames: fewer than this share of those in which the camera that shows
# most of people does are no witness of where a camera stands.
_HARDLY = 0.2


def watching(detections: Sequence[Detections]) -> list[int]:
    """Indices of the cameras that show people for more than some frames."""
    frames = _frames(detections)
    return [v for v, count in enumerate(frames) if count and count >= _HARDLY * max(frames)]


def others_told(detections: Sequence[Detections]) -> dict[str, str]:
    """Camera → one sentence about it, for every one that shows nobody, or hardly anybody, where another does."""
    frames, watched = _frames(detections), watching(detections)
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
