# SPDX-License-Identifier: Apache-2.0
"""From recorded keypoints to people: readers, tracks, groups, the pictures' say, and the files of both steps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.tracking import TrackingLimits, drop_duplicates, track_ids
from studiorecon.people import associate
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, Manifest, write_footage, write_manifest
from studiorecon.scene.files import write_json
from studiorecon.scene.people import (
    read_detections,
    read_identities,
    read_people,
    write_detections,
    write_identities,
)
from studiorecon.tracks import keypoints as detections

from tests.made.cameras import detect, owner, ring, walk
from tests.made.recorded import taken_over

FRAMES = 30


@pytest.fixture
def people_settings(default_settings):
    def load(kind: type, **changed):
        stage = "tracks" if kind is detections.Settings else "people"
        return settings_module.load(kind, default_settings(stage, **changed), stage)

    return load


def footage(camera: str = "cam", wh: tuple[int, int] = (640, 480), frames: int = FRAMES, first: int = 0) -> Footage:
    return Footage(
        camera,
        False,
        wh,
        [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]],
        30.0,
        frames,
        first,
        "cam.mp4",
        "",
        wh,
        0,
        0.0,
        [],
    )


def skeleton(x: float, y: float, size: float = 100.0, count: int = 17) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.concatenate(
        [np.array([x, y]) + size * rng.uniform(-0.5, 0.5, (count, 2)), np.full((count, 1), 0.8)], axis=1
    )


def tracking(people_settings, **changed) -> TrackingLimits:
    return replace(people_settings(detections.Settings).tracking, **changed)


def test_25_keypoints_are_distinguished_by_their_limbs():
    rng = np.random.default_rng(0)
    joints = {
        "nose": (0, 0),
        "neck": (0, 20),
        "shoulder": (15, 25),
        "elbow": (25, 55),
        "wrist": (30, 85),
        "hip": (10, 90),
        "knee": (12, 130),
        "ankle": (12, 170),
        "eye": (3, -3),
        "ear": (7, 0),
        "big_toe": (14, 178),
        "small_toe": (18, 177),
        "heel": (10, 175),
        "mid_hip": (0, 90),
        "upper_neck": (0, 15),
        "head_top": (0, -15),
    }

    def person(layout: str) -> np.ndarray:
        side = {"left": 1, "right": -1}
        rows = []
        for name in LAYOUTS[layout].keypoints:
            s, _, part = name.partition("_") if name.split("_")[0] in side else ("left", "", name)
            rows.append([100 + side[s] * joints[part][0], 100 + joints[part][1], 0.9])
        return np.array(rows) + np.concatenate([rng.normal(0, 1, (25, 2)), np.zeros((25, 1))], axis=1)

    for layout in ("body_25", "body_25b"):
        assert choose_layout(np.stack([person(layout)] * 3), "auto", "x")[0] == layout
    with pytest.raises(UserError, match="has 25 keypoints per person, but keypoint_layout coco17 has 17"):
        choose_layout(np.zeros((1, 25, 3)), "coco17", "x")
    with pytest.raises(UserError, match="set keypoint_layout"):
        choose_layout(np.zeros((1, 25, 3)), "auto", "x")


def test_detections_become_undistorted_working_pixels(tmp_path, people_settings):
    lens = Lens(
        "cam",
        (640, 480),
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        "opencv",
        np.zeros(5),
        np.eye(4),
        np.eye(2, 3),
    )
    mapped = {**lens.as_json(), "wh": [1300, 1000], "calibration_from_video": [[2.0, 0, 10], [0, 2.0, 20]]}
    person = skeleton(200, 200)
    person[3] = 0.0  # missing
    person[4, 2] = 5.9  # a detector whose scores exceed 1
    (tmp_path / "k").mkdir()
    for t in range(FRAMES):
        (tmp_path / "k" / f"{t:04d}.json").write_text(
            json.dumps({"people": [{"pose_keypoints_2d": person.reshape(-1).tolist()}]})
        )
    write_footage(tmp_path / "cam.json", footage())
    for name, one in (("plain", lens.as_json()), ("mapped", mapped)):
        for which in ("auto", "video"):
            write_json(tmp_path / "calibration.json", {"lenses": [one]})
            options = people_settings(detections.Settings, keypoint_pixels=which)
            detections.run(
                options,
                "cam",
                taken_over(tmp_path / "k", tmp_path / "k.npz", "coco17"),
                tmp_path / "cam.json",
                tmp_path / "calibration.json",
                tmp_path / "cam.npz",
            )
            found = read_detections(tmp_path / "cam.npz")
            assert found.frame.tolist() == list(range(FRAMES))
            assert set(found.track.tolist()) == {0}
            assert np.isnan(found.keypoints[0, 3, 0])
            assert found.keypoints[0, 3, 2] == 0
            assert found.keypoints[0, 4, 2] == 1
            expected = person[0, :2] + 0.5
            if name == "mapped" and which == "video":
                expected = 2 * expected + [10, 20]
            assert np.allclose(found.keypoints[0, 0, :2], expected)


def test_keypoints_of_frames_that_are_not_used_are_reported(capsys, tmp_path, people_settings):
    lens = Lens("cam", (640, 480), np.eye(3), "opencv", np.zeros(5), np.eye(4), np.eye(2, 3))
    write_json(tmp_path / "calibration.json", {"lenses": [lens.as_json()]})
    write_footage(tmp_path / "cam.json", footage())
    (tmp_path / "k").mkdir()
    (tmp_path / "k" / "5000.json").write_text(
        json.dumps({"people": [{"pose_keypoints_2d": skeleton(9, 9).reshape(-1).tolist()}]})
    )
    options, files = (
        people_settings(detections.Settings),
        [tmp_path / n for n in ("cam.json", "calibration.json", "cam.npz")],
    )
    detections.run(options, "cam", taken_over(tmp_path / "k", tmp_path / "k.npz", "coco17"), *files)
    assert not len(read_detections(files[-1]).frame)
    assert "its 1 recorded people, in frames 5000 to 5000" in "".join(capsys.readouterr())
    detections.run(options, "cam", taken_over(tmp_path / "k", tmp_path / "k.npz", "coco17", 4990), *files)
    assert read_detections(files[-1]).frame.tolist() == [10]


def test_tracks_bridge_gaps_and_end_where_two_people_look_the_same(people_settings):
    limits = tracking(people_settings, gap_s=0.2)
    frames = [t for t in range(20) if t not in (5, 6)]
    one = track_ids(np.array(frames), np.stack([skeleton(100 + 2 * t, 100) for t in frames]), limits, 30.0)
    assert set(one.tolist()) == {0}
    gone = track_ids(np.array([0, 1, 10]), np.stack([skeleton(100, 100)] * 3), limits, 30.0)
    assert gone.tolist() == [0, 0, 1]
    meeting = np.repeat(np.arange(20), 2)
    apart = [skeleton(100 + (10 - t) * 8 * side, 100) for t in range(20) for side in (-1, 1)]
    ids = track_ids(meeting, np.stack(apart), limits, 30.0)
    for track in np.unique(ids):  # no track is on both sides of the meeting
        assert len({(i % 2, t < 10) for i, t in enumerate(meeting) if ids[i] == track and abs(t - 10) > 2}) <= 1


@pytest.mark.parametrize("fps", [10, 15, 30, 60, 120])
def test_a_person_who_walks_or_waves_is_one_track_at_every_frame_rate(people_settings, fps):
    """Half a body height per second sideways; hands and feet swing at 1.5 body heights per second; noise is the same in
    every picture."""
    rng, times_s = np.random.default_rng(0), np.arange(0, 3, 1 / fps)
    swing = np.where(np.arange(17) % 2, 1.0, -1.0) * np.repeat([0, 0.5, 1, 0, 0.5, 1], [7, 2, 2, 2, 2, 2])
    frames, people = np.arange(len(times_s)), []
    for t in times_s:
        person = skeleton(100 + 100 * t, 100, size=200)
        person[:, 0] += 48 * swing * np.sin(2 * np.pi * t)
        person[:, :2] += rng.normal(0, 2.0, (17, 2))
        people.append(person)
    assert set(track_ids(frames, np.stack(people), tracking(people_settings), fps).tolist()) == {0}


def test_a_person_found_twice_in_one_frame_counts_once(people_settings):
    limits = tracking(people_settings)
    weak = skeleton(101, 100)
    weak[:, 2] = 0.3
    both = np.stack([weak, skeleton(100, 100), skeleton(300, 100)])
    assert drop_duplicates(np.zeros(3, int), both, limits).tolist() == [False, True, True]


@pytest.fixture
def two_people():
    return [walk([-0.6, -0.5, 0], [0.02, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.02, 0], FRAMES, 2.0)]


def run_association(tmp_path: Path, cameras, found, options, videos=(), corrected=()):
    write_model(tmp_path / "cameras", cameras)
    write_manifest(
        tmp_path / "manifest.json", Manifest("x", 30.0, FRAMES, tuple(footage(c.name, c.wh) for c in cameras))
    )
    paths = [tmp_path / f"{d.camera}.npz" for d in found]
    for path, d in zip(paths, found):
        write_detections(path, d)
    outputs = [tmp_path / n for n in ("people.tsv", "identities.tsv", "association.json", "who")]
    model = tmp_path / "cameras" / "images.txt"
    associate.run(options, model, tmp_path / "manifest.json", paths, list(videos), list(corrected), *outputs)
    return read_people(tmp_path / "people.tsv"), read_identities(tmp_path / "identities.tsv")


def test_bodies_of_a_network_are_distinguished_by_their_joints(tmp_path, people_settings, two_people):
    """CoMotion brings SMPL's joints, and of a detector's points only the face's."""
    cameras, names = ring(), LAYOUTS["comotion27"].keypoints
    found = []
    for d in detect(cameras, two_people, 1.0, np.random.default_rng(0)):
        own = LAYOUTS[d.layout].keypoints
        points = np.full((len(d.frame), len(names), 3), [np.nan, np.nan, 0.0])
        for k, name in enumerate(names):
            if name.removesuffix("_joint") in own:
                points[:, k] = d.keypoints[:, own.index(name.removesuffix("_joint"))]
        found.append(replace(d, layout="comotion27", keypoints=points))
    people, identities = run_association(tmp_path, cameras, found, people_settings(associate.Settings))
    assert people == ["p0", "p1"]
    assert sorted(identities.values()) == ["p0"] * 4 + ["p1"] * 4


