# SPDX-License-Identifier: Apache-2.0
"""Cameras from the people they saw, without any calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.calibration import from_people
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.relative_pose import relative_pose, resection
from studiorecon.geometry.rotations import angle, exp
from studiorecon.rig import pose_consensus
from studiorecon.rig.gravity import world_from_people
from studiorecon.rig.metric_scale import GivenLengths
from studiorecon.scene.clocks import Clock, Clocks, write_clocks
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import Detections, write_detections

from tests.made.cameras import STANDING, ring, seen, walk
from tests.made.strollers import made_capture
from tests.made.take import after_similarity, made_take


@pytest.fixture
def options(default_settings):
    return settings_module.load(from_people.Settings, default_settings("cameras"), "cameras")


@pytest.fixture(scope="module")
def template(root):
    return from_people.mean_body(BodyModel.load(root / "resources/body.npz"))


def test_cameras_are_found_from_two_people_in_sixty_frames(tmp_path, options, root):
    """Issue's bar: 1° and 3 cm after a similarity, at 3 px noise; tracks are shuffled, nobody says who is who."""
    truth, detections = made_take(occluded=False)
    for d in detections:
        write_detections(tmp_path / f"{d.camera}.npz", d)
        write_json(tmp_path / f"{d.camera}.json", {"camera": d.camera, "wh": [1280, 704]})
    names = [c.name for c in truth]
    write_clocks(tmp_path / "clocks.json", Clocks(30.0, 0.0, 60, tuple(Clock(n, 30.0, 60) for n in names)))

    def run(training: list[str]) -> None:
        from_people.run(
            options,
            [tmp_path / f"{n}.npz" for n in names],
            [tmp_path / f"{n}.json" for n in names],
            tmp_path / "clocks.json",
            root / "resources/body.npz",
            names,
            training,
            [tmp_path / f"{n}.mp4" for n in names],
            [],
            '{"' + '": 914.0, "'.join(names) + '": 914.0}',
            "{}",
            tmp_path / "calibration.json",
        )

    late = detections[0]
    write_detections(tmp_path / f"{late.camera}.npz", replace(late, frame=late.frame + 1000))
    with pytest.raises(UserError, match=r"fewer than two training cameras.*synchronised"):
        run(names[:2])
    write_detections(tmp_path / f"{late.camera}.npz", late)
    run(names)
    content = read_json(tmp_path / "calibration.json")
    found = [
        replace(c, camera_from_world=np.array(v["camera_from_world"]), intrinsics=np.array(v["intrinsics"]))
        for c, v in zip(truth, content["lenses"])
    ]
    degrees, metres, scale = after_similarity(found, truth)
    assert degrees.max() < 1.0
    assert metres.max() < 0.03
    assert scale == pytest.approx(1.0, abs=0.08), "metres come from bones"
    for camera, true in zip(found, truth):
        up, true_up = camera.camera_from_world[:3, 2], true.camera_from_world[:3, 2]
        assert np.degrees(np.arccos(up @ true_up)) < 1.0
        assert camera.centre_m[2] == pytest.approx(true.centre_m[2] / scale, abs=0.06), "the floor is at 0"
    assert any("5 % off" in n for n in content["notes"])
    assert any("from given" in n for n in content["notes"])


def test_somebody_who_stands_still_does_not_determine_cameras_of_unknown_lenses(options, template):
    """Sixty pictures of the same pose are no more than one: focal lengths may not be called known."""
    truth, detections = made_take(frames=60, people=1, still=True, occluded=False)
    found, report = from_people.pose_cameras(detections, [c.wh for c in truth], {}, 60, template, options)
    assert any("hardly determined" in sentence for sentence in report["uncertain"]), report["uncertain"]
    degrees, metres, _ = after_similarity(found, truth)
    assert degrees.max() < report["between_deg"]
    assert metres.max() < 3 * max(report["sigma_m"].values())


@pytest.mark.parametrize("k1", [0.0, -0.35])
def test_lenses_are_estimated_with_the_poses(options, template, k1):
    """Four cameras of one make whose lenses nobody measured, somebody who walks about for 25 s."""
    made = made_capture(0, k1)
    given = GivenLengths(height_m={"": 1.70})
    sizes = [c.wh for c in made.cameras]
    found, report = from_people.pose_cameras(made.detections, sizes, {}, made.frames, template, options, given=given)
    degrees, metres, _ = after_similarity(found, made.cameras)
    assert degrees.max() < 1.0
    assert metres.max() < 0.1
    for camera, true, radial in zip(found, made.cameras, made.radial, strict=True):
        off = np.log(camera.focal_px[0] / true.focal_px[0])
        assert abs(off) < min(0.02, 3 * report["focal_sigma"][camera.name])
        assert abs(report["radial_k1"][camera.name] - radial) < 3 * report["radial_sigma"][camera.name]


