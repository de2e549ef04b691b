# SPDX-License-Identifier: Apache-2.0
"""Scores of given identities against true ones: accuracy and precision of association, IDF1, switches, wrong frames.

One detection is one row of four equally long integer arrays: ``frame``, ``view``, ``truth`` (true person, negative: a
false detection) and ``given`` (the assigned identity, negative: rejected). Names need not agree: only the grouping
counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Integer


@dataclass(frozen=True)
class IdentityScores:
    """Scores of one scene; NaN without a pair or a detection to score.

    Attributes:
        accuracy: share of a true person's pairs in views of a frame that share a given identity (pair recall).
        precision: share of the pairs given the same identity that are truly one person.
        idf1: 2 IDTP / (2 IDTP + IDFP + IDFN) under the best one-to-one naming over all views and frames.
        idf1_per_view: {view: the same for that view alone}.
        switches: changes of identity of a true person within a view, from one identified detection to the next.
        wrong_frames: frames with a detection whose identity, under that naming, is another person's or a false one's.
        pairs, detections: numbers of true pairs and of detections of true people.
    """

    accuracy: float
    precision: float
    idf1: float
    idf1_per_view: dict[int, float]
    switches: int
    wrong_frames: int
    pairs: int
    detections: int


def identity_scores(
    frame: Integer[np.ndarray, " D"],
    view: Integer[np.ndarray, " D"],
    truth: Integer[np.ndarray, " D"],
    given: Integer[np.ndarray, " D"],
) -> IdentityScores:
    """All scores of detections; raises ValueError, naming the shapes, when the four arrays differ in shape."""
    frame, view, truth, given = _check_rows(frame, view, truth, given)
    views = {int(v): idf1(truth[view == v], given[view == v]) for v in np.unique(view)}
    return IdentityScores(
        accuracy=association_accuracy(frame, view, truth, given),
        precision=association_precision(frame, view, truth, given),
        idf1=idf1(truth, given),
        idf1_per_view=views,
        switches=identity_switches(frame, view, truth, given),
        wrong_frames=wrong_identity_frames(frame, truth, given),
        pairs=sum(int(_same(truth, i, j).sum()) for i, j in _pairs(frame, view)),
        detections=int((truth >= 0).sum()),
    )


def association_accuracy(
    frame: Integer[np.ndarray, " D"],
    view: Integer[np.ndarray, " D"],
    truth: Integer[np.ndarray, " D"],
    given: Integer[np.ndarray, " D"],
) -> float:
    """Pair recall (evaluation.md §1.2): people seen once in a frame do not count; NaN without a pair."""
    frame, view, truth, given = _check_rows(frame, view, truth, given)
    hits = [_same(given, i, j)[_same(truth, i, j)] for i, j in _pairs(frame, view)]
    return _mean(hits)


def association_precision(
    frame: Integer[np.ndarray, " D"],
    view: Integer[np.ndarray, " D"],
    truth: Integer[np.ndarray, " D"],
    given: Integer[np.ndarray, " D"],
) -> float:
    """Share of the pairs of one given identity that are truly one person, no false detection (§1.2); NaN without a
    pair.
    """
    return association_accuracy(frame, view, given, truth)


def best_naming(truth: Integer[np.ndarray, " D"], given: Integer[np.ndarray, " D"]) -> dict[int, int]:
    """{given identity: true person}, one to one, with the most detections in common; pairs without any are left out."""
    people, names = np.unique(truth[truth >= 0]), np.unique(given[given >= 0])
    if not len(people) or not len(names):
        return {}
    both = (truth >= 0) & (given >= 0)
    common = np.zeros((len(people), len(names)), dtype=int)
    np.add.at(common, (np.searchsorted(people, truth[both]), np.searchsorted(names, given[both])), 1)
    rows, columns = scipy.optimize.linear_sum_assignment(-common)
    return {int(names[c]): int(people[r]) for r, c in zip(rows, columns) if common[r, c]}


def idf1(truth: Integer[np.ndarray, " D"], given: Integer[np.ndarray, " D"]) -> float:
    """IDF1 of matched detections; a rejected true one counts as missing, an identified false one as excess."""
    truth, given = np.asarray(truth), np.asarray(given)
    naming = best_naming(truth, given)
    right = sum(int(((given == name) & (truth == person)).sum()) for name, person in naming.items())
    total = int((truth >= 0).sum() + (given >= 0).sum())
    return 2 * right / total if total else float("nan")


def identity_switches(
    frame: Integer[np.ndarray, " D"],
    view: Integer[np.ndarray, " D"],
    truth: Integer[np.ndarray, " D"],
    given: Integer[np.ndarray, " D"],
) -> int:
    """Number of changes of identity over views and true people, each from one identified detection to the next."""
    frame, view, truth, given = _check_rows(frame, view, truth, given)
    count = 0
    for v in np.unique(view):
        for person in np.unique(truth[truth >= 0]):
            which = np.flatnonzero((view == v) & (truth == person) & (given >= 0))
            names = given[which[np.argsort(frame[which], kind="stable")]]
            count += int((names[1:] != names[:-1]).sum())
    return count


def wrong_identity_frames(
    frame: Integer[np.ndarray, " D"], truth: Integer[np.ndarray, " D"], given: Integer[np.ndarray, " D"]
) -> int:
    """Number of frames with a detection that has another person's identity; rejected detections have none."""
    naming = best_naming(truth, given)
    person = np.array([naming.get(int(g), -2) for g in given], dtype=int)
    return len(np.unique(frame[(given >= 0) & (person != truth)]))


def _pairs(frame: np.ndarray, view: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Index pairs of detections of one frame in different views, frame by frame."""
    for t in np.unique(frame):
        here = np.flatnonzero(frame == t)
        i, j = (here[k] for k in np.triu_indices(len(here), 1))
        apart = view[i] != view[j]
        yield i[apart], j[apart]


def _same(label: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    return (label[i] >= 0) & (label[i] == label[j])


def _mean(hits: list[np.ndarray]) -> float:
    flat = np.concatenate(hits) if hits else np.zeros(0, dtype=bool)
    return float(flat.mean()) if len(flat) else float("nan")


def _check_rows(*arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    flat = tuple(np.asarray(a, dtype=int) for a in arrays)
    if len({a.shape for a in flat}) > 1 or flat[0].ndim != 1:
        raise ValueError(f"frame, view, truth and given must be (D,) each, not {', '.join(str(a.shape) for a in flat)}")
    return flat
