# SPDX-License-Identifier: Apache-2.0
"""Hands at the ends of arms: which are searched for, what becomes of them, and left and right among the cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.detector.crops import Region
from studiorecon.detector.hand_landmarks import Hand
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.expected_keypoints import ExpectedKeypoints
from studiorecon.people.fitting.hands import by_side, person_hands
from studiorecon.people.hand_search import Arm, arms_in_view, find_hands, hands_of_rows, interpolate_hands
from studiorecon.rig.body_points import person_tracks
from studiorecon.rig.hand_sizes import hand_sizes_px, large_hands, second_best, usual_size
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import look_at

LAYOUT = LAYOUTS["blazepose33"].keypoints
RNG = np.random.default_rng(1)
# A hand of 0.18 m along x, and a left one beside a right one.
HAND_M = np.column_stack([np.linspace(0, 0.18, 21), RNG.uniform(-0.04, 0.04, (21, 2))])
BOTH_M = np.stack([HAND_M + np.array([0.1, 0.3, 1.2]), HAND_M * [1, -1, 1] + np.array([0.1, -0.3, 1.0])])
FRAMES = 6


def ring(count: int, focal_px: float = 900.0) -> list[Camera]:
    """Cameras 3 m from the middle that look at it, 1280 × 720."""
    angles = [2 * np.pi * (k + 0.15) / count for k in range(count)]
    places = [np.array([3 * np.cos(a), 3 * np.sin(a), 1.5]) for a in angles]
    return [look_at(f"cam{k}", p, np.array([0, 0, 1.1]), (1280, 720), focal_px) for k, p in enumerate(places)]


def hands_in(cameras: list[Camera]) -> np.ndarray:
    """(V, T, 2, 21, 3) both hands in every picture."""
    pixels = np.array([c.project(BOTH_M)[0] for c in cameras])
    seen = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], -1)
    return np.repeat(seen[:, None], FRAMES, 1)


def people_in(cameras: list[Camera]) -> list[Detections]:
    """One person's arms: elbows 0.245 m behind the wrists."""
    found = []
    for camera in cameras:
        keypoints = np.zeros((FRAMES, len(LAYOUT), 3))
        keypoints[..., :2] = np.nan
        for side, word in enumerate(("left", "right")):
            wrist = BOTH_M[side, 0]
            for name, place in (("wrist", wrist), ("elbow", wrist - [0.245, 0, 0])):
                keypoints[:, LAYOUT.index(f"{word}_{name}")] = [*camera.project(place)[0], 0.9]
        found.append(Detections(camera.name, "blazepose33", np.arange(FRAMES), np.zeros(FRAMES, int), keypoints))
    return found


def sizes(cameras: list[Camera], film_px: float = 1.0) -> np.ndarray:
    found = people_in(cameras)
    who = {(d.camera, 0): "p0" for d in found}
    return hand_sizes_px(person_tracks(found, who, ["p0"], FRAMES, 0.3), cameras, [film_px] * len(cameras))


def test_sizes_are_those_of_a_hand_at_the_wrist():
    cameras = ring(4)
    found = sizes(cameras)
    depths = np.array([c.project(BOTH_M[:, 0])[1] for c in cameras])
    np.testing.assert_allclose(found[:, 0, 0], 900 * 0.74 * 0.245 / depths, rtol=1e-3)
    np.testing.assert_allclose(sizes(cameras, 2.5), 2.5 * found, rtol=1e-6)


@pytest.mark.parametrize(
    ("focal_px", "use", "searched"),
    [(900, "auto", True), (400, "auto", False), (400, "on", True), (900, "off", False)],
)
def test_only_large_hands_are_searched_for(focal_px: float, use: str, searched: bool):
    found = sizes(ring(4, focal_px))
    assert large_hands(found, use).any() == searched
    usual = usual_size(found)
    assert usual is not None
    assert usual[1][0] < second_best(found).max() < usual[1][1]


def test_one_view_is_not_enough():
    assert not large_hands(sizes(ring(4))[:1], "auto").any()
    assert usual_size(np.zeros((4, 1, FRAMES, 2))) is None