@pytest.mark.parametrize(
    ("seed", "drawn", "most"),
    [(1, {"people": 2}, 0.04), (6, {"views": 7, "people": 1, "seconds": 20.0, "fps": 5.0, "around": 0.6}, 0.1)],
    ids=["four cameras", "seven cameras and few moments"],
)
def test_cameras_with_other_lenses_are_not_made_alike(options, template, seed, drawn, most):
    made = made_capture(seed, -0.28, similar=False, **drawn)
    sizes = [c.wh for c in made.cameras]
    found, report = from_people.pose_cameras(made.detections, sizes, {}, made.frames, template, options)
    longer = [np.log(f.focal_px[0] / c.focal_px[0]) for f, c in zip(found, made.cameras, strict=True)]
    assert np.abs(longer).max() < most, "the true ones differ by 30 %"
    assert after_similarity(found, made.cameras)[0].max() < report["between_deg"]


def test_too_few_pictures_are_undetermined_even_with_known_lenses(options, template):
    truth, detections = made_take(frames=4, people=1, occluded=False)
    with pytest.raises(UserError, match="undetermined"):
        from_people.pose_cameras(
            detections, [c.wh for c in truth], {c.name: c.focal_px[0] for c in truth}, 4, template, options
        )


def test_what_is_claimed_covers_a_detector_that_errs_the_same_way_in_every_frame(options, template):
    """A still body and a detector that misplaces every joint of every view by a constant 4 px: averaging frames does
    not help."""
    truth, detections = made_take(frames=40, people=1, still=True, occluded=False)
    rng = np.random.default_rng(8)
    biased = []
    for d in detections:
        shift = np.concatenate(
            [rng.normal(0, 4.0, (d.keypoints.shape[1], 2)), np.zeros((d.keypoints.shape[1], 1))], axis=1
        )
        biased.append(replace(d, keypoints=d.keypoints + shift))
    focal_px = {c.name: c.focal_px[0] for c in truth}
    found, report, words = [], {}, ""
    try:
        found, report = from_people.pose_cameras(biased, [c.wh for c in truth], focal_px, 40, template, options)
    except UserError as refusal:
        words = str(refusal)
    if not found:
        assert "undetermined" in words
        return
    degrees, metres, _ = after_similarity(found, truth)
    assert degrees.max() < 3 * max(report["sigma_deg"].values())
    assert metres.max() < 3 * max(report["sigma_m"].values())


def nobody(camera: str, like: Detections) -> Detections:
    return replace(like, camera=camera, frame=like.frame[:0], track=like.track[:0], keypoints=like.keypoints[:0])


def test_a_camera_that_people_do_not_place_is_left_out_by_name(options, template):
    """One camera sees nobody, another one somebody at other moments: the rest is placed as if they were not there."""
    truth, detections = made_take(frames=60, people=2, occluded=False)
    elsewhere = replace(detections[0], camera="late", frame=detections[0].frame + 1000)
    more = [nobody("blind", detections[0]), *detections[:2], elsewhere, *detections[2:]]
    cameras = [truth[0], *truth[:2], truth[0], *truth[2:]]
    focal_px = {d.camera: c.focal_px[0] for d, c in zip(more, cameras)}
    with_distance = GivenLengths(between=("blind", truth[0].name), distance_m=3.0)
    found, report = from_people.pose_cameras(
        more, [c.wh for c in cameras], focal_px, 60, template, options, given=with_distance
    )
    assert [c.name for c in found] == [c.name for c in truth]
    assert "sees no person" in report["left_out"]["blind"]
    assert "shares too few keypoints" in report["left_out"]["late"]
    assert set(report["left_out"]) == {"blind", "late"}
    assert set(report["sigma_deg"]) == {c.name for c in truth}
    degrees, metres, _ = after_similarity(found, truth)
    assert degrees.max() < 1.0
    assert metres.max() < 0.03
    assert any("distance_m is measured from camera blind" in sentence for sentence in report["uncertain"])


def test_a_camera_that_sees_people_for_a_short_while_only_is_looked_at_then(options, template):
    """Sixty frames of ten minutes hardly meet the two seconds in which the fourth camera sees anybody."""
    truth, detections = made_take(frames=60, people=2, occluded=False)
    spread = [replace(d, frame=d.frame * 60) for d in detections[:3]]
    short = [replace(d, frame=d.frame + 1000) for d in detections]
    everybody = [
        replace(
            d,
            frame=np.concatenate([d.frame, s.frame]),
            track=np.concatenate([d.track, s.track + 1 + d.track.max()]),
            keypoints=np.concatenate([d.keypoints, s.keypoints]),
        )
        for d, s in zip(spread, short)
    ]
    more = [*everybody, short[3]]
    focal_px = {c.name: c.focal_px[0] for c in truth}
    found, report = from_people.pose_cameras(more, [c.wh for c in truth], focal_px, 3600, template, options)
    assert not report["left_out"]
    assert after_similarity(found, truth)[0].max() < 1.0


