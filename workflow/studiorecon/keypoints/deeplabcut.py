# SPDX-License-Identifier: Apache-2.0
"""Reads DeepLabCut's CSV, with one animal or several: maps body parts by name to one of our layouts.

Its first rows name every column: ``scorer``, ``individuals`` (with several), ``bodyparts`` and ``coords`` (x, y,
likelihood); then one row per frame, numbered from 0. MediaPipe's landmarks may come in this format too (Pose2Sim's
``Blazepose_runsave``). Parts outside the layout are left out with a message; points of the layout without a part stay
unseen.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.progress import say
from studiorecon.scene.user_files import read_text
from studiorecon.scene.user_values import short_text

if TYPE_CHECKING:
    from jaxtyping import Float

_COORDS = ("x", "y", "likelihood")
_SEPARATORS = (",", ";", "\t")
_HEADERS = ("scorer", "individuals", "bodyparts", "coords")
# Other programs' words for the same part: MediaPipe, OpenPose (RBigToe), AlphaPose.
_WORDS = {
    "l": "left", "r": "right", "ankel": "ankle", "pinky": "little_finger", "index": "index_finger",
    "foot_index": "big_toe", "bigtoe": "big_toe", "smalltoe": "small_toe", "midhip": "mid_hip", "head": "head_top",
    "pinkie": "little_finger", "eye_inner": "inner_eye", "eye_outer": "outer_eye",
}  # fmt: skip
_MIN = 6


def read_deeplabcut(path: Path) -> dict[int, list[Float[np.ndarray, "K 3"]]]:
    """Frame → keypoints of all people in it, in the order of the smallest layout that has the most parts.

    Raises UserError with the line for another table, a cell that is no number, and names that are no person's.
    """
    names, columns, rows = _table(path)
    people = list(dict.fromkeys(individual for individual, _, _ in columns))
    layout, place = _layout(names, path)
    found: dict[int, list[np.ndarray]] = {}
    for line, cells in rows:
        frame, values = _values(path, line, cells, len(columns))
        if frame in found:
            raise UserError(f"{path}, line {line}: frame {frame} comes twice; keep one row per frame")
        persons = np.zeros((len(people), len(LAYOUTS[layout].keypoints), 3))
        for (individual, part, coordinate), value in zip(columns, values):
            if part in place:
                persons[people.index(individual), place[part], coordinate] = value
        found[frame] = list(persons)
    return found


def canonical_name(part: str) -> str:
    """A body part's name as in ``layouts``: side first, words joined by ``_`` (``RShoulder``, ``LEFT_EYE_INNER``)."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=^[LR])(?=[A-Z][a-z])", "_", part.strip())
    words = [_WORDS.get(w, w) if w in ("l", "r") else w for w in re.split(r"[\s_\-.]+", spaced.lower()) if w]
    side = next((word for word in words if word in ("left", "right")), "")
    rest = "_".join(word for word in words if word != side)
    rest = _WORDS.get(rest, rest)
    return f"{side}_{rest}" if side else rest


def _table(path: Path) -> tuple[list[str], list[tuple[str, str, int]], list[tuple[int, list[str]]]]:
    """Names of parts, (individual, part, coordinate) of every column, and (line, cells) of every frame."""
    text = read_text(path)
    # Excel writes semicolons, and decimal commas, where the language has these.
    separator = max(_SEPARATORS, key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
        if separator != ",":
            lines = [(line, [cell.replace(",", ".") for cell in cells]) for line, cells in lines]
    except csv.Error as error:
        raise UserError(f"{path}, line {reader.line_num}: not a table ({error})") from None
    header: dict[str, list[str]] = {}
    while lines and (row := lines[0][1][0].strip()) in _HEADERS and row not in header:
        header[row] = [cell.strip() for cell in lines.pop(0)[1][1:]]
    if lines and "frame_idx" in lines[0][1]:
        raise UserError(
            f"{path} is SLEAP's analysis table, which is not read: write its tracks as an array keypoints (frames, "
            "people, points, 3) of an .npz"
        )
    if not {"scorer", "bodyparts", "coords"} <= header.keys():
        raise UserError(
            f"{path} does not begin with rows of scorer, bodyparts and coords; a CSV of keypoints must be DeepLabCut's"
        )
    parts, coords = header["bodyparts"], header["coords"]
    individuals = header.get("individuals", ["" for _ in parts])
    if not len(parts) == len(coords) == len(individuals):
        raise UserError(f"{path}: its rows of names have {len(parts)}, {len(coords)} and {len(individuals)} cells")
    if unknown := [c for c in coords if c not in _COORDS]:
        raise UserError(
            f"{path} has a column {short_text(unknown[0])}; DeepLabCut writes x, y and likelihood (labels without "
            "likelihood are training data: analyse the video)"
        )
    columns = [(i, p, _COORDS.index(c)) for i, p, c in zip(individuals, parts, coords)]
    if len(set(columns)) < len(columns):
        raise UserError(
            f"{path} has a column of {short_text(next(c for c in columns if columns.count(c) > 1)[1])} twice"
        )
    return list(dict.fromkeys(parts)), columns, lines


def _layout(names: Sequence[str], path: Path) -> tuple[str, dict[str, int]]:
    """The layout, and the index in it of every part that it has."""
    ours = {name: canonical_name(name) for name in names}
    known = {part for layout in LAYOUTS.values() for part in layout.keypoints}
    if len({part for part in ours.values() if part in known}) < _MIN:
        raise UserError(
            f"{path}: its body parts ({', '.join(names[:8])}{', …' if len(names) > 8 else ''}) are not those of a "
            "person; name at least shoulders, hips, knees and ankles (left_shoulder, RKnee, LEFT_HIP, …)"
        )
    best = max(LAYOUTS.values(), key=lambda one: (len(set(ours.values()) & set(one.keypoints)), -len(one.keypoints)))
    place = {name: best.keypoints.index(part) for name, part in ours.items() if part in best.keypoints}
    if len(set(place.values())) < len(place):
        raise UserError(f"{path}: two of its body parts are the same part of {best.name}; rename one")
    if strange := [name for name in names if name not in place]:
        say(f"{path.name}: {', '.join(strange)} are not in the layout {best.name}, and were left out")
    return best.name, place


def _values(path: Path, line: int, cells: list[str], count: int) -> tuple[int, list[float]]:
    number = re.search(r"(?<!\d)(?<!^-)(\d{1,18})(?:\.\w+)?$", cells[0].strip())
    if number is None or len(cells) != count + 1:
        raise UserError(
            f"{path}, line {line}: it holds {len(cells)} cells and begins with {short_text(cells[0])}; a frame's "
            f"number and {count} values are expected"
        )
    try:
        return int(number[1]), [float(cell) if cell.strip() else np.nan for cell in cells[1:]]
    except ValueError:
        raise UserError(f"{path}, line {line}: one of its cells is no number") from None