class Network:
    """Finds the hand whose wrist is nearest to a region, and knows its side."""

    def __init__(self, hands: np.ndarray, presence: float = 0.9, right: tuple[float, float] = (0.1, 0.9)) -> None:
        self.hands, self.presence, self.right, self.looks = hands, presence, right, 0

    def look(self, picture: np.ndarray, region: Region) -> Hand:
        self.looks += 1
        side = int(np.linalg.norm(self.hands[:, :, :2].mean(1) - region.centre, axis=1).argmin())
        return Hand(self.hands[side, :, :2], self.presence, self.right[side])


def searched(network: Network, camera: Camera) -> np.ndarray:
    """The hands of one camera as its detections get them, at 60 frames a second."""
    own = people_in([camera])[0]
    person = np.zeros(FRAMES, int)
    arms = arms_in_view(own, person, [ExpectedKeypoints("p0", own.keypoints[..., :2])], np.full((1, FRAMES, 2), 60.0),
                        lambda pixels: pixels, 60.0)  # fmt: skip
    picture = np.zeros((4, 4, 3), np.uint8)
    found = find_hands(network, [picture] * FRAMES, arms)  # type: ignore[arg-type]
    hands, _ = hands_of_rows(found, FRAMES, lambda pixels: (pixels, np.ones(len(pixels), bool)))
    return interpolate_hands(hands, own, person, 60.0)


def test_hands_hang_on_their_arms_and_fill_the_pictures_between():
    camera = ring(4)[0]
    truth = hands_in([camera])[0]
    network = Network(truth[0])
    found = searched(network, camera)
    np.testing.assert_allclose(found[:4, :, :, :2], truth[:4, :, :, :2], atol=1e-2)
    assert np.isnan(found[4:, ..., 0]).all()  # frame 6, the next that would be searched, is not there
    assert network.looks == 2 * 2  # of both hands in both pictures that are searched


@pytest.mark.parametrize(("bent_rad", "is_found"), [(0.0, True), (0.6, True), (-0.6, True), (1.5, False)])
def test_a_hand_at_a_bent_wrist_is_searched_for_in_turned_crops(bent_rad: float, is_found: bool):
    class Upright(Network):
        def look(self, picture: np.ndarray, region: Region) -> Hand:
            seen = super().look(picture, region)
            off = abs((region.turn_rad - seen.region.turn_rad + np.pi) % (2 * np.pi) - np.pi)
            return replace(seen, presence=0.9 if off < 0.3 else 0.0)

    fingers = np.column_stack([np.linspace(0, 60, 21), np.tile([-8.0, 0.0, 8.0], 7)])
    c, s = np.cos(bent_rad), np.sin(bent_rad)
    hand = fingers @ np.array([[c, s], [-s, c]]) + 100
    arms = [Arm(t, t, 0, 0, hand[0], hand[0] + [60.0, 0.0], 60.0) for t in range(4)]
    network = Upright(np.stack([hand, hand + 900]))
    found = find_hands(network, [np.zeros((4, 4, 3), np.uint8)] * 4, arms)  # type: ignore[arg-type]
    assert bool(found) == is_found


@pytest.mark.parametrize(
    "network",
    [
        Network(hands_in(ring(4)[:1])[0, 0], presence=0.1),
        Network(hands_in(ring(4)[:1])[0, 0] + 300),
    ],
    ids=["absent", "elsewhere"],
)
def test_what_is_no_hand_of_the_arm_is_not_kept(network: Network):
    assert not (searched(network, ring(4)[0])[..., 2] > 0).any()


