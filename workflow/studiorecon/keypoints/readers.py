# SPDX-License-Identifier: Apache-2.0
"""Recorded 2D keypoints in the formats that detectors write → one entry per detection."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.deeplabcut import read_deeplabcut
from studiorecon.keypoints.mediapipe import is_mediapipe, read_mediapipe
from studiorecon.scene.outside import read_json, read_npz
from studiorecon.scene.values import listed, numbers, shown, whole

if TYPE_CHECKING:
    from jaxtyping import Num


# What lies under keypoints/ for a camera → who writes it.
FORMATS = {
    "`<camera>/*.json` or `<camera>_json/*.json`, one a picture": "OpenPose, EasyMocap, MMPose, MediaPipe by Pose2Sim",
    "`<camera>.json`": "AlphaPose and COCO results, MMPose, MediaPipe's own results",
    "`<camera>.csv` or `<camera>DLC_….csv`, one animal or several": "DeepLabCut, MediaPipe by Pose2Sim",
    "`<camera>.npz`: `keypoints` (frames, people, points, 3)": "anything else",
}
MOST_PEOPLE_PER_PICTURE = 500
"""Association compares everybody in a picture with everybody."""
MOST_KEYPOINTS = 1000
_MOST_FRAME = 10**15


@dataclass(frozen=True)
class KeypointEntry:
    """One detected person in one picture.

    Attributes:
        frame: number of the picture as the file counts it.
        keypoints: (K, 3) x, y, confidence as recorded.
        identity: the tracker's id, or -1. The place in a list is not an identity.
    """

    frame: int
    keypoints: Num[np.ndarray, "K 3"]
    identity: int


def read_keypoints(path: Path, picture_wh: tuple[int, int] = (0, 0)) -> tuple[list[KeypointEntry], str]:
    """All detections of one camera, and the format's name; ``path`` is one of ``FORMATS``; ``picture_wh``: size of the
    pictures that were looked at, of which MediaPipe tells shares.

    Raises UserError naming the file, and the frame where there is one, when it is of no known format or holds anything
    but it, when its detections do not all have the same number of keypoints, and for more than
    ``MOST_PEOPLE_PER_PICTURE`` in one picture.
    """
    if path.is_dir():
        entries, kind = _folder(path)
    elif path.suffix == ".npz":
        entries, kind = _neutral(path), "npz"
    elif path.suffix == ".json":
        entries, kind = _results(path, picture_wh)
    elif path.suffix == ".csv":
        entries = [KeypointEntry(int(t), points, int(who)) for t, who, points in zip(*read_deeplabcut(path))]
        kind = "DeepLabCut"
    elif path.suffix == ".h5":
        raise UserError(
            f"{path} is DeepLabCut's HDF5, of which the table is read as CSV: analyse the video with save_as_csv=True, "
            "or run deeplabcut.analyze_videos_converth5_to_csv"
        )
    else:
        raise UserError(
            f"{path} is no keypoint file; bring a folder of OpenPose JSON files, an AlphaPose, MMPose or "
            "MediaPipe .json, DeepLabCut's .csv, or an .npz"
        )
    counts = sorted({len(e.keypoints) for e in entries})
    if len(counts) > 1:
        raise UserError(
            f"{path}: detections have {' and '.join(map(str, counts[:3]))} keypoints; run the "
            "detector with one model on all frames"
        )
    if counts and not 0 < counts[0] <= MOST_KEYPOINTS:
        raise UserError(f"{path}: detections have {counts[0]} keypoints; no layout has more than {MOST_KEYPOINTS}")
    frame, most = Counter(e.frame for e in entries).most_common(1)[0] if entries else (0, 0)
    if most > MOST_PEOPLE_PER_PICTURE:
        raise UserError(
            f"{path}, frame {frame}: {most} detections in one picture; at most {MOST_PEOPLE_PER_PICTURE} are read: "
            "run the detector with a higher threshold, or with suppression of duplicates"
        )
    return entries, kind


def last_integer(name: str) -> int | None:
    """The last run of digits in a name: the frame number of ``cam01.0012.json`` and
    ``clip2_000000000012_keypoints.json``."""
    numbers = re.findall(r"\d{1,18}(?!\d)", name)
    return int(numbers[-1]) if numbers else None


def _folder(path: Path) -> tuple[list[KeypointEntry], str]:
    # Folders also hold *.json.old and the like: the suffix must match exactly.
    files = [f for f in path.iterdir() if f.suffix == ".json" and not f.name.startswith(".")]
    if not files:
        raise UserError(f"{path} holds no .json keypoint files")
    entries: list[KeypointEntry] = []
    kinds = set()
    for file in sorted(files, key=lambda f: (last_integer(f.stem) or 0, f.name)):
        frame = last_integer(file.stem)
        if frame is None:
            raise UserError(f"{file} has no frame number in its name")
        content = read_json(file)
        if isinstance(content, dict) and "people" in content:
            kinds.add("OpenPose")
            found = [
                KeypointEntry(frame, _triples(given, file, frame), -1)
                for p in _things(content["people"], "people", file)
                if (given := p.get("pose_keypoints_2d")) not in (None, [])
            ]
        elif isinstance(content, dict) and "annots" in content:
            kinds.add("EasyMocap")
            found = [
                KeypointEntry(frame, _triples(given, file, frame), _identity(a.get("personID", -1)))
                for a in _things(content["annots"], "annots", file)
                if (given := a.get("keypoints")) not in (None, [])
            ]
        elif isinstance(content, list):
            kinds.add("MMPose")
            found = _mmpose(frame, content, file)
        else:
            raise UserError(f"{file} is neither an OpenPose, an EasyMocap nor an MMPose file")
        entries += found
    return entries, "/".join(sorted(kinds))


def _results(path: Path, picture_wh: tuple[int, int]) -> tuple[list[KeypointEntry], str]:
    content = read_json(path)
    if isinstance(content, dict) and "instance_info" in content:
        entries = []
        for place, f in enumerate(_things(content["instance_info"], "instance_info", path)):
            # MMPose's own demo counts frames from 1.
            frame = whole(f.get("frame_id"), f"{path}: frame_id of entry {place}", 0, _MOST_FRAME) - 1
            entries += _mmpose(frame, f.get("instances"), path)
        return entries, "MMPose"
    if isinstance(content, list) and all(isinstance(e, dict) and "image_id" in e and "keypoints" in e for e in content):
        return list(_coco_results(content, path)), "AlphaPose/COCO"
    if is_mediapipe(content):
        read = read_mediapipe(content, picture_wh, path)
        return [KeypointEntry(frame, points, -1) for frame, points in read], "MediaPipe"
    raise UserError(
        f"{path} is neither a list of COCO results (AlphaPose) nor an MMPose file with instance_info nor a list of "
        "MediaPipe's results"
    )


def _coco_results(content: list[dict[str, Any]], path: Path) -> Iterator[KeypointEntry]:
    for place, entry in enumerate(content):
        image = entry["image_id"]
        if isinstance(image, str):
            found = last_integer(image.rsplit(".", 1)[0])
            if found is None:
                raise UserError(f"{path}: image_id {shown(image)} holds no frame number")
            frame = found
        else:
            frame = whole(image, f"{path}: image_id of entry {place}", 0, _MOST_FRAME, "a name or a whole number")
        yield KeypointEntry(frame, _triples(entry["keypoints"], path, frame), _identity(entry.get("idx", -1)))


def _mmpose(frame: int, instances: Any, path: Path) -> list[KeypointEntry]:
    return [
        _mmpose_instance(frame, instance, path)
        for instance in _things(instances, f"the instances of frame {frame}", path)
        if instance.get("keypoints") not in (None, [])
    ]


def _mmpose_instance(frame: int, instance: dict[str, Any], path: Path) -> KeypointEntry:
    points = numbers(instance["keypoints"], f"{path}, frame {frame}: keypoints", finite=False)
    points = points[0] if points.ndim == 3 and len(points) else points
    scores = instance.get("keypoint_scores")
    scores = (
        np.ones(len(points) if points.ndim else 0)
        if scores is None
        else numbers(scores, f"{path}, frame {frame}: keypoint_scores", finite=False).reshape(-1)
    )
    if points.shape != (len(scores), 2):
        raise UserError(f"{path}: an instance of frame {frame} has {points.shape} keypoints for {len(scores)} scores")
    return KeypointEntry(frame, np.concatenate([points, scores[:, None]], axis=1), -1)


def _neutral(path: Path) -> list[KeypointEntry]:
    """``keypoints (T, P, K, 2|3)``, ``scores (T, P, K)`` when there are two columns, optional ``ids (T, P)``."""
    data = read_npz(path)
    if "keypoints" not in data:
        raise UserError(f"{path} has no array named keypoints (frames, people, keypoints, 2 or 3)")
    points = numbers(data["keypoints"], f"{path}: keypoints", finite=False)
    if points.ndim != 4 or points.shape[-1] not in (2, 3) or (points.shape[-1] == 2 and "scores" not in data):
        raise UserError(
            f"{path}: keypoints are {points.shape}; they must be (frames, people, keypoints, 3), or 2 with an array "
            "scores"
        )
    if points.shape[-1] == 2:
        scores = numbers(data["scores"], f"{path}: scores", finite=False)
        if scores.shape != points.shape[:3]:
            raise UserError(f"{path}: scores are {scores.shape} for keypoints {points.shape}; one for each is needed")
        points = np.concatenate([points, scores[..., None]], axis=-1)
    ids = numbers(data["ids"], f"{path}: ids") if "ids" in data else np.full(points.shape[:2], -1.0)
    if ids.shape != points.shape[:2]:
        raise UserError(f"{path}: ids are {ids.shape} for keypoints {points.shape}; one for each person is needed")
    present = (np.nan_to_num(points[..., 2]) > 0).any(-1)
    return [KeypointEntry(int(t), points[t, p], _identity(float(ids[t, p]))) for t, p in np.argwhere(present)]


def _things(value: Any, key: str, path: Path) -> list[dict[str, Any]]:
    """A list of objects."""
    found = listed(value, f"{path}: {key}", "[{…}, {…}]")
    for place, entry in enumerate(found):
        if not isinstance(entry, dict):
            raise UserError(f"{path}: entry {place} of {key} is {shown(entry)}; it must be one person's keypoints")
    return found


def _identity(value: Any) -> int:
    """A tracker's id; what is none stays unknown, since nobody depends on it."""
    known = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < _MOST_FRAME
    return int(value) if known else -1


def _triples(values: Any, path: Path, frame: int) -> np.ndarray:
    flat = numbers(values, f"{path}, frame {frame}: keypoints", finite=False).reshape(-1)
    if len(flat) % 3:
        raise UserError(f"{path}: {len(flat)} keypoint numbers are not triples of x, y, confidence")
    return flat.reshape(-1, 3)


def table() -> str:
    """The formats as a table in Markdown."""
    return "\n".join(
        ["| under `keypoints/` | written by |", "|---|---|", *(f"| {k} | {v} |" for k, v in FORMATS.items())]
    )