def test_whom_two_of_four_cameras_see_is_a_person_and_an_animal_is_left_out(
    tmp_path, people_settings, two_people, capsys
):
    cameras, rng = ring(), np.random.default_rng(0)
    animal = walk([0.2, 1.2, 0], [0, 0, 0], FRAMES)
    for joints in ((0, 1), (6, 7)):  # shoulders and hips half as wide
        middle = animal[:, joints].mean(1, keepdims=True)
        animal[:, joints] = middle + 0.4 * (animal[:, joints] - middle)
    planted = [*two_people, walk([-1.0, 0.3, 0], [0, 0, 0], FRAMES), animal]
    found = detect(cameras, planted, 2.0, rng, missing={(0, 2), (1, 2)})
    people, identities = run_association(tmp_path, cameras, found, people_settings(associate.Settings))
    assert people == ["p0", "p1", "p2"]
    names: dict[int, set[str]] = {}
    for (view, track), person in owner(cameras, found, planted).items():
        names.setdefault(person, set()).add(identities[cameras[view].name, track])
    assert names.pop(3) == {""}
    assert sorted(map(sorted, names.values())) == [["p0"], ["p1"], ["p2"]]
    messages = capsys.readouterr().out
    left = [line.split("\t") for line in (tmp_path / "people.tsv").read_text().splitlines() if "rejected" in line]
    assert [(row[0], row[2], row[5]) for row in left] == [("r0", "c0,c1,c2,c3", "rejected")]
    assert "proportions" in left[0][6]
    assert "nats" in left[0][6]
    # What is said takes it in.
    lines = messages.split("left out: r0")[1].splitlines()[1:]
    taken = {
        (camera, int(track)): name
        for camera, track, name in (line.split(": ")[1].split("\t") for line in lines if "\t" in line)
    }
    assert set(taken.values()) == {"p3"}
    write_identities(tmp_path / "corrected.tsv", identities | taken)
    people, _ = run_association(
        tmp_path, cameras, found, people_settings(associate.Settings), corrected=[tmp_path / "corrected.tsv"]
    )
    assert people == ["p0", "p1", "p2", "p3"]