def test_of_two_arrangements_the_likelier_is_used_and_the_interval_covers_the_other(options, template, monkeypatch):
    truth, detections = made_take(frames=60, people=2, occluded=False)
    focal_px = {c.name: c.focal_px[0] for c in truth}
    given = [c.wh for c in truth], focal_px, 60, template, options

    def with_rival(*what):
        best = arrangement_rigs(*what)
        turned = {
            v: move_camera(c, exp(np.radians([0, 0, 20.0 * (v == 2)])) @ c.camera_from_world[:3, :3], c.centre_m)
            for v, c in best[0].cameras.items()
        }
        return [best[0], replace(best[0], cameras=turned, support=round(0.95 * best[0].support))]

    before = from_people.pose_cameras(detections, *given)[1]
    arrangement_rigs = pose_consensus.propose_rigs
    monkeypatch.setattr(pose_consensus, "propose_rigs", with_rival)
    found, report = from_people.pose_cameras(detections, *given)
    assert not any("two solutions" in sentence for sentence in before["uncertain"])
    assert any("two solutions for the cameras fit" in sentence for sentence in report["uncertain"])
    assert after_similarity(found, truth)[0].max() < 1.0
    assert before["between_deg"] < 5.0
    assert report["between_deg"] > 20.0


def test_cameras_that_share_nobody_are_undetermined(options, template):
    truth, detections = made_take(frames=60, people=2, occluded=False)
    apart = [replace(d, frame=d.frame + 100 * v) for v, d in enumerate(detections)]
    with pytest.raises(UserError, match="no two cameras see enough of one person"):
        from_people.pose_cameras(apart, [c.wh for c in truth], {c.name: 914.0 for c in truth}, 400, template, options)
    focal_px = {c.name: c.focal_px[0] for c in truth}
    synchronised, _ = from_people.pose_cameras(detections, [c.wh for c in truth], focal_px, 60, template, options)
    assert [c.name for c in synchronised] == [c.name for c in truth]


def test_a_pair_is_placed_in_spite_of_a_third_of_false_points():
    rng = np.random.default_rng(4)
    cameras = ring()
    people = walk([-0.5, 0.2, 0], [0.03, 0.02, 0], 40), walk([0.8, -0.6, 0], [-0.01, 0.03, 0], 40, 1.0)
    points = np.concatenate(people, axis=1).reshape(-1, 3)
    pixels = seen(cameras[:2], points, 2.0, rng)
    false = rng.random(len(points)) < 0.33
    pixels[1, false] += rng.uniform(50, 200, (false.sum(), 2))
    first, second = ((pixels[v] - cameras[v].principal_px) / cameras[v].focal_px for v in (0, 1))
    rotation, translation, inliers = relative_pose(first, second, 0.006)
    expected = cameras[1].camera_from_world @ cameras[0].world_from_camera
    assert np.degrees(angle(rotation, expected[:3, :3])) < 1.5
    assert translation @ expected[:3, 3] / np.linalg.norm(expected[:3, 3]) > np.cos(np.radians(2.0))
    assert inliers[false].mean() < 0.2
    pose, agreed = resection(points, second, 0.006)
    assert np.degrees(angle(pose[:3, :3], cameras[1].camera_from_world[:3, :3])) < 0.5
    assert not agreed[false].any()


def test_too_few_points_give_no_pose():
    assert relative_pose(np.zeros((5, 2)), np.zeros((5, 2)), 0.01) is None
    assert resection(np.zeros((5, 3)), np.zeros((5, 2)), 0.01) is None


@pytest.mark.parametrize("turn", [[0, 0, 0], [0.9, 0.4, -0.2], [3.0, 0, 0]])
def test_up_and_floor_come_from_standing_people(turn):
    rng = np.random.default_rng(0)
    starts = rng.uniform(-1, 1, (30, 2))
    people = np.concatenate([STANDING + np.array([x, y, 0.0]) for x, y in starts])
    sloped = people + rng.normal(0, 0.01, people.shape)
    rotation = exp(np.array(turn, dtype=float))
    frame = np.repeat(np.arange(30), 12)
    world, how = world_from_people(sloped @ rotation.T + [3.0, -2.0, 7.0], 0 * frame, frame, np.tile(np.arange(12), 30))
    back = (sloped @ rotation.T + [3.0, -2.0, 7.0]) @ world[:3, :3].T + world[:3, 3]
    assert np.abs(back[:, 2] - sloped[:, 2]).max() < 0.03
    assert "normal of the floor" in how


@pytest.mark.parametrize(("lean_deg", "by_room"), [(8.0, True), (16.0, False)])
def test_walls_are_more_upright_than_people(lean_deg, by_room):
    # One person on one spot leans all the time: their feet show no floor.
    lean = exp(np.radians([lean_deg, 0.0, 0.0]))
    people = np.tile(STANDING @ lean.T, (30, 1))
    room = exp(np.array([0.0, 0.0, 0.4])) * np.array([1.0, 1.0, -1.0])
    frame = np.repeat(np.arange(30), 12)
    world, how = world_from_people(people, 0 * frame, frame, np.tile(np.arange(12), 30), room)
    tilt_deg = np.degrees(np.arccos(min(world[2, 2], 1.0)))
    assert tilt_deg == pytest.approx(0 if by_room else lean_deg, abs=1e-3)
    assert ("room's edges" in how) == by_room
