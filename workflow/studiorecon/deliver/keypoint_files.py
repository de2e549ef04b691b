# SPDX-License-Identifier: Apache-2.0
"""Writes 2D keypoints with identities, in the exported cameras' pixels: OpenPose JSON and EasyMocap annots.

Both hold 21 points of each hand where hands were searched for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.keypoints.hands import SIDES
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_text
from studiorecon.scene.people import Detections

# Both tools count pixels from the first one's centre.
_CENTRE = 0.5


def openpose(folder: Path, seen: Detections, camera: Camera, frames: int, people: Mapping[int, int]) -> list[Path]:
    """Writes ``<camera>_json/<camera>_<frame>_keypoints.json`` per frame; ``person_id`` is the identity or -1."""
    written = []
    for frame in range(frames):
        entries = [
            {
                "person_id": [people.get(int(seen.track[d]), -1)],
                "pose_keypoints_2d": np.round(_triples(seen.keypoints[d]), 9).reshape(-1).tolist(),
                **{
                    f"hand_{side}_keypoints_2d": np.round(hand, 9).reshape(-1).tolist()
                    for side, hand in _hands(seen, d).items()
                },
            }
            for d in np.flatnonzero(seen.frame == frame).tolist()
        ]
        path = folder / f"{seen.camera}_json" / f"{seen.camera}_{frame:012d}_keypoints.json"
        _write(path, {"version": 1.3, "people": entries})
        written.append(path)
    return written


def easymocap(folder: Path, seen: Detections, camera: Camera, frames: int, people: Mapping[int, int]) -> list[Path]:
    """Writes ``annots/<camera>/<frame>.json``, one per frame; ``personID`` is the identity or -1."""
    written = []
    for frame in range(frames):
        annots = []
        for d in np.flatnonzero(seen.frame == frame).tolist():
            points = _triples(seen.keypoints[d])
            present = points[:, 2] > 0
            low, high = points[present, :2].min(0), points[present, :2].max(0)
            box = [*low.tolist(), *high.tolist(), float(points[present, 2].mean())]
            annots.append(
                {
                    "personID": people.get(int(seen.track[d]), -1),
                    "bbox": box,
                    "keypoints": points.tolist(),
                    **{f"hand{side[0]}2d": hand.tolist() for side, hand in _hands(seen, d).items()},
                    "isKeyframe": False,
                }
            )
        content = {
            "filename": f"images/{seen.camera}/{frame:06d}.jpg",
            "height": camera.wh[1],
            "width": camera.wh[0],
            "annots": annots,
        }
        path = folder / "annots" / seen.camera / f"{frame:06d}.json"
        _write(path, content)
        written.append(path)
    return written


WRITERS: dict[str, Callable[[Path, Detections, Camera, int, Mapping[int, int]], list[Path]]] = {
    "openpose": openpose,
    "easymocap": easymocap,
}


def track_numbers(camera: str, identities: Mapping[tuple[str, int], str], people: Sequence[str]) -> dict[int, int]:
    """track → index of its person in ``people``; rejected tracks are absent."""
    return {track: people.index(p) for (name, track), p in identities.items() if name == camera and p in people}


def _triples(points: np.ndarray) -> np.ndarray:
    """(K, 3) x, y, confidence; a missing point is 0, 0, 0, as in both tools."""
    return np.where(points[:, 2:] > 0, points - [_CENTRE, _CENTRE, 0.0], 0.0)


def _hands(seen: Detections, d: int) -> dict[str, np.ndarray]:
    """Side → 21 points of the hands that were searched for beside the body; of none that its layout already holds."""
    if seen.hands is None or any("_hand_" in name for name in LAYOUTS[seen.layout].keypoints):
        return {}
    return {side: _triples(hand) for side, hand in zip(SIDES, seen.hands[d].astype(np.float64))}


def _write(path: Path, content: dict[str, Any]) -> None:
    write_text(path, json.dumps(content, separators=(",", ":")) + "\n")
