# SPDX-License-Identifier: Apache-2.0
"""How many people there will be, before anybody is followed: recorded keypoints say so, or a few pictures of a few
cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.detector.blazepose import BlazePose
from studiorecon.detector.looking import newcomers, trust
from studiorecon.detector.windows import grid
from studiorecon.footage.frames import glimpses
from studiorecon.footage.source import FootageSource
from studiorecon.home import RESOURCES
from studiorecon.keypoints.readers import read_keypoints

_DETECTION, _LANDMARKS = (RESOURCES / "detector" / f"{name}.onnx" for name in ("pose_detection", "pose_landmark_full"))
# Cameras and pictures that are looked at, a quarter of a second each.
_CAMERAS, _PICTURES = 4, 3
# How sure a single look must be of somebody: of those who sit behind the scene, and of what only looks like a body, it
# is less.
_SURE = 0.6


def people_seen(
    sources: Mapping[str, FootageSource], keypoints: Mapping[str, Path], first_frame: int, frames: int
) -> int:
    """How many people two of the cameras (name → footage) see in ``frames`` frames from ``first_frame``: whom only one
    sees is not reconstructed.

    Raises UserError naming a file that cannot be read.
    """
    cameras, network, counts = list(sources), None, []
    for k in evenly_spread(len(cameras), _CAMERAS):
        source, recorded = sources[cameras[k]], keypoints.get(cameras[k])
        if recorded is not None:
            counts.append(_recorded(recorded, source.wh))
        else:
            network = network or BlazePose(_DETECTION, _LANDMARKS)
            counts.append(_glimpsed(network, source, first_frame, frames))
    return seen_twice(counts)


def seen_twice(counts: Sequence[int]) -> int:
    """How many people two cameras see, of those that each sees; all that a single camera sees."""
    return sorted(counts)[-2:][0]


def _recorded(path: Path, wh: tuple[int, int]) -> int:
    _, per_frame = np.unique(read_keypoints(path, wh).frame, return_counts=True)
    return int(np.median(per_frame)) if len(per_frame) else 0


def _glimpsed(network: BlazePose, source: FootageSource, first_frame: int, frames: int) -> int:
    moments = [first_frame + int((k + 0.5) / _PICTURES * frames) for k in range(_PICTURES)]
    seen = [
        sum(trust(person) >= _SURE for person in newcomers(network, picture, grid(source.wh), []))
        for picture in glimpses(source, moments)
    ]
    return int(np.median(seen))
