# SPDX-License-Identifier: Apache-2.0
"""Reads recorded 2D keypoints in the formats of detectors: the only place where a user's keypoints are read."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.deeplabcut import read_deeplabcut
from studiorecon.keypoints.file_numbers import number_names
from studiorecon.keypoints.hands import HAND_POINTS
from studiorecon.keypoints.layouts import BY_COUNT
from studiorecon.keypoints.picture_content import read_people
from studiorecon.keypoints.result_files import Pictures, read_results
from studiorecon.progress import warn
from studiorecon.scene.recorded_keypoints import RecordedKeypoints
from studiorecon.scene.user_files import read_json, read_npz, read_text
from studiorecon.scene.user_values import numbers

if TYPE_CHECKING:
    from jaxtyping import Float, Num


# Files under keypoints/ for a camera → the program that writes them.
FORMATS = {
    "`<camera>/*.json` or `<camera>_json/*.json`, one a picture": "OpenPose, EasyMocap, AlphaPose, MMPose, "
    "MediaPipe by Pose2Sim",
    "`<camera>/*.txt` or `<camera>/labels/*.txt`, one a picture": "Ultralytics (`save_txt=True`)",
    "`<camera>.json`": "AlphaPose, Detectron and COCO results, MMPose's demo and inferencer, easy_ViTPose, "
    "Ultralytics (a list of `to_json()`), MediaPipe's own results",
    "`<camera>.csv` or `<camera>DLC_….csv`, one animal or several": "DeepLabCut, MediaPipe by Pose2Sim",
    "`<camera>.npz`: `keypoints` (frames, people, points, 3), of one person (frames, points, 3)": "anything else",
}
MAX_PEOPLE_PER_PICTURE = 500
"""Association compares everybody in a picture with everybody."""
MAX_KEYPOINTS = 1000
# Files of other programs that are not read → a remedy.
REFUSED = {
    ".h5": "is DeepLabCut's or SLEAP's HDF5, which is not read: write DeepLabCut's table as CSV (save_as_csv=True, or "
    "deeplabcut.analyze_videos_converth5_to_csv), SLEAP's tracks as an .npz",
    ".slp": "is SLEAP's project, which is not read: write its tracks as an array keypoints (frames, "
    "people, points, 3) of an .npz",
    ".pickle": "is a pickle, which can run programs and is not read: write DeepLabCut's table as CSV",
    ".pkl": "is a pickle, which can run programs and is not read: write an array keypoints into an .npz",
    ".npy": "holds one array without a name: write it as keypoints (frames, people, points, 3) of an .npz",
}
# No detector's score is larger, but per cent are.
_MAX_SCORE = 10.0
# Pixels: no picture is so wide, and no unit of pictures makes such numbers.
_MAX_PLACE = 1e6


def read_keypoints(path: Path, picture_wh: tuple[int, int] = (0, 0)) -> RecordedKeypoints:
    """All people of one camera; ``path`` is one of ``FORMATS``, ``picture_wh`` the size of MediaPipe's and YOLO's
    shares.

    Raises UserError naming the file, and the frame: for an unknown format or broken content, people of different
    numbers of keypoints, and more than ``MAX_PEOPLE_PER_PICTURE`` in one picture.
    """
    if path.is_dir():
        found = _folder(path, picture_wh)
    elif path.suffix.lower() == ".npz":
        found = _neutral(path)
    elif path.suffix.lower() == ".json":
        found = read_results(path, picture_wh)
    elif path.suffix.lower() == ".csv":
        found = Pictures("DeepLabCut", read_deeplabcut(path))
    elif path.suffix.lower() in REFUSED:
        raise UserError(f"{path} {REFUSED[path.suffix.lower()]}")
    else:
        raise UserError(
            f"{path} is no keypoint file; bring a folder of OpenPose JSON files, an AlphaPose, MMPose or "
            "MediaPipe .json, DeepLabCut's .csv, or an .npz"
        )
    return _checked(found, path)


def _checked(found: Pictures, path: Path) -> RecordedKeypoints:
    """``found`` as arrays, once numbers of people, keypoints and scores are checked."""
    pictures = sorted(found.people)
    # Tables have a place for everybody in every picture: 0, or no number, where somebody is not seen.
    everybody = [(n, points) for n in pictures for points in found.people[n] if np.nan_to_num(points).any()]
    counts = sorted({len(points) for _, points in everybody})
    if len(counts) == 2 and counts[1] == counts[0] + 2 * HAND_POINTS:  # hands are written only of those who show one
        everybody = [(n, np.concatenate([p, np.zeros((counts[1] - len(p), 3))])) for n, p in everybody]
        counts = counts[1:]
    if len(counts) > 1:
        raise UserError(
            f"{path}: detections have {' and '.join(map(str, counts[:3]))} keypoints; run the "
            "detector with one model on all frames"
        )
    if counts and not 0 < counts[0] <= MAX_KEYPOINTS:
        raise UserError(f"{path}: detections have {counts[0]} keypoints; no layout has more than {MAX_KEYPOINTS}")
    crowded, most = Counter(number for number, _ in everybody).most_common(1)[0] if everybody else (0, 0)
    if most > MAX_PEOPLE_PER_PICTURE:
        raise UserError(
            f"{path}, frame {crowded}: {most} detections in one picture; at most {MAX_PEOPLE_PER_PICTURE} are read: "
            "run the detector with a higher threshold, or with suppression of duplicates"
        )
    keypoints = np.array([points for _, points in everybody], dtype=np.float64)
    keypoints = keypoints.reshape(len(everybody), counts[0] if counts else 0, 3)
    keypoints = _usable(keypoints, path)
    frame = np.array([number for number, _ in everybody], dtype=np.int64)
    return RecordedKeypoints(found.program, np.array(pictures, dtype=np.int64), frame, keypoints, found.counted)


def _usable(keypoints: Num[np.ndarray, "D K 3"], path: Path) -> Float[np.ndarray, "D K 3"]:
    """``keypoints``, with those that have no position, or no score where others have, marked missing and reported.

    A file without any score has seen everything that it holds. Gaps are what has neither place nor score.
    """
    place, score = keypoints[..., :2], keypoints[..., 2]
    there = (np.abs(place) < _MAX_PLACE).all(-1)
    if there.any() and not np.isfinite(score).any():
        warn(f"{path} has no scores: all of its keypoints are used, guessed ones too")
        score = np.where(there, 1.0, np.nan)
    seen = there & (place != 0).any(-1)
    lost = np.where(there, ~np.isfinite(score), ~(np.isnan(place).all(-1) & ~np.isfinite(score)) & ~(score <= 0))
    if lost.any():
        warn(
            f"{path}: {lost.sum()} of {lost.size} keypoints are not numbers or outside of any picture, and were dropped"
        )
    marked = ((place == 0) | (place == -1)).all(-1)  # what programs write for a keypoint that they do not see
    below = seen & (score < 0) & ~marked
    if seen.any() and not (score[seen] > 0).any():
        warn(f"{path}: all scores are 0 or less, so no keypoint is used; write scores from 0 to 1")
    elif below.any():
        warn(f"{path}: {below.sum()} of {below.size} scores are below 0 and count as unseen; write them from 0 to 1")
    if seen.any() and (top := float(np.max(score, initial=0, where=seen & np.isfinite(score)))) > _MAX_SCORE:
        warn(f"{path}: scores go up to {top:.4g}; above 1 they count as 1: write them from 0 to 1")
    gone = ~there | ~np.isfinite(score)
    return np.where(gone[..., None], [np.nan, np.nan, 0.0], np.concatenate([place, score[..., None]], -1))


def _folder(path: Path, picture_wh: tuple[int, int]) -> Pictures:
    held = sorted(f for f in path.iterdir() if not f.name.startswith("."))
    files = [f for f in held if f.suffix.lower() == ".json"]
    if not files and len(held) == 1 and held[0].is_dir():
        return _folder(held[0], picture_wh)
    if not files and (labels := [f for f in held if f.suffix.lower() == ".txt"]):
        numbered = zip(number_names([f.stem for f in labels], str(path)), labels)
        return Pictures("YOLO", {number: _yolo_people(file, picture_wh) for number, file in numbered})
    if held and not files:
        raise UserError(
            f"{path} holds {held[0].name}{' and more' * (len(held) > 1)}, but no .json file: bring one .json per "
            f"picture, or one file for the video ({path.name}.json, .csv or .npz)"
        )
    found, programs = dict[int, list[Any]](), set()
    for number, file in zip(number_names([f.stem for f in files], str(path)) if files else [], files):
        people, program = read_people(read_json(file), str(file))
        found[number] = people
        programs.add(program)
    return Pictures("/".join(sorted(programs)) or "an empty folder", found)


def _yolo_people(path: Path, picture_wh: tuple[int, int]) -> list[Float[np.ndarray, "K 3"]]:
    """People of one picture by YOLO's pose labels: class, box, then x, y (shares of the picture) and visibility of
    every keypoint, and perhaps a score and a number of the track."""
    people = []
    for line, words in enumerate(map(str.split, read_text(path).splitlines()), 1):
        try:
            row = np.array(words, dtype=np.float64)
        except ValueError:
            row = np.zeros(0)
        count = (len(row) - 5) // 3
        if words and count not in BY_COUNT:
            raise UserError(
                f"{path}, line {line}: {len(words)} words are no person by YOLO's pose labels (class, box, and x, y, "
                f"visibility of {', '.join(map(str, sorted(BY_COUNT)))} keypoints); bring one .json per picture instead"
            )
        if words:
            points = row[5 : 5 + 3 * count].reshape(count, 3)
            unseen = (points[:, :2] == 0).all(-1, keepdims=True)
            people.append(np.where(unseen, [np.nan, np.nan, 0.0], points * [*picture_wh, 1.0] - [0.5, 0.5, 0.0]))
    return people


def _neutral(path: Path) -> Pictures:
    """The arrays ``keypoints`` (T, P, K, 2|3), or of one person (T, K, 2|3), and ``scores`` for two columns."""
    data = read_npz(path)
    if "keypoints" not in data:
        raise UserError(f"{path} has no array named keypoints (frames, people, keypoints, 2 or 3)")
    points = numbers(data["keypoints"], f"{path}: keypoints", finite=False)
    scored = next((data[name] for name in ("scores", "keypoint_scores") if name in data), None)
    if points.ndim not in (3, 4) or points.shape[-1] != (3 if scored is None else 2):
        raise UserError(
            f"{path}: keypoints are {points.shape}; they must be (frames, people, keypoints, 3), or 2 with an array "
            "scores"
        )
    if scored is not None:
        scores = numbers(scored, f"{path}: scores", finite=False)
        if scores.shape != points.shape[:-1]:
            raise UserError(f"{path}: scores are {scores.shape} for keypoints {points.shape}; one for each is needed")
        points = np.concatenate([points, scores[..., None]], axis=-1)
    points = points[:, None] if points.ndim == 3 else points
    return Pictures("npz", {t: list(people) for t, people in enumerate(points)}, counted=True)


def formats_table() -> str:
    """The formats as a table in Markdown."""
    return "\n".join(
        ["| under `keypoints/` | written by |", "|---|---|", *(f"| {k} | {v} |" for k, v in FORMATS.items())]
    )
