# SPDX-License-Identifier: Apache-2.0
"""report: identities, and bodies in held-out pictures, against planted truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.report.metrics.identities import score_against, score_bodies_in_pictures, score_identities
from studiorecon.report.metrics.identity_scores import (
    association_accuracy,
    association_precision,
    best_naming,
    identity_scores,
    identity_switches,
    idf1,
)
from studiorecon.report.metrics.overlap import overlap
from studiorecon.report.metrics.truth import TrueView
from studiorecon.scene.people import Detections

from tests.made.scene import FPS, WH, ring

FRAMES = 5


def standing() -> dict[str, np.ndarray]:
    """Two people (T, 24, 3), 1.2 m apart."""
    joints = (
        np.random.default_rng(0).normal(0, 0.3, (1, 24, 3)) * [0.5, 0.5, 1.2]
        + np.array([0, 0, 1.0])
        + np.zeros((FRAMES, 1, 1))
    )
    return {"p0": joints - [0, 0.6, 0], "p1": joints + np.array([0, 0.6, 0])}


@pytest.mark.parametrize(("swapped", "share"), [(False, 1.0), (True, 0.5)])
def test_identities_swapped_in_one_of_four_cameras_halve_the_pairs(swapped: bool, share: float) -> None:
    """Of the six pairs of four cameras, three exclude the swapped one."""
    cameras = {camera.name: camera for camera in ring([10, 100, 190, 280], "c")}
    people, found, given = standing(), [], {}
    for camera in cameras.values():
        rows = [
            (frame, track, *np.c_[camera.project(people[p][frame])[0], np.ones(24)])
            for track, p in enumerate(people)
            for frame in range(FRAMES)
        ]
        points = np.array([row[2:] for row in rows])
        found.append(
            Detections(camera.name, "smpl24", np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), points)
        )
        given |= {
            (camera.name, track): f"p{1 - track if swapped and camera.name == 'c0' else track}" for track in (0, 1)
        }
    result = score_identities(found, given, cameras, people)
    assert (result["accuracy"], result["precision"]) == (share, share)
    assert (result["pairs"], result["reason"]) == (6 * 2 * FRAMES, None)


def test_rejected_tracks_have_no_identity_in_common() -> None:
    """False detections of two cameras form no pair and no wrong frame."""
    cameras = {camera.name: camera for camera in ring([10, 100], "c")}
    people, found, given = standing(), [], {}
    for camera in cameras.values():
        places = [camera.project(people["p0"][0])[0], camera.project(people["p0"][0])[0] + 400]
        points = np.array([np.c_[place, np.ones(24)] for place in places])
        found.append(Detections(camera.name, "smpl24", np.zeros(2, int), np.arange(2), points))
        given |= {(camera.name, 0): "p0", (camera.name, 1): ""}
    result = score_identities(found, given, cameras, people)
    assert (result["accuracy"], result["precision"], result["wrong_frames"]) == (1.0, 1.0, 0)


def test_bodies_in_held_out_pictures_are_scored_where_they_can_be_seen(tmp_path: Path) -> None:
    camera, people = ring([0], "c")[0], standing()
    mask = np.zeros((WH[1], WH[0]), np.uint8)
    for label, joints in enumerate(people.values(), 1):
        columns, rows = np.floor(camera.project(joints[0])[0]).astype(int).T
        inside = (columns >= 0) & (columns < WH[0]) & (rows >= 0) & (rows < WH[1])
        mask[rows[inside], columns[inside]] = label
    write_lossless(tmp_path / "c0.mkv", [mask] * FRAMES, FPS)
    views = {"c0": TrueView(camera, np.full((WH[1], WH[0]), 3.0, np.float32), tmp_path / "c0.mkv")}
    fitted = {name: (joints, np.ones(FRAMES, bool)) for name, joints in people.items()}
    exact = score_bodies_in_pictures(views, [camera], fitted, people, 0, FRAMES)
    assert (exact["pck_0.05"], exact["detection_rate"]) == (1.0, 1.0)
    alone = score_bodies_in_pictures(views, [camera], {"p0": fitted["p0"]}, people, 0, FRAMES)
    assert alone["detection_rate"] == 0.5
    assert 0.3 < alone["pck_0.1"] < 0.7


def test_association_by_itself_is_scored_against_the_users_own_table() -> None:
    """The paper's manual annotation: names need not agree, tracks of no person are false detections, unlisted tracks do
    not count.
    """
    names = ("c0", "c1", "c2")
    seen = [
        Detections(
            name, "smpl24", np.repeat(np.arange(FRAMES), 4), np.tile(np.arange(4), FRAMES), np.zeros((20, 24, 3))
        )
        for name in names
    ]
    annotated = {(name, track): ("anna", "ben", "")[track] for name in names for track in range(3)}
    similar = {(name, track): ("p1", "p0", "")[track] for name in names for track in range(3)} | {("c0", 3): "p7"}
    found = score_against(seen, annotated, similar)
    assert (found["accuracy"], found["precision"], found["idf1"], found["reason"]) == (1.0, 1.0, 1.0, None)
    assert (found["pairs"], found["detections"]) == (2 * 3 * FRAMES, 2 * 3 * FRAMES)
    # Ben is missing in one camera, and a poster there has his identity.
    wrong = similar | {("c2", 1): "", ("c2", 2): "p0"}
    found = score_against(seen, annotated, wrong)
    assert found["accuracy"] == pytest.approx((3 + 1) / 6)
    assert found["precision"] == pytest.approx((3 + 1) / 6)
    assert score_against([], annotated, similar)["reason"] == "there are no detections"


def test_cameras_overlap_as_the_papers_table_measures_it() -> None:
    even = overlap(ring([10, 100, 190, 280], "c"))
    assert even["training_cameras"] == 4
    assert even["position_deg"] == pytest.approx(120, abs=0.5)
    # Level axes of an even ring of four are a right angle apart; these point slightly down, towards each other.
    assert 80 < even["viewing_deg"] <= 90
    near = overlap(ring([0, 17, 34], "c"))
    assert near["position_deg"] == pytest.approx((17 + 17 + 34) / 3, abs=0.5)
    assert near["viewing_deg"] < 17.5
    assert overlap(ring([0], "c")) == {"training_cameras": 1, "position_deg": None, "viewing_deg": None}


# ---- Association accuracy, precision, IDF1 and switches on planted identities with known scores ----

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
