# SPDX-License-Identifier: Apache-2.0
"""Hard cases A01 to A15 of association and re-identification."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon import settings as settings_module
from studiorecon.geometry.correspondence import groups_of
from studiorecon.geometry.rotations import exp
from studiorecon.people.affinity import affinities, lift_pelvis, margin, pose_distances, window_distances
from studiorecon.people.associate import Settings, judge
from studiorecon.people.grouping import group_tracks
from studiorecon.people.tracking import match

from tests.foundations.camera_ring import arc, detect, look_at, owner, ring, walk

GATE = {"gate_m": 0.3, "sigma_m": 0.3, "sigma_rad": 0.5}


@pytest.fixture
def options(default_settings):
    return settings_module.load(Settings, default_settings("people"), "people")


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (0, 0)], ids=lambda s: f"A01-{s[0]}x{s[1]}")
def test_nobody_matches_nobody(shape):  # A01 naive: max over empty raises
    assert match(np.zeros(shape), 1.0) == []
    assert margin(np.zeros(shape)).shape == (shape[0],)
    assert window_distances([]).shape == (0, 0)


@pytest.mark.parametrize("poison", [np.nan, np.inf], ids=["A02-nan", "A02-inf"])
def test_one_impossible_pair_does_not_cost_the_others(poison):  # A02 naive: "invalid numeric entries", "infeasible"
    assert match(np.array([[0.1, poison], [poison, poison]]), 0.5) == [(0, 0)]
    assert match(np.array([[poison, poison], [0.9, 0.1]]), 0.5) == [(1, 1)]
    assert affinities(np.array([poison, 0.1]), None, **GATE).tolist()[0] == 0


def test_the_gate_comes_before_the_assignment():  # A03 naive: keeps the wrong pair (1, 0)
    distance = np.array([[0.25, 0.60], [0.28, 2.0]])
    assert match(distance, 0.3) == [(0, 0)]
    view = np.array([0, 0, 1, 1])
    full = np.full((4, 4), np.nan)
    full[:2, 2:] = distance
    full[2:, :2] = distance.T
    assert groups_of(full, view, view[:, None] == view[None], 0.3) == [[0, 2]]


def test_distances_are_metres_before_any_threshold(options):  # A04, A05 naive: at scale 10 0.7 % of the matches survive
    people = [walk([-0.6, -0.5, 0], [0.02, 0, 0], 20), walk([0.7, 0.6, 0], [0, -0.02, 0], 20, 2.0)]
    found = detect(ring(), people, 2.0, np.random.default_rng(0))
    assert len(group_tracks(found, ring(), 20, 30.0, options.association, options.triangulation)) == 2
    # The calibration border scales to metres (cameras.scale); a scene left at ten times its size matches nobody wrongly.
    big = [look_at(c.name, 10 * c.centre_m, [0, 0, 10]) for c in ring()]
    for group in group_tracks(found, big, 20, 30.0, options.association, options.triangulation):
        assert judge(group, big, 20, options.association) is not None


@pytest.mark.parametrize("degrees", [45, 90, 180], ids=lambda d: f"A06-{d}")
def test_the_side_a_person_is_seen_from_is_no_difference_of_pose(degrees):  # A06 naive: 0.79 / 1.57 / 3.14
    body = exp(np.random.default_rng(0).normal(0, 0.5, (1, 23, 3)))
    seen_from_elsewhere = body.copy()  # the root, which alone differs, is not among the body joints
    assert pose_distances(body, seen_from_elsewhere)[0, 0] == pytest.approx(0, abs=1e-7)


def test_a_joint_past_half_a_turn_is_near_itself():  # A07 naive: 6.26
    first, second = exp(np.array([[[np.pi - 0.01, 0, 0]]])), exp(np.array([[[np.pi + 0.01, 0, 0]]]))
    assert pose_distances(first, second)[0, 0] == pytest.approx(0.02, abs=1e-6)


def test_a_little_noise_on_all_joints_keeps_a_graded_affinity():  # A08 naive: norm 0.83, exp 2.5e-4
    rng = np.random.default_rng(0)
    body = exp(rng.normal(0, 0.5, (1, 23, 3)))
    noisy = body @ exp(rng.normal(0, 0.1, (1, 23, 3)))
    other = exp(rng.normal(0, 0.5, (1, 23, 3)))
    near, far = pose_distances(body, noisy)[0, 0], pose_distances(body, other)[0, 0]
    values = affinities(np.zeros(2), np.array([near, far]), **GATE)
    assert values[0] > 0.85
    assert values[1] < 0.6 * values[0]


# A09 naive: pelvises on the skin, 5 cm noise, gate 0.3: 7.9 % of the true pairs refused at 90 degrees, 38.5 % at 180.
@pytest.mark.parametrize("degrees", [90, 180], ids=lambda d: f"A09-{d}")
def test_true_pairs_pass_the_gate(degrees):
    rng = np.random.default_rng(0)
    cameras = arc(degrees) if degrees < 180 else [ring()[0], ring()[2]]
    lifted = []
    for camera in cameras:
        forward = np.array([0, 0, 1.0]) - camera.centre_m
        forward /= np.linalg.norm(forward)
        half = 1 / np.sqrt((forward[0] / 0.11) ** 2 + (forward[1] / 0.17) ** 2)
        pixel, depth = camera.project(np.array([0, 0, 1.0]) - half * forward)
        depths = depth + rng.normal(0, 0.05, (2000, 1))
        lifted.append(lift_pelvis(camera, np.tile(pixel, (2000, 1)), depths, 0.1)[0])
    assert (np.linalg.norm(lifted[0] - lifted[1], axis=-1) > 0.3).mean() < 0.01


def test_four_views_agree_on_one_identity_where_neighbours_alone_do_not():  # A10 naive: 45 % of the rings do not close
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(100):
        truth = np.array([[0.0, 0], [0.7, 0.2], [-0.4, 0.8]])
        view, person = np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4)
        positions = truth[person] + rng.normal(0, 0.1, (12, 2))
        distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
        distance[view[:, None] == view[None]] = np.nan
        groups = groups_of(distance, view, view[:, None] == view[None], 0.6)
        assert all(len({view[n] for n in g}) == len(g) for g in groups)
        wrong += sum(len({person[n] for n in g}) > 1 for g in groups)
    assert wrong / 300 < 0.05


# A11 naive: one frame and a reference view find 0.736 of the pairs at 0.1 m noise.
@pytest.mark.parametrize(("noise_m", "frames"), [(0.1, 11), (0.2, 61)], ids=["A11-0.1m-11", "A11-0.2m-61"])
def test_a_window_of_frames_finds_the_pairs_through_noise_and_misses(noise_m, frames):
    rng = np.random.default_rng(1)
    recalled = total = 0
    for _ in range(20):
        truth = np.array([[0.0, 0, 1], [0.8, 0.3, 1], [-0.5, 0.8, 1]])
        view, person = np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4)
        tracks = [truth[p] + rng.normal(0, noise_m, (frames, 3)) for p in person]
        for track in tracks:
            track[rng.random(frames) < 0.2] = np.nan
        distance = window_distances(tracks)
        distance[view[:, None] == view[None]] = np.nan
        label = np.full(12, -1)
        for g, group in enumerate(groups_of(distance, view, view[:, None] == view[None], 0.3)):
            label[group] = g
        pairs = [(i, j) for i in range(12) for j in range(i) if person[i] == person[j]]
        recalled += sum(label[i] == label[j] >= 0 for i, j in pairs)
        total += len(pairs)
    assert recalled / total >= 0.97


def test_close_people_are_reported_as_undecided():  # A12: 0.45 m apart, 117 degrees
    undecided = margin(affinities(np.array([[0.20, 0.22], [0.05, 0.50]]), None, gate_m=0.6, sigma_m=0.3, sigma_rad=0.5)) < 0.05
    assert undecided.tolist() == [True, False]


def test_ties_of_nothing_match_nobody():  # A13 naive: 0-0, 1-1, 2-2
    assert match(1 - affinities(np.full((3, 3), 5.0), None, **GATE), 1.0) == []
    view = np.repeat([0, 1], 3)
    assert groups_of(np.full((6, 6), 5.0), view, view[:, None] == view[None], 0.3) == []


def test_a_person_who_leaves_and_comes_back_keeps_the_name(options):  # A14 naive: out of a 0.3 m gate after 6 frames
    walker = walk([-1.0, 0.0, 0], [1.4 / 30, 0, 0], 60)
    gone = walker.copy()
    gone[20:40] = np.nan
    found = detect(ring(), [gone], 1.0, np.random.default_rng(0))
    split = [type(d)(d.camera, d.layout, d.frame, np.where(d.frame < 30, 0, 1), d.keypoints) for d in found]
    groups = group_tracks(split, ring(), 60, 30.0, options.association, options.triangulation)
    assert len(groups) == 1
    assert len(groups[0].members) == 8
    far = gone.copy()
    far[40:] += [0.0, 3.0, 0.0]  # 20 frames are not enough for 3 m
    found = detect(ring(), [far], 1.0, np.random.default_rng(0))
    split = [type(d)(d.camera, d.layout, d.frame, np.where(d.frame < 30, 0, 1), d.keypoints) for d in found]
    assert len(group_tracks(split, ring(), 60, 30.0, options.association, options.triangulation)) == 2


def test_the_person_that_one_view_misses_and_the_false_detection(options):  # A15 naive: the third person never gets an id
    rng = np.random.default_rng(3)
    people = [
        walk([-0.7, -0.5, 0], [0.02, 0, 0], 20),
        walk([0.7, 0.6, 0], [0, -0.02, 0], 20, 2.0),
        walk([0.6, -0.8, 0], [0, 0.01, 0], 20, 1.0),
    ]
    cameras = ring()
    nobody = walk([-0.9, 0.9, 0], [0, 0, 0], 20)
    found = detect(cameras, [*people, nobody], 2.0, rng, missing={(0, 2), (0, 3), (1, 3), (2, 3)})
    planted = owner(cameras, found, [*people, nobody])
    groups = group_tracks(found, cameras, 20, 30.0, options.association, options.triangulation)
    accepted = [g for g in groups if judge(g, cameras, 20, options.association) is None]
    assert sorted(sorted({planted[m] for m in g.members}) for g in accepted) == [[0], [1], [2]]
    assert sorted(len(g.members) for g in accepted) == [3, 4, 4]
