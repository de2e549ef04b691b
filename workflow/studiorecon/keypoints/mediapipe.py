# SPDX-License-Identifier: Apache-2.0
"""Reads MediaPipe's results, written as JSON: one entry per picture, landmarks as shares of the picture's sides.

MediaPipe writes no files; programs that save its results use its names. The names of all its interfaces are read:
``landmarks`` (JavaScript), ``pose_landmarks`` (Python's tasks: people of landmarks; its older solutions: one person's
``{"landmark": [...]}``), ``poseLandmarks`` (protocol buffers as JSON). A picture without people is an empty list, or
null.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.file_numbers import MAX_NUMBER
from studiorecon.scene.user_values import numbers, short_text, whole

if TYPE_CHECKING:
    from jaxtyping import Float

_NAMES = ("pose_landmarks", "poseLandmarks", "landmarks")
# Landmarks beyond the picture's border are guessed, but not whole pictures away; pixels are far larger.
_MAX_SHARE = 3.0


def is_mediapipe(content: Any) -> bool:
    """Whether a file's content is a list of MediaPipe's results, or such a list named ``frames``."""
    frames = _frames(content)
    return bool(frames) and all(isinstance(one, dict) and any(name in one for name in _NAMES) for one in frames)


def read_mediapipe(content: Any, picture_wh: tuple[int, int], path: Path) -> dict[int, list[Float[np.ndarray, "33 3"]]]:
    """Frame → x, y in pixels of a picture of ``picture_wh``, and visibility, of all people in it.

    An entry's ``frame`` counts where it has one, else its index. Raises UserError naming file and frame.
    """
    found: dict[int, list[np.ndarray]] = {}
    for place, one in enumerate(_frames(content)):
        frame = whole(one.get("frame", place), f"{path}: frame of entry {place}", 0, MAX_NUMBER)
        if frame in found:
            raise UserError(f"{path}: frame {frame} comes twice; keep one entry per picture")
        where = f"{path}, frame {frame}"
        people = _people(next(one[name] for name in _NAMES if name in one), where)
        found[frame] = [_points(person, picture_wh, where) for person in people]
    return found


def lacks_frame_numbers(content: Any) -> bool:
    """Whether the entries have no numbers of their own, so that their indices count."""
    return not any("frame" in one for one in _frames(content))


def _frames(content: Any) -> list[Any]:
    listed = content.get("frames") if isinstance(content, dict) else content
    return listed if isinstance(listed, list) else []


def _people(found: Any, where: str) -> list[list[Any]]:
    if found is None or found == []:
        return []
    if isinstance(found, dict) and isinstance(found.get("landmark"), list):
        return [found["landmark"]]
    if isinstance(found, list) and all(isinstance(one, dict) and "x" in one for one in found):
        return [found]
    if isinstance(found, list) and all(isinstance(one, list) for one in found):
        return found
    raise UserError(
        f"{where}: landmarks are {short_text(found)}; MediaPipe's are a list of people, each 33 of {{x, y, …}}"
    )


def _points(person: list[Any], picture_wh: tuple[int, int], where: str) -> np.ndarray:
    if not all(isinstance(one, dict) and {"x", "y"} <= one.keys() for one in person):
        raise UserError(f"{where}: a landmark has no x and y; write what MediaPipe returns as it is")
    given = [[one["x"], one["y"], one.get("visibility")] for one in person]
    points = numbers(given, f"{where}: landmarks", finite=False)
    if points.shape != (33, 3):
        raise UserError(f"{where}: a person has {len(person)} landmarks; MediaPipe's bodies have 33")
    if np.nanmax(np.abs(points[:, :2]), initial=0) > _MAX_SHARE:
        raise UserError(f"{where}: landmarks are up to {np.nanmax(points[:, :2]):.0f}; MediaPipe's are shares, 0 to 1")
    # Shares count from the picture's border, keypoint files from the first pixel's centre.
    return points * [*picture_wh, 1.0] - [0.5, 0.5, 0.0]