def arranged(cameras: list[Camera], right: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    """Hands at the arms of their sides, and the network's probability of a right one."""
    hands = hands_in(cameras)
    return hands, np.broadcast_to([1 - right, right], hands.shape[:3]).copy()


@pytest.mark.parametrize(("views", "wrong"), [(4, [2]), (4, []), (3, [0]), (5, [1, 3]), (2, [1])])
def test_exchanged_arms_are_mended_by_the_other_pictures(views: int, wrong: list[int]):
    cameras = ring(views)
    truth, unknown = hands_in(cameras), np.full((views, FRAMES, 2), np.nan)
    given = truth.copy()
    given[wrong, 2] = truth[wrong, 2, ::-1]
    mended, exchanged = by_side(given, unknown, cameras, 20.0)
    np.testing.assert_allclose(mended[..., :2], truth[..., :2])
    assert mended[..., 2].min() > 0.9
    assert exchanged == len(wrong)


def test_the_networks_opinion_shows_which_of_two_cameras_errs_throughout():
    cameras = ring(2)
    truth, right = arranged(cameras)
    given, opinion = truth.copy(), right.copy()
    given[1], opinion[1] = truth[1, :, ::-1], right[1, :, ::-1]
    mended, exchanged = by_side(given, opinion, cameras, 20.0)
    np.testing.assert_allclose(mended[..., :2], truth[..., :2])
    assert exchanged == FRAMES


def test_a_sure_network_that_errs_for_a_moment_is_outvoted():
    cameras = ring(4)
    truth, right = arranged(cameras, 0.99)
    right[1, 2:5] = right[1, 2:5, ::-1].copy()
    mended, exchanged = by_side(truth, right, cameras, 20.0)
    np.testing.assert_allclose(mended[..., :2], truth[..., :2])
    assert exchanged == 0


@pytest.mark.parametrize("arm", [0, 1])
def test_one_hand_found_at_both_arms_is_that_of_its_side(arm: int):
    cameras = ring(3)
    truth, right = arranged(cameras)
    given, opinion = truth.copy(), right.copy()
    given[0], opinion[0] = truth[0, :, [arm, arm]].swapaxes(0, 1), right[0, :, [arm, arm]].T
    mended, _ = by_side(given, opinion, cameras, 20.0)
    np.testing.assert_allclose(mended[0, :, arm, :, :2], truth[0, :, arm, :, :2])
    assert np.isnan(mended[0, :, 1 - arm, :, 0]).all()
    np.testing.assert_allclose(mended[1:, ..., :2], truth[1:, ..., :2])


def test_clasped_hands_are_not_exchanged_when_they_part():
    cameras = ring(4)
    apart, right = arranged(cameras)
    together = np.array([c.project(BOTH_M + np.array([[[0, -0.29, 0]], [[0, 0.29, 0.2]]]))[0] for c in cameras])
    truth, right = np.tile(apart, (1, 3, 1, 1, 1)), np.tile(right, (1, 3, 1))
    truth[:, FRAMES : 2 * FRAMES, ..., :2] = together[:, None]
    given = truth.copy()
    # Where hands hold each other, each camera finds one of them at both arms.
    for view, side in enumerate((0, 1, 1, 0)):
        given[view, FRAMES : 2 * FRAMES, 1 - side] = truth[view, FRAMES : 2 * FRAMES, side]
        right[view, FRAMES : 2 * FRAMES] = side
    mended, exchanged = by_side(given, right, cameras, 20.0)
    assert exchanged == 0
    for free in (slice(FRAMES), slice(2 * FRAMES, None)):
        np.testing.assert_allclose(mended[:, free, ..., :2], truth[:, free, ..., :2])
    twice = np.isclose(mended[:, :, 0, :, :2], mended[:, :, 1, :, :2]).all((2, 3))
    assert not twice.any()


def test_hands_of_a_persons_tracks_reach_the_fit():
    cameras = ring(4)
    truth = hands_in(cameras)
    found = [replace(d, hands=truth[v].astype(np.float32)) for v, d in enumerate(people_in(cameras))]
    who = {(d.camera, 0): "p0" for d in found}
    about = found, who, cameras, [1.0] * 4, FRAMES
    hands = person_hands("p0", *about, "auto", 60.0)
    assert hands is not None
    np.testing.assert_allclose(hands[..., :2], truth[..., :2], atol=1e-3)
    assert person_hands("p1", *about, "auto", 60.0) is None
    assert person_hands("p0", *about, "off", 60.0) is None
    assert person_hands("p0", people_in(cameras), *about[1:], "auto", 60.0) is None
    small = ring(4, 400)
    assert person_hands("p0", people_in(small), who, small, [1.0] * 4, FRAMES, "auto", 60.0) is None