def test_the_papers_star_keeps_everybody_of_its_reference_view(tmp_path, people_settings, two_people):
    """No evidence is weighed after it: whom two of four cameras see, and whose build is nobody's, are people."""
    cameras, small = ring(), walk([0.2, 1.2, 0], [0, 0, 0], FRAMES)
    for joints in ((0, 1), (6, 7)):
        small[:, joints] = small[:, joints].mean(1, keepdims=True)
    planted = [*two_people, walk([-1.0, 0.3, 0], [0, 0, 0], FRAMES), small]
    found = detect(cameras, planted, 2.0, np.random.default_rng(0), missing={(2, 2), (3, 2)})
    for method, count in (("tracks", 3), ("star", 4)):
        options = people_settings(associate.Settings, association={"method": method})
        assert len(run_association(tmp_path, cameras, found, options)[0]) == count, method


def test_corrected_identities_replace_what_association_would_say(tmp_path, people_settings, two_people):
    cameras, options = ring(), people_settings(associate.Settings)
    found = detect(cameras, two_people, 1.0, np.random.default_rng(0))
    _, own = run_association(tmp_path, cameras, found, options)
    swapped = {key: {"p0": "p1", "p1": "p0"}.get(person, "") for key, person in own.items()}
    write_identities(tmp_path / "corrected.tsv", swapped)
    people, taken = run_association(tmp_path, cameras, found, options, corrected=[tmp_path / "corrected.tsv"])
    assert people == ["p0", "p1"]
    assert taken == swapped
    assert "corrected" in (tmp_path / "people.tsv").read_text()


