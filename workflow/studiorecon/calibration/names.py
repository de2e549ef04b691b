# SPDX-License-Identifier: Apache-2.0
"""Candidate pairings of calibrated cameras and videos by their names, the likeliest first.

A shared word weighs more the fewer names share it: of ``2024-05-11_take2_cam1`` only the last number distinguishes
cameras. People decide between several pairings (``calibration.choose``).
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.numbered_files import natural_sort_key

# If one name equals the other, or a run of whole words of it, that counts more than all shared words. If names do not
# match at all, so many pairings are tried on people: all of four cameras.
_MAX_TRIED = 24
_SAME, _SAME_BUT_FOR_CASE, _PART = 16.0, 8.0, 2.0


@dataclass(frozen=True)
class Pairing:
    """One camera of the calibration for every video (``calibrated``), and ``how`` names decided it, "" if equal.

    ``sure``: whether names alone suffice; others are used only where people show that they are right.
    """

    calibrated: dict[str, str]
    how: str
    sure: bool = True

    def sentence(self, source: str) -> str:
        listed = ", ".join(f"{film} = {camera}" for film, camera in self.calibrated.items())
        return f"videos and cameras of {source} were paired {self.how}: {listed}"


def pairings(footage: Sequence[str], calibrated: Sequence[str], source: str) -> list[Pairing]:
    """All pairings that names allow, the likeliest first; a single one where the names are equal.

    Raises UserError with both lists where there is none: the calibration is for other cameras.
    """
    if set(footage) <= set(calibrated):
        return [Pairing({film: film for film in footage}, "")]
    weight = _weights(footage, calibrated)
    found = [Pairing(pairs, "by what their names share") for pairs in _best_pairings(footage, calibrated, weight)]
    if not found or weight.max(1).min() < _PART:
        found += _shifted_pairings(footage, calibrated)
    if not any(p.sure for p in found) and math.perm(len(calibrated), len(footage)) <= _MAX_TRIED:
        found += [
            Pairing(dict(zip(footage, order)), "against their names", sure=False)
            for order in itertools.permutations(calibrated, len(footage))
        ]
    distinct = [p for i, p in enumerate(found) if p.calibrated not in [q.calibrated for q in found[:i]]]
    if not distinct:
        raise mismatch_error(footage, calibrated, source)
    return distinct


def mismatch_error(footage: Sequence[str], calibrated: Sequence[str], source: str) -> UserError:
    """The refusal of a calibration whose names do not fit, or that lacks some of the cameras."""
    lacking = [film for film in footage if film not in calibrated]
    if len(footage) - len(lacking) > 1:
        named = ", ".join(film for film in footage if film in calibrated)
        return UserError(
            f"{source} has no camera {', '.join(lacking)}: leave it out with train: [{named}] in capture.yaml, or "
            "calibrate all cameras"
        )
    return UserError(
        f"{source} is a calibration for other cameras: it has "
        f"{', '.join(calibrated) or 'none'}, the footage has {', '.join(footage)}; "
        "rename the videos, or name the right file in capture.yaml: calibration: FILE"
    )


def pairings_in_order(footage: Sequence[str], count: int, source: str) -> list[Pairing]:
    """The pairings of a calibration of ``count`` cameras without names: the sorted videos in its order.

    Numbers sort as numbers (cam2 before cam10) first, as text second. Raises UserError when the counts differ.
    """
    if len(footage) != count:
        raise UserError(
            f"{source} has {count} cameras without names, the footage has {len(footage)} ({', '.join(footage)}); "
            "bring all videos of the capture, or a calibration with names"
        )
    orders = [sorted(footage, key=natural_sort_key), sorted(footage)]
    return [
        Pairing({film: str(index) for index, film in enumerate(order)}, f"in the order {', '.join(order)}")
        for order in (orders if orders[0] != orders[1] else orders[:1])
    ]


def _weights(footage: Sequence[str], calibrated: Sequence[str]) -> np.ndarray:
    """(videos, cameras) weight of the distinctive words that each pair of names shares; 0 for none."""
    ours, theirs = [_words(name) for name in footage], [_words(name) for name in calibrated]
    counts = [Counter(word for words in side for word in words) for side in (ours, theirs)]
    weight = np.zeros((len(footage), len(calibrated)))
    for i, film in enumerate(footage):
        for j, camera in enumerate(calibrated):
            shared = ours[i] & theirs[j]
            # Words in every name of a side do not count, unless there is only one name.
            weight[i, j] = sum(
                1 / (counts[0][word] * counts[1][word])
                for word in shared
                if counts[0][word] < len(footage) or counts[1][word] < len(calibrated) or min(weight.shape) == 1
            )
            if any(_is_identifying(a) and a.casefold() in _parts(b) for a, b in ((film, camera), (camera, film))):
                weight[i, j] += _PART
            if film.casefold() == camera.casefold():
                weight[i, j] += _SAME if film == camera else _SAME_BUT_FOR_CASE
    return weight


def _best_pairings(footage: Sequence[str], calibrated: Sequence[str], weight: np.ndarray) -> list[dict[str, str]]:
    """The complete pairings with the largest sum of weights: one, or all single exchanges with the same sum."""
    from scipy.optimize import linear_sum_assignment  # 0.1 s, which equal names avoid

    if len(calibrated) < len(footage) or not len(calibrated):
        return []

    def solved(of: np.ndarray) -> tuple[float, tuple[int, ...]]:
        rows, columns = linear_sum_assignment(of, maximize=True)
        chosen = weight[rows, columns]
        return (float(chosen.sum()) if (chosen > 0).all() else -1.0), tuple(int(c) for c in columns)

    best, first = solved(weight)
    found = [first] if best > 0 else []
    for row, column in enumerate(first if found else ()):
        without = weight.copy()
        without[row, column] = -_SAME * len(footage)
        total, other = solved(without)
        if total > best - 1e-9 and other not in found:
            found.append(other)
    return [{film: calibrated[c] for film, c in zip(footage, columns)} for columns in found]


def _shifted_pairings(footage: Sequence[str], calibrated: Sequence[str]) -> list[Pairing]:
    """Pairings of names that differ by their numbers alone, with another first number: 0 to 3 and 1 to 4."""
    ours, theirs = _numbers(footage), _numbers(calibrated)
    if ours is None or theirs is None or len(calibrated) < len(footage):
        return []
    of_number = dict(zip(theirs, calibrated))
    found = []
    for shift in sorted({t - o for t in theirs for o in ours}, key=lambda s: (abs(s), s)):
        # Numbers from 0 or from 1 only: another first number means other cameras.
        if abs(shift) <= 1 and all(number + shift in of_number for number in ours):
            pairs = {film: of_number[number + shift] for film, number in zip(footage, ours)}
            # That cam1 is cam2 of the other side cannot be trusted by names.
            sure = not set(footage) & set(calibrated)
            found.append(Pairing(pairs, f"by their numbers, {shift:+d}" if shift else "by their numbers", sure))
    return found


def _numbers(names: Sequence[str]) -> list[int] | None:
    """The one number of each name in which the names differ; None where they differ otherwise, or in several."""
    split = [re.split(r"(\d+)", name.casefold()) for name in names]
    if len({len(parts) for parts in split}) != 1:
        return None
    differing = [i for i in range(len(split[0])) if len({parts[i].lstrip("0") for parts in split}) > 1]
    if len(names) == 1:
        differing = list(range(1, len(split[0]), 2))[-1:]
    if len(differing) != 1 or not split[0][differing[0]].isdigit():
        return None
    numbers = [int(parts[differing[0]]) for parts in split]
    return numbers if len(set(numbers)) == len(numbers) else None


def _is_identifying(name: str) -> bool:
    """Whether a name identifies a camera: it has a letter, or as many digits as a serial number."""
    return not name.isdigit() or len(name) > 2


def _words(name: str) -> set[str]:
    """The words and numbers of a name; numbers without leading zeros."""
    return {word.lstrip("0") or "0" for word in re.findall(r"\d+|[^\W\d_]+", name.casefold())}


def _parts(name: str) -> set[str]:
    """All runs of whole words of a name, so that cam01 is a part of int_cam01_img but cam0 is not."""
    words = re.findall(r"[^_\-. ]+|[_\-. ]+", name.casefold())
    return {"".join(words[i:j]) for i in range(len(words)) for j in range(i + 1, len(words) + 1)}
