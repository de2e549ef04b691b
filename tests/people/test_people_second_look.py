# SPDX-License-Identifier: Apache-2.0
"""The second look: what the other cameras know corrects one camera, and what they do not confirm changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.detector.blazepose import LAYOUT, MASK_PX, Landmarks, Region
from studiorecon.detector.crops import region_of_body
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people import second_look
from studiorecon.people.expected_keypoints import ExpectedKeypoints, agreement, plan_second_look, swap_left_right
from studiorecon.people.second_look import SecondLook, improve_detections
from studiorecon.scene.capture import Footage
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections

NAMES = LAYOUTS[LAYOUT].keypoints
FRAMES = 6
RNG = np.random.default_rng(4)
# Somebody upright, 200 pixels tall, seen from the front: left is on the right.
_HEIGHTS = {"hip": 100, "knee": 150, "ankle": 195, "heel": 198, "toe": 200, "shoulder": 40, "elbow": 70, "wrist": 100}
SIDES = {"left": 25, "right": -25}
SHAPE = np.array(
    [[SIDES.get(n.split("_")[0], 0), next((h for p, h in _HEIGHTS.items() if p in n), 10)] for n in NAMES], dtype=float
)


def somebody(x: float) -> np.ndarray:
    return SHAPE + np.array([x, 50.0])


def named(pixels: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(NAMES, pixels))


def detections(*rows: tuple[int, int, np.ndarray]) -> Detections:
    """From (frame, track, pixels)."""
    frame, track, pixels = zip(*rows)
    keypoints = np.concatenate([np.array(pixels), np.full((len(rows), len(NAMES), 1), 0.9)], axis=-1)
    guess = np.zeros_like(keypoints)
    return Detections(
        "left", LAYOUT, np.array(frame), np.array(track), keypoints, points_m=guess, row=np.arange(len(rows))
    )


def everywhere(person: str, x: float) -> ExpectedKeypoints:
    return ExpectedKeypoints(person, np.repeat(somebody(x)[None], FRAMES, axis=0))


def test_agreement_is_a_share_of_the_body_and_not_of_the_picture() -> None:
    noisy = np.concatenate([somebody(100) + RNG.normal(0, 2, SHAPE.shape), np.full((33, 1), 0.9)], axis=-1)
    assert agreement(noisy, somebody(100)) > 0.95
    assert agreement(noisy * [8, 8, 1], somebody(100) * 8) == agreement(noisy, somebody(100))
    assert agreement(noisy, somebody(180)) < 0.2
    assert agreement(swap_left_right(LAYOUT, noisy), somebody(100)) < 0.4
    assert agreement(noisy * [1, 1, 0.1], somebody(100)) == 0.0, "unsure landmarks confirm nothing"


def test_somebody_missing_is_looked_for_and_somebody_found_is_left_alone() -> None:
    found = detections(*((t, 0, somebody(100)) for t in range(FRAMES) if t != 3))
    plan = plan_second_look(found, [everywhere("p0", 100)], {("left", 0): "p0"}, FRAMES)
    assert plan.searches == [(3, 0, -1)]
    assert not plan.swap_sides.any()
    assert not plan.drop.any()


def test_sides_that_were_exchanged_are_put_right() -> None:
    rows = [(t, 0, swap_left_right(LAYOUT, somebody(100)) if t == 2 else somebody(100)) for t in range(FRAMES)]
    plan = plan_second_look(detections(*rows), [everywhere("p0", 100)], {("left", 0): "p0"}, FRAMES)
    assert plan.swap_sides.tolist() == [t == 2 for t in range(FRAMES)]
    result = improve_detections(detections(*rows), plan, [], [everywhere("p0", 100)], ["p0"] * FRAMES, 0)
    np.testing.assert_allclose(result.keypoints[:, :, :2], np.repeat(somebody(100)[None], FRAMES, 0))


def test_a_skeleton_on_somebody_else_and_one_found_twice_go() -> None:
    people = [everywhere("p0", 100), everywhere("p1", 400)]
    rows = [(t, k, somebody(x)) for t in range(FRAMES) for k, x in ((0, 100.0), (1, 400.0))]
    rows += [(2, 2, somebody(402.0)), (4, 3, somebody(101.0))]
    # Track 2 is taken for p0 and lies on p1; track 3 is nobody's and lies on p0.
    whose = {("left", 0): "p0", ("left", 1): "p1", ("left", 2): "p0"}
    found = detections(*sorted((r for r in rows if r[:2] != (2, 0)), key=lambda r: r[0]))
    plan = plan_second_look(found, people, whose, FRAMES)
    assert {(int(found.frame[d]), int(found.track[d])) for d in np.flatnonzero(plan.drop)} == {(2, 2), (4, 3)}
    assert [look[:2] for look in plan.searches] == [(2, 0)]


def test_a_skeleton_mixed_of_two_people_goes_and_a_strangers_stays() -> None:
    """The upper half of one and the lower half of the other, beside each other; and somebody whom no other camera
    knows."""
    people = [everywhere("p0", 100), everywhere("p1", 300)]
    rows = [(t, k, somebody(x)) for t in range(FRAMES) for k, x in ((0, 100.0), (1, 300.0))]
    upper = np.array([any(part in n for part in ("shoulder", "elbow", "wrist", "eye", "ear", "nose")) for n in NAMES])
    mixed = np.where(upper[:, None], somebody(100), somebody(300)) + RNG.normal(0, 3, SHAPE.shape)
    found = detections(*rows, (2, 2, mixed), (3, 3, somebody(500.0)), (3, 4, somebody(200.0)))
    plan = plan_second_look(found, people, {("left", 0): "p0", ("left", 1): "p1"}, FRAMES)
    assert {int(found.track[d]) for d in np.flatnonzero(plan.drop)} == {2}


def test_a_free_track_where_somebody_is_expected_becomes_theirs() -> None:
    found = detections(*((t, 7 if t == 3 else 0, somebody(100)) for t in range(FRAMES)))
    plan = plan_second_look(found, [everywhere("p0", 100)], {("left", 0): "p0"}, FRAMES)
    assert plan.track.tolist() == [0] * FRAMES
    assert plan.searches == []


def test_nothing_is_known_where_the_other_cameras_see_too_little() -> None:
    unknown = np.full((FRAMES, 33, 2), np.nan)
    plan = plan_second_look(
        detections((0, 0, somebody(100))), [ExpectedKeypoints("p0", unknown)], {("left", 0): "p0"}, FRAMES
    )
    assert plan.searches == []
    assert not plan.drop.any()


def test_the_region_looked_at_holds_the_whole_body() -> None:
    region = region_of_body(named(somebody(100)), (640, 480))
    assert region is not None
    inward = region.crop_from_picture(256)
    crop = somebody(100) @ inward[:, :2].T + inward[:, 2]
    assert (crop > 0).all()
    assert (crop < 256).all()
    assert np.ptp(crop[:, 1]) > 80, "and is not much larger"
    assert region_of_body(named(somebody(2000)), (640, 480)) is None


@pytest.mark.parametrize("replaces", [-1, 2])
def test_what_is_found_again_joins_the_persons_track_and_brings_its_mask(replaces: int) -> None:
    found = detections(*((t, 5, somebody(100)) for t in range(FRAMES) if t != 3))
    people = [everywhere("p0", 100)]
    plan = plan_second_look(found, people, {("left", 5): "p0"}, FRAMES)
    region = Region(np.array([100.0, 150.0]), 300.0, 0.0)
    keypoints = np.concatenate([somebody(101), np.full((33, 1), 0.8)], axis=-1)
    seen = Landmarks(keypoints, 0.9, np.ones((33, 3)), np.full((MASK_PX, MASK_PX), 7, np.uint8), region, region)
    result = improve_detections(
        found, plan, [SecondLook(3 if replaces < 0 else 2, 0, replaces, seen, keypoints)], people, ["p0"] * 5, 40
    )
    assert result.frame.tolist() == [0, 1, 2, 3, 4, 5] if replaces < 0 else [0, 1, 2, 4, 5]
    assert set(result.track) == {5}
    new = result.row == 40
    assert new.sum() == 1
    np.testing.assert_array_equal(result.keypoints[new][0], keypoints)
    whole = RawDetections.of("left", LAYOUT, 33, [], [(0, FRAMES)], "made")
    grown = whole.grown([(3, keypoints, 0.9, seen.points_m, seen.mask, region.crop_from_picture(MASK_PX))])
    assert grown.mask.shape == (1, MASK_PX, MASK_PX)
    assert replace(grown, note="").frame.tolist() == [3]


def test_where_somebody_is_between_two_moments_lies_on_the_line_between_them() -> None:
    """Half a frame late, and each row at its own time; where the next moment is unknown, as at this one."""
    walking = ExpectedKeypoints("p0", np.stack([somebody(100 + 12 * t) for t in range(FRAMES)]))
    np.testing.assert_allclose(walking.at(2, 0.5), somebody(130))
    np.testing.assert_allclose(walking.at(2, -0.5), somebody(118))
    each = np.linspace(-0.5, 0.5, len(NAMES))
    np.testing.assert_allclose(walking.at(2, each)[:, 0], somebody(124)[:, 0] + 12 * each)
    np.testing.assert_allclose(walking.at(FRAMES - 1, 0.5), somebody(100 + 12 * (FRAMES - 1)))


def test_what_is_found_in_a_late_picture_goes_back_to_its_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture half a frame beside its moment shows somebody 6 px away; the landmarks found there come back."""
    walking = ExpectedKeypoints("p0", np.stack([somebody(100 + 12 * t) for t in range(FRAMES)]))
    requested = []

    def seen_there(_network: object, _picture: object, region: Region) -> Landmarks:
        requested.append(region.centre)
        keypoints = np.column_stack([somebody(124 + 12 * late), np.full(len(NAMES), 1.0)])
        return Landmarks(keypoints, 1.0, np.zeros((33, 3)), np.zeros((MASK_PX, MASK_PX), np.uint8), region, region)

    monkeypatch.setattr(second_look, "detect_in_region", seen_there)
    footage = Footage("left", False, (640, 480), np.eye(3).tolist(), 30.0, FRAMES, 0, "x", "", (640, 480), 0, 0.0, [])
    clocks = Clocks(30.0, 0.0, FRAMES, (Clock("left", 30.0, FRAMES, offset_s=0.5 / 30),))
    monkeypatch.setattr(
        second_look.CameraPictures,
        "working",
        lambda _, seen: np.column_stack([seen.keypoints[:, :2], np.full(33, 0.9)]),
    )
    monkeypatch.setattr(second_look.CameraPictures, "in_footage", lambda _, pixels: pixels)
    late = clocks.late_frames("left")[2]
    assert abs(late) == pytest.approx(0.5)
    view = second_look.CameraPictures(footage, None, {}, clocks)
    plan = replace(plan_second_look(detections((0, 0, somebody(900))), [walking], {}, FRAMES), searches=[(2, 0, -1)])
    (look,) = second_look.redetect(None, [np.zeros((480, 640, 3), np.uint8)], plan, [walking], None, view)
    np.testing.assert_allclose(requested[0][0], somebody(124 + 12 * late)[:, 0][[23, 24]].mean())
    np.testing.assert_allclose(look.keypoints[:, 0], somebody(124)[:, 0])