def test_nobody_is_an_empty_table_and_it_is_said(tmp_path, people_settings, two_people, capsys):
    found = detect(ring(), [], 1.0, np.random.default_rng(0))
    people, identities = run_association(tmp_path, ring(), found, people_settings(associate.Settings))
    assert people == []
    assert identities == {}
    assert (tmp_path / "people.tsv").read_text() == "person\tframes\tcameras\tconfidence\tsource\tstatus\treason\n"
    assert (tmp_path / "who").is_dir(), "Snakemake waits for the folder"
    reported = capsys.readouterr().out
    assert "warning: no camera has a detection" in reported
    assert "frames (c0, c1, c2, c3)" in reported
    of_another_detector = detect(ring(), two_people, 1.0, np.random.default_rng(0))
    assert run_association(tmp_path, ring(), of_another_detector, people_settings(associate.Settings))[0] == [
        "p0",
        "p1",
    ]
    assert "no camera has a detection" not in capsys.readouterr().out


def test_people_in_two_frames_only_are_nobody_and_it_is_said(tmp_path, people_settings, two_people, capsys):
    longer = detect(ring(), two_people, 1.0, np.random.default_rng(0))
    found = [
        replace(d, frame=d.frame[few], track=d.track[few], keypoints=d.keypoints[few])
        for d in longer
        for few in [d.frame < 2]
    ]
    people, _ = run_association(tmp_path, ring(), found, people_settings(associate.Settings))
    assert people == []
    reported = capsys.readouterr().out
    assert "warning: no person was identified: 16 detections" in reported
    assert "bring a longer clip" in reported
    assert run_association(tmp_path, ring(), longer, people_settings(associate.Settings))[0] == ["p0", "p1"]
    assert "no person was identified" not in capsys.readouterr().out


