# SPDX-License-Identifier: Apache-2.0
"""Recorded 2D keypoints in the formats that detectors write → one entry per detection."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import Num


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


def read_keypoints(path: Path) -> tuple[list[KeypointEntry], str]:
    """All detections of one camera, and the format's name; ``path`` is a folder of JSON files, a JSON file or an npz.

    Raises UserError naming the file when it is of no known format, or when its detections do not all have the same
    number of keypoints.
    """
    if path.is_dir():
        entries, kind = _folder(path)
    elif path.suffix == ".npz":
        entries, kind = _neutral(path), "npz"
    elif path.suffix == ".json":
        entries, kind = _results(path)
    else:
        raise UserError(
            f"{path} is no keypoint file; bring a folder of OpenPose JSON files, an "
            "AlphaPose or MMPose .json, or an .npz"
        )
    counts = sorted({len(e.keypoints) for e in entries})
    if len(counts) > 1:
        raise UserError(
            f"{path}: detections have {' and '.join(map(str, counts))} keypoints; run the "
            "detector with one model on all frames"
        )
    return entries, kind


def last_integer(name: str) -> int | None:
    """The last run of digits in a name: the frame number of ``cam01.0012.json`` and
    ``clip2_000000000012_keypoints.json``."""
    numbers = re.findall(r"\d+", name)
    return int(numbers[-1]) if numbers else None


def _folder(path: Path) -> tuple[list[KeypointEntry], str]:
    # Folders also hold *.json.old and the like: the suffix must match exactly.
    files = [f for f in path.iterdir() if f.suffix == ".json" and f.is_file() and not f.name.startswith(".")]
    if not files:
        raise UserError(f"{path} holds no .json keypoint files")
    entries: list[KeypointEntry] = []
    kinds = set()
    for file in sorted(files, key=lambda f: (last_integer(f.stem) or 0, f.name)):
        frame = last_integer(file.stem)
        if frame is None:
            raise UserError(f"{file} has no frame number in its name")
        content = _load(file)
        if isinstance(content, dict) and "people" in content:
            kinds.add("OpenPose")
            entries += [
                KeypointEntry(frame, _triples(p["pose_keypoints_2d"], file), -1)
                for p in content["people"]
                if p.get("pose_keypoints_2d")
            ]
        elif isinstance(content, dict) and "annots" in content:
            kinds.add("EasyMocap")
            entries += [
                KeypointEntry(frame, _triples(a["keypoints"], file), int(a.get("personID", -1)))
                for a in content["annots"]
                if a.get("keypoints")
            ]
        elif isinstance(content, list):
            kinds.add("MMPose")
            entries += [_mmpose_instance(frame, instance, file) for instance in content if instance.get("keypoints")]
        else:
            raise UserError(f"{file} is neither an OpenPose, an EasyMocap nor an MMPose file")
    return entries, "/".join(sorted(kinds))


def _results(path: Path) -> tuple[list[KeypointEntry], str]:
    content = _load(path)
    if isinstance(content, dict) and "instance_info" in content:
        frames = content["instance_info"]
        # MMPose's own demo counts frames from 1.
        return [
            _mmpose_instance(int(f["frame_id"]) - 1, i, path)
            for f in frames
            for i in f["instances"]
            if i.get("keypoints")
        ], "MMPose"
    if isinstance(content, list) and all(isinstance(e, dict) and "image_id" in e and "keypoints" in e for e in content):
        return list(_coco_results(content, path)), "AlphaPose/COCO"
    raise UserError(f"{path} is neither a list of COCO results (AlphaPose) nor an MMPose file with instance_info")


def _coco_results(content: list[dict[str, Any]], path: Path) -> Iterator[KeypointEntry]:
    for entry in content:
        image = entry["image_id"]
        frame = int(image) if isinstance(image, int) else last_integer(str(image).rsplit(".", 1)[0])
        if frame is None:
            raise UserError(f"{path}: image_id {image!r} holds no frame number")
        identity = entry.get("idx", -1)
        yield KeypointEntry(
            frame, _triples(entry["keypoints"], path), int(identity) if isinstance(identity, (int, float)) else -1
        )


def _mmpose_instance(frame: int, instance: dict[str, Any], path: Path) -> KeypointEntry:
    points = np.asarray(instance["keypoints"], dtype=np.float64)
    points = points[0] if points.ndim == 3 else points
    scores = np.asarray(instance.get("keypoint_scores", np.ones(len(points))), dtype=np.float64).reshape(-1)
    if points.shape != (len(scores), 2):
        raise UserError(f"{path}: an instance of frame {frame} has {points.shape} keypoints for {len(scores)} scores")
    return KeypointEntry(frame, np.concatenate([points, scores[:, None]], axis=1), -1)


def _neutral(path: Path) -> list[KeypointEntry]:
    """``keypoints (T, P, K, 2|3)``, ``scores (T, P, K)`` when there are two columns, optional ``ids (T, P)``."""
    with np.load(path, allow_pickle=False) as data:
        if "keypoints" not in data:
            raise UserError(f"{path} has no array named keypoints (frames, people, keypoints, 2 or 3)")
        points = np.asarray(data["keypoints"], dtype=np.float64)
        if points.ndim != 4 or points.shape[-1] not in (2, 3) or (points.shape[-1] == 2 and "scores" not in data):
            raise UserError(
                f"{path}: keypoints are {points.shape}; they must be (frames, people, "
                "keypoints, 3), or 2 with an array scores"
            )
        if points.shape[-1] == 2:
            points = np.concatenate([points, np.asarray(data["scores"], dtype=np.float64)[..., None]], axis=-1)
        ids = np.asarray(data["ids"]) if "ids" in data else np.full(points.shape[:2], -1)
    present = (np.nan_to_num(points[..., 2]) > 0).any(-1)
    return [KeypointEntry(int(t), points[t, p], int(ids[t, p])) for t, p in np.argwhere(present)]


def _triples(values: list, path: Path) -> np.ndarray:
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    if len(flat) % 3:
        raise UserError(f"{path}: {len(flat)} keypoint numbers are not triples of x, y, confidence")
    return flat.reshape(-1, 3)


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not readable JSON ({error}); it may have been copied only in part") from None
