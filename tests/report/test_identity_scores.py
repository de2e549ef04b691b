# SPDX-License-Identifier: Apache-2.0
"""Association accuracy, precision, IDF1 and switches on planted identities with known scores."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.report.metrics.identity_scores import (
    association_accuracy,
    association_precision,
    best_naming,
    identity_scores,
    identity_switches,
    idf1,
)

# Ten frames, three views, two people each: every frame has 2 people × 3 pairs of views.
FRAME = np.repeat(np.arange(10), 6)
VIEW = np.tile(np.repeat(np.arange(3), 2), 10)
TRUTH = np.tile([0, 1], 30)


def test_perfect_identities_score_one_under_any_names() -> None:
    scores = identity_scores(FRAME, VIEW, TRUTH, np.where(TRUTH == 0, 7, 3))
    assert (scores.accuracy, scores.precision, scores.idf1) == (1.0, 1.0, 1.0)
    assert (scores.switches, scores.wrong_frames, scores.pairs, scores.detections) == (0, 0, 60, 60)
    assert set(scores.idf1_per_view.values()) == {1.0}


def test_a_view_that_swaps_two_people_in_one_frame() -> None:
    given = TRUTH.copy()
    swapped = (FRAME == 4) & (VIEW == 1)
    given[swapped] = 1 - given[swapped]
    scores = identity_scores(FRAME, VIEW, TRUTH, given)
    # Of that frame's six true pairs only the two of views 0 and 2 are right; of its six claimed pairs too.
    assert scores.accuracy == pytest.approx(56 / 60)
    assert scores.precision == pytest.approx(56 / 60)
    assert scores.idf1 == pytest.approx(58 / 60)
    assert scores.switches == 4  # two people, there and back
    assert scores.wrong_frames == 1
    assert scores.idf1_per_view == {0: 1.0, 1: pytest.approx(0.9), 2: 1.0}


def test_rejected_detections_cost_accuracy_and_never_precision() -> None:
    given = np.where(VIEW == 2, -1, TRUTH)
    scores = identity_scores(FRAME, VIEW, TRUTH, given)
    assert scores.accuracy == pytest.approx(1 / 3)
    assert scores.precision == 1.0
    assert scores.wrong_frames == 0
    assert scores.idf1 == pytest.approx(2 * 40 / (60 + 40))


def test_false_detections_with_a_name_cost_precision_and_never_accuracy() -> None:
    truth = np.where(TRUTH == 1, -1, TRUTH)
    scores = identity_scores(FRAME, VIEW, truth, TRUTH)
    assert scores.accuracy == 1.0
    assert scores.precision == pytest.approx(0.5)
    assert scores.wrong_frames == 10


def test_one_identity_for_two_people_is_named_after_the_more_frequent_one() -> None:
    truth = np.array([0, 0, 0, 1])
    assert best_naming(truth, np.array([5, 5, 5, 5])) == {5: 0}
    assert idf1(truth, np.array([5, 5, 5, 5])) == pytest.approx(6 / 8)


def test_nobody_is_undetermined_not_zero() -> None:
    none = np.zeros(0, dtype=int)
    scores = identity_scores(none, none, none, none)
    assert all(np.isnan(v) for v in (scores.accuracy, scores.precision, scores.idf1))
    alone = np.array([3])
    assert np.isnan(association_accuracy(alone, alone, alone, alone))
    assert np.isnan(association_precision(alone, alone, alone, -alone))


def test_a_gap_is_no_switch() -> None:
    frame, view = np.arange(5), np.zeros(5, int)
    assert identity_switches(frame, view, np.zeros(5, int), np.array([1, -1, 1, 2, 2])) == 1


def test_the_order_of_detections_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    truth, given = rng.integers(-1, 3, 60), rng.integers(-1, 3, 60)
    order = rng.permutation(60)
    assert identity_scores(FRAME, VIEW, truth, given) == identity_scores(
        FRAME[order], VIEW[order], truth[order], given[order]
    )