def test_the_same_inputs_give_the_same_bytes_and_people_are_numbered_by_appearance(
    tmp_path, people_settings, two_people
):
    late = two_people[0].copy()
    late[:10] = np.nan
    cameras = ring()
    texts = []
    for name in ("a", "b"):
        found = detect(cameras, [late, two_people[1]], 1.0, np.random.default_rng(0))
        _, identities = run_association(tmp_path / name, cameras, found, people_settings(associate.Settings))
        texts.append((tmp_path / name / "people.tsv").read_bytes() + (tmp_path / name / "identities.tsv").read_bytes())
        planted = owner(cameras, found, [late, two_people[1]])
        assert {identities[cameras[v].name, t] for (v, t), p in planted.items() if p == 1} == {"p0"}
    assert texts[0] == texts[1]


def test_a_consistent_skeleton_of_nobody_is_rejected_by_the_pictures(tmp_path, people_settings, two_people, capsys):
    wh = (320, 176)
    cameras, rng = [c.resized(wh) for c in ring()], np.random.default_rng(0)
    found = detect(cameras, two_people, 0.3, rng)
    planted = owner(cameras, found, two_people)
    videos = []
    for camera in cameras:
        room = cv2.GaussianBlur(rng.integers(40, 90, (wh[1], wh[0], 3)).astype(np.float32), (0, 0), 2).astype(np.uint8)

        def pictures(camera=camera, room=room):
            for t in range(FRAMES):
                picture = room.copy()
                for joint in camera.project(two_people[0][t])[0]:  # only the first person is really there
                    cv2.circle(picture, (int(joint[0]), int(joint[1])), 7, (230, 220, 60), -1)
                yield picture

        videos.append(tmp_path / f"{camera.name}.mkv")
        write_lossless(videos[-1], pictures(), 30.0)
    people, identities = run_association(tmp_path, cameras, found, people_settings(associate.Settings), videos)
    assert people == ["p0"]
    for (v, t), person in planted.items():
        assert identities[cameras[v].name, t] == ("p0" if person == 0 else "")
    assert "the pictures show no person there" in capsys.readouterr().out


def test_somebody_who_stands_among_walkers_is_a_person_however_keypoints_wander(tmp_path, people_settings, two_people):
    """The pictures show the standing one as a grey post that never changes; the walkers are bright."""
    wh, rng = (320, 176), np.random.default_rng(0)
    cameras = [c.resized(wh) for c in ring()]
    standing = walk([0.1, -1.2, 0], [0, 0, 0], FRAMES) * [1, 1, 1]
    standing[:] = standing[0]
    everybody = [*two_people, standing]
    found = detect(cameras, everybody, 1.5, rng)
    videos = []
    for camera in cameras:
        room = np.full((wh[1], wh[0], 3), 70, np.uint8)

        def pictures(camera=camera, room=room):
            for t in range(FRAMES):
                picture = room.copy()
                for who, colour in (
                    (standing, (75, 75, 75)),
                    (two_people[0], (230, 220, 60)),
                    (two_people[1], (230, 60, 220)),
                ):
                    for joint in camera.project(who[t])[0]:
                        cv2.circle(picture, (int(joint[0]), int(joint[1])), 5, colour, -1)
                yield picture

        videos.append(tmp_path / f"{camera.name}.mkv")
        write_lossless(videos[-1], pictures(), 30.0)
    people, identities = run_association(tmp_path, cameras, found, people_settings(associate.Settings), videos)
    assert people == ["p0", "p1", "p2"]
    planted = owner(cameras, found, everybody)
    assert len({identities[cameras[v].name, t] for (v, t), person in planted.items() if person == 2} - {""}) == 1


@pytest.mark.real
@pytest.mark.slow
def test_the_right_people_come_out_of_the_real_takes(real_data, tmp_path, people_settings, default_settings, root):
    """pose2sim_balancing: one man; in ``multi`` he and a bystander in two cameras, not the ghost."""
    from tests.made.real_take import front_end

    people, _, report = front_end(real_data, root, tmp_path, "single", default_settings)
    assert people == ["p0"]
    assert report["after_px"] < 0.9 * report["before_px"]
    people, identities, _ = front_end(real_data, root, tmp_path, "multi", default_settings)
    assert people == ["p0", "p1"]
    assert sum(person == "" for person in identities.values()) >= 4  # the ghost in four cameras
