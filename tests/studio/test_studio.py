# SPDX-License-Identifier: Apache-2.0
"""The synthetic studio: its truth is exact, its people stand on the floor, and every option plants its effect and
nothing else."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import yaml
from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.calibration.files import read_calibration
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import read_stack
from studiorecon.keypoints.layouts import HAND_POINT_NAMES, LAYOUTS
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera
from studiorecon.scene.schema import record
from studiorecon.studio import capture, performance, rig, takes
from studiorecon.studio.actors import Actors
from studiorecon.studio.calibration import calibration_texts
from studiorecon.studio.description import CALIBRATION_FILES, DEFAULTS, planned_dataset, read_description
from studiorecon.studio.detections import detect
from studiorecon.studio.room import build_room
from studiorecon.studio.tracing import Tracer

SMALL = {"seed": 3, "frames": 3, "size": [96, 56], "supersampling": 1, "cameras": {"training": 3, "held_out": 1}}


@pytest.fixture(scope="session")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources" / "body.npz")


def described(folder: Path, **options):
    path = folder / "studio.yaml"
    path.write_text(yaml.safe_dump(merged(SMALL, options)))
    return path


def merged(base: dict, over: dict) -> dict:
    return base | {
        k: merged(base[k], v) if isinstance(v, dict) and isinstance(base.get(k), dict) else v for k, v in over.items()
    }


def film(folder: Path, **options) -> Path:
    """A capture of a small description with some options, in this process."""
    folder.mkdir(parents=True, exist_ok=True)
    capture.run(described(folder, **options), folder / "dataset", folder / "truth", processes=1)
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small capture with every option off and all the truth there is."""
    return film(tmp_path_factory.mktemp("plain"), truth={"depth_frames": True, "flow": True}, crf=0)


def cameras_of(folder: Path) -> dict[str, Camera]:
    return {c["name"]: record(Camera, c) for c in json.loads((folder / "truth" / "cameras.json").read_text())}


def video(path: Path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([f.to_ndarray(format="rgb24") for f in container.decode(video=0)]).astype(np.float64)


def keypoints(folder: Path, camera: str, frame: int) -> list[np.ndarray]:
    path = folder / "dataset" / "keypoints" / camera / f"{camera}_{frame:012d}_keypoints.json"
    return [np.reshape(p["pose_keypoints_2d"], (-1, 3)) for p in json.loads(path.read_text())["people"]]


def digests(folder: Path) -> dict[str, str]:
    files = [p for part in ("dataset", "truth") for p in sorted((folder / part).rglob("*")) if p.is_file()]
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


# ---- truth ----


def test_what_is_written_is_a_dataset_and_is_what_was_planned(plain: Path):
    dataset = open_dataset(plain / "dataset")
    planned = planned_dataset(read_description(plain / "studio.yaml"), plain / "dataset", plain / "truth")
    assert dataclasses.replace(planned, truth=None) == dataset
    assert dataset.training == ("cam1", "cam2", "cam3")
    assert dataset.held_out == ("view1",)


@pytest.mark.parametrize("camera", ["cam1", "view1"])
def test_room_depth_puts_the_floor_at_zero_and_walls_where_they_are(plain: Path, camera: str):
    depth, confidence = read_depth(plain / "truth" / "depth" / f"{camera}.exr")
    view = cameras_of(plain)[camera]
    points = view.unproject(view.pixel_centres(), depth.astype(np.float64))
    assert confidence.min() == 1
    assert points[..., 2].min() > -1e-4
    assert (np.abs(points[..., 2]) < 1e-4).mean() > 0.2, "no floor in the picture"
    assert np.abs(points[..., 0]).max() < 4.2 + 1e-4
    assert np.abs(points[..., 1]).max() < 3.6 + 1e-4


def test_depth_of_frames_lies_on_the_bodies_where_the_mask_says_so(plain: Path, body: BodyModel):
    from scipy.spatial import cKDTree

    view = cameras_of(plain)["cam1"]
    depth_m = read_stack(plain / "truth" / "depth_frames" / "cam1.mkv")[1] / 1000.0
    mask = read_stack(plain / "truth" / "masks" / "cam1.mkv")[1]
    assert set(np.unique(mask)) == {0, 1, 2}
    points = view.unproject(view.pixel_centres(), depth_m)
    for number in (0, 1):
        person = read_person(plain / "truth" / "bodies" / f"p{number}.npz")
        vertices = body.vertices(person.poses[1:2], person.betas, person.trans[1:2])[0]
        distance, _ = cKDTree(vertices).query(points[mask == number + 1])
        assert distance.max() < 0.03, "a masked pixel is not on the body's surface"


def test_masks_of_two_cameras_agree_with_the_projected_bodies(plain: Path, body: BodyModel):
    mask = read_stack(plain / "truth" / "masks" / "view1.mkv")[0]
    view = cameras_of(plain)["view1"]
    fine = 16
    drawn = np.zeros((mask.shape[0] * fine, mask.shape[1] * fine), np.uint8)
    for number in (0, 1):
        person = read_person(plain / "truth" / "bodies" / f"p{number}.npz")
        pixels, _ = view.project(body.vertices(person.poses[:1], person.betas, person.trans[:1])[0].astype(np.float64))
        for triangle in np.rint(pixels[body.faces] * fine - 0.5).astype(np.int32):
            cv2.fillConvexPoly(drawn, triangle, 1)
    drawn = drawn[fine // 2 :: fine, fine // 2 :: fine] > 0
    assert (drawn & (mask > 0)).sum() / (drawn | (mask > 0)).sum() > 0.95


def test_keypoints_without_noise_are_the_projected_body_points(plain: Path, body: BodyModel):
    names = LAYOUTS["body_25"].keypoints
    seen = 0
    for camera in ("cam1", "cam2", "cam3"):
        view = cameras_of(plain)[camera]
        truth = []
        for number in (0, 1):
            person = read_person(plain / "truth" / "bodies" / f"p{number}.npz")
            truth.append(view.project(body.keypoints(names, person.poses, person.betas, person.trans)[2])[0])
        for found in keypoints(plain, camera, 2):
            present = found[:, 2] > 0
            seen += present.sum()
            errors = [np.abs(found[present, :2] + 0.5 - t[present]).max() for t in truth]
            assert min(errors) < 1e-3
    assert seen > 60


def test_flow_of_truth_moves_a_body_pixel_to_where_the_body_is_next(plain: Path):
    flow = np.load(plain / "truth" / "flow" / "cam1.npz")["flow"].astype(np.float64)
    masks = read_stack(plain / "truth" / "masks" / "cam1.mkv")
    rows, columns = np.nonzero(cv2.erode((masks[0] > 0).astype(np.uint8), np.ones((3, 3), np.uint8)))
    there = np.rint(np.column_stack([columns, rows]) + flow[0, rows, columns]).astype(int)
    inside = (there >= 0).all(1) & (there < [masks.shape[2], masks.shape[1]]).all(1)
    assert (masks[1][there[inside, 1], there[inside, 0]] > 0).mean() > 0.93
    assert np.abs(flow[0][masks[0] == 0]).max() == 0


def test_clean_frames_are_the_held_out_video_without_its_losses(plain: Path):
    clean = read_stack(plain / "truth" / "frames" / "view1.mkv").astype(np.float64)
    filmed = video(plain / "dataset" / "videos" / "view1.mp4")
    assert clean.shape == filmed.shape == (3, 56, 96, 3)
    # Colour is stored at half resolution in H.264; luma is not.
    assert np.abs(clean.mean(-1) - filmed.mean(-1)).mean() < 4


def test_the_room_does_not_flicker_where_nobody_is(plain: Path):
    clean = read_stack(plain / "truth" / "frames" / "view1.mkv")
    plate = cv2.imread(str(plain / "truth" / "plates" / "view1.png"))[..., ::-1]
    masks = read_stack(plain / "truth" / "masks" / "view1.mkv")
    away = cv2.dilate(masks.max(0), np.ones((5, 5), np.uint8)) == 0
    assert away.mean() > 0.5
    assert all(np.array_equal(frame[away], plate[away]) for frame in clean)


# ---- people ----


@pytest.mark.parametrize("number", range(4))
def test_feet_stand_on_the_floor_and_do_not_slide(body: BodyModel, number: int):
    times = np.arange(75) / 30
    betas = performance.random_betas(3, number)
    poses, trans = performance.perform(performance.PARTS[number], body, betas, times)
    vertices = body.vertices(poses, betas, trans)
    lowest = vertices[..., 2].min(axis=1)
    assert lowest.min() > -0.008
    assert lowest.max() < 0.003
    # The lowest vertices of a foot on the floor must not move along it: heels and balls roll, they do not slide.
    steps = np.linalg.norm(np.diff(vertices[..., :2], axis=0), axis=-1)
    grounded = (vertices[:-1, :, 2] < 0.004) & (vertices[1:, :, 2] < 0.004)
    # A walker advances 36 mm a frame.
    assert np.median(steps[grounded]) < 0.003, "feet slide"
    assert np.quantile(steps[grounded], 0.95) < 0.010, "feet slide"
    assert np.isfinite(poses).all()
    assert np.abs(np.diff(trans, axis=0)).max() * 30 < 2.2


def test_the_first_person_passes_close_behind_the_second(body: BodyModel):
    times = np.arange(120) / 30
    first, second = (
        performance.perform(performance.PARTS[k], body, performance.random_betas(3, k), times)[1][:, :2] for k in (0, 1)
    )
    gap = np.linalg.norm(first - second, axis=1)
    assert 0.45 < gap.min() < 1.0


# ---- determinism ----


def test_the_same_description_gives_the_same_bytes(plain: Path, tmp_path: Path):
    again = film(tmp_path, truth={"depth_frames": True, "flow": True}, crf=0)
    assert digests(again) == {**digests(plain)}


# ---- options ----


def test_people_cameras_and_arc_are_as_many_as_requested(tmp_path: Path):
    folder = film(
        tmp_path,
        frames=1,
        people=4,
        cameras={"training": 3, "held_out": 2, "layout": "arc", "arc_deg": 100.0, "jitter_deg": 0.0},
    )
    views = cameras_of(folder)
    azimuth = {n: np.degrees(np.arctan2(v.centre_m[1], v.centre_m[0])) for n, v in views.items()}
    assert [round(azimuth[n]) for n in ("cam1", "view1", "cam2", "view2", "cam3")] == [-5, 20, 45, 70, 95]
    assert len(list((folder / "truth" / "bodies").glob("p*.npz"))) == 4
    found = {int(v) for n in views for v in np.unique(read_stack(folder / "truth" / "masks" / f"{n}.mkv"))}
    assert found == {0, 1, 2, 3, 4}


def test_an_empty_room_has_no_keypoints_and_says_so(tmp_path: Path):
    folder = film(tmp_path, frames=1, people=0)
    dataset = open_dataset(folder / "dataset")
    assert not dataset.people
    assert not dataset.keypoints
    assert not read_stack(folder / "truth" / "masks" / "cam1.mkv").any()


def test_exposure_and_white_balance_scale_training_videos_only(plain: Path, tmp_path: Path):
    folder = film(tmp_path, faults={"exposure": 0.12, "white_balance": 0.05}, crf=0)
    gains = json.loads((folder / "truth" / "truth.json").read_text())["gains"]
    assert gains["view1"] == [1, 1, 1]
    for name in ("cam1", "cam2", "cam3"):
        before, after = (video(f / "dataset" / "videos" / f"{name}.mp4") for f in (plain, folder))
        dark = (before.max(-1) < 170) & (before.min(-1) > 30)
        measured = after[dark].mean(0) / before[dark].mean(0)
        assert measured == pytest.approx(gains[name], abs=0.02)
        assert max(abs(np.log(gains[name]))) > 0.005
    assert digests(folder)["dataset/videos/view1.mp4"] == digests(plain)["dataset/videos/view1.mp4"]


def test_radial_distortion_bends_pictures_and_keypoints_and_the_calibration_knows(plain: Path, tmp_path: Path):
    folder = film(tmp_path, frames=1, faults={"radial_distortion": -0.12})
    assert "-0.12" in (folder / "dataset" / "intri.yml").read_text()
    # Truth stays in the ideal pinhole's pixels.
    assert digests(folder)["truth/depth/cam1.exr"] == digests(plain)["truth/depth/cam1.exr"]
    straight, bent = keypoints(plain, "cam1", 0), keypoints(folder, "cam1", 0)
    view = cameras_of(plain)["cam1"]
    for a, b in zip(straight, bent):
        both = (a[:, 2] > 0) & (b[:, 2] > 0)
        rays = (a[both, :2] + 0.5 - view.principal_px) / view.focal_px[0]
        expected = rays * (1 - 0.12 * (rays**2).sum(1, keepdims=True)) * view.focal_px[0] + view.principal_px
        assert b[both, :2] + 0.5 == pytest.approx(expected, abs=2e-3)


def test_sync_offset_moves_the_people_of_training_cameras(tmp_path: Path, body: BodyModel):
    folder = film(tmp_path, frames=2, faults={"sync_offset_frames": 0.8})
    offsets = json.loads((folder / "truth" / "truth.json").read_text())["sync_offsets_frames"]
    assert offsets["view1"] == 0
    assert max(abs(v) for v in offsets.values()) > 0.1
    d, view = read_description(folder / "studio.yaml"), cameras_of(folder)["cam1"]
    times = (np.arange(2) + offsets["cam1"]) / d.fps
    betas = performance.random_betas(3, 0)
    poses, trans = performance.perform(performance.PARTS[0], body, betas, times)
    truth, _ = view.project(body.keypoints(LAYOUTS["body_25"].keypoints, poses, betas, trans)[0])
    errors = [np.abs(k[k[:, 2] > 0, :2] + 0.5 - truth[k[:, 2] > 0]).max() for k in keypoints(folder, "cam1", 0)]
    assert min(errors) < 1e-3


def test_noise_changes_pictures_by_its_standard_deviation(plain: Path, tmp_path: Path):
    folder = film(tmp_path, faults={"noise_levels": 6.0}, crf=0)
    before, after = (video(f / "dataset" / "videos" / "cam1.mp4").mean(-1) for f in (plain, folder))
    assert 1.5 < np.std(after - before) < 6.0  # the mean of three channels has 1/√3 of it, chroma is filtered
    assert digests(folder)["truth/frames/view1.mkv"] == digests(plain)["truth/frames/view1.mkv"]


@pytest.mark.parametrize(
    ("effect", "value"),
    [
        ("moving_shadows", True),
        ("contact_shading", 1.0),
        ("glossy_floor", 0.8),
        ("changing_light", 0.3),
        ("ball", True),
        ("stick", True),
    ],
)
def test_each_effect_changes_the_pictures_where_it_should(
    plain: Path, tmp_path: Path, effect: str, value: float | bool
):
    folder = film(tmp_path, effects={effect: value})
    before, after = (
        read_stack(f / "truth" / "frames" / "view1.mkv").astype(np.float64).mean(-1) for f in (plain, folder)
    )
    people = read_stack(plain / "truth" / "masks" / "view1.mkv")
    change = after - before
    outside = np.stack([cv2.dilate(m, np.ones((3, 3), np.uint8)) == 0 for m in people])
    if effect in ("moving_shadows", "contact_shading"):
        assert change[outside].min() < -4
        assert change[outside].max() <= 1
        assert (change[outside] == 0).mean() > 0.5
    elif effect == "changing_light":
        light = [takes.lamp_swing(read_description(folder / "studio.yaml"), k / 30) for k in range(3)]
        dark = outside & (before < 200) & (before > 20)
        for k in range(3):
            assert (after[k][dark[k]] / before[k][dark[k]]).mean() == pytest.approx(light[k] ** (1 / 2.2), abs=0.02)
    elif effect == "glossy_floor":
        floor = np.zeros(people.shape[1:], bool)
        floor[people.shape[1] * 2 // 3 :] = True
        assert np.abs(change[:, floor]).mean() > 1
        assert np.abs(change[:, :10]).mean() < 0.5
    else:
        props = np.stack(
            [read_stack(folder / "truth" / "masks" / f"{n}.mkv") == 255 for n in ("cam1", "cam2", "view1")]
        )
        assert props.any()
        assert (change[~props[2] & outside] == 0).mean() > 0.97


def test_clean_plates_are_the_empty_room(plain: Path, tmp_path: Path):
    assert not (plain / "dataset" / "plates").exists()
    folder = film(tmp_path, frames=1, plates=True)
    assert set(open_dataset(folder / "dataset").plates) == {"cam1", "cam2", "cam3"}
    given, true = (cv2.imread(str(folder / f)) for f in ("dataset/plates/cam1.png", "truth/plates/cam1.png"))
    assert np.array_equal(given, true)


def test_moving_fingers_are_in_the_truth_and_in_the_keypoints(tmp_path: Path, body: BodyModel):
    folder = film(tmp_path, frames=3, hands=True, people=1)
    person, lens = read_person(folder / "truth/bodies/p0.npz"), cameras_of(folder)["cam1"]
    skeleton, poses = posed_skeleton(person, body)
    assert np.abs(skeleton.joints(poses, person.betas, person.trans)[:, 24:] - person.hand_joints).max() < 1e-9
    assert np.abs(np.diff(person.hand_poses, axis=0)).max() > 0.005
    points = skeleton.keypoints(HAND_POINT_NAMES[0], poses, person.betas, person.trans)
    true = np.load(folder / "truth/hands/cam1.npz")["points"][1, 0]
    assert np.abs(lens.project(points[1])[0] - true[0, :, :2]).max() < 1e-3
    entry = json.loads((folder / f"dataset/keypoints/cam1/cam1_{1:012d}_keypoints.json").read_text())["people"][0]
    written = np.array(entry["hand_left_keypoints_2d"]).reshape(21, 3)
    there = written[:, 2] > 0
    assert there.any()
    assert np.abs(written[there, :2] + 0.5 - true[0, there, :2]).max() < 1e-3


def detected(description: Path, frames: int, body: BodyModel) -> dict[tuple[int, int], list[np.ndarray]]:
    """(camera, frame) → people as the detector reports them, without taking any picture."""
    d = read_description(description)
    troupe = Actors(d, body, np.arange(frames) / 10)
    solids = build_room(d.seed, 0.0)
    points = troupe.keypoints_m(LAYOUTS["body_25"].keypoints)
    found = {}
    for number, lens in enumerate(rig.true_lenses(d, rig.cameras(d))[:3]):
        rng = np.random.default_rng(number)
        for frame in range(frames):
            tracer = Tracer(solids + troupe.at(frame)[0])
            found[number, frame] = detect(points[frame], lens, tracer, len(solids), d.detections, rng)
    return found


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, body: BodyModel) -> dict[tuple[int, int], list[np.ndarray]]:
    return detected(described(tmp_path_factory.mktemp("clean"), size=[480, 272]), 12, body)


def test_detections_carry_noise_drop_outs_phantoms_and_shuffled_order(tmp_path: Path, body: BodyModel, clean: dict):
    options = {"noise_px": 2.0, "drop_outs": 0.2, "false_positives": 1.0, "shuffled": True}
    noisy = detected(described(tmp_path, detections=options, size=[480, 272]), 12, body)
    shifts, kept, orders, phantoms = [], [], set(), 0
    for key, people in noisy.items():
        order = []
        for person in people:
            present = person[:, 2] > 0
            gaps = [np.median(np.abs(person[:, :2] - t[:, :2])[present & (t[:, 2] > 0.5)]) for t in clean[key]]
            match = int(np.argmin(gaps))
            if gaps[match] > 6:
                phantoms += 1
                continue
            order.append(match)
            both = present & (clean[key][match][:, 2] > 0.4)
            shifts.append((person - clean[key][match])[both, :2])
            kept.append(present[clean[key][match][:, 2] > 0.4])
        orders.add(tuple(order))
    assert np.concatenate(shifts).std() == pytest.approx(2.0, rel=0.15)
    assert np.concatenate(kept).mean() == pytest.approx(0.8, abs=0.05)
    assert phantoms >= 30
    assert {(0, 1), (1, 0)} <= orders
    assert {len(people) for people in clean.values()} == {2}


def test_points_behind_somebody_else_are_unsure_or_missing(tmp_path: Path, body: BodyModel, clean: dict):
    d = read_description(described(tmp_path, size=[480, 272]))
    troupe = Actors(d, body, np.arange(12) / 10)
    points = troupe.keypoints_m(LAYOUTS["body_25"].keypoints)
    hidden, confidences = 0, []
    for (number, frame), people in clean.items():
        camera = rig.cameras(d)[number]
        moving = troupe.at(frame)[0]
        for own, other in ((0, 1), (1, 0)):
            towards = points[frame, own] - camera.centre_m
            hits = Tracer([moving[other]]).cast(camera.centre_m, towards)
            pixels = camera.project(points[frame, own])[0]
            for point in np.flatnonzero(hits.is_hit & (hits.distance < 0.98)):
                hidden += 1
                near = [
                    p[point, 2] for p in people if p[point, 2] > 0 and np.abs(p[point, :2] - pixels[point]).max() < 1e-6
                ]
                confidences += near
    assert hidden > 30
    assert max(confidences) < 0.3
    assert 0.2 * hidden < len(confidences) < 0.8 * hidden


# ---- calibration ----


@pytest.mark.parametrize("form", CALIBRATION_FILES)
def test_calibration_is_read_back_exactly_in_every_format(tmp_path: Path, form: str):
    d = read_description(described(tmp_path, faults={"radial_distortion": -0.05}))
    lenses = rig.true_lenses(d, rig.cameras(d))
    for name, text in calibration_texts(form, lenses).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = {
        c.name.split("/")[-1].split(".")[0]: c
        for c in read_calibration([tmp_path / n for n in CALIBRATION_FILES[form]]).cameras
    }
    for lens in lenses:
        read = found[lens.name]
        assert read.wh == lens.wh
        np.testing.assert_allclose(read.intrinsics, lens.intrinsics, atol=1e-9)
        np.testing.assert_allclose(read.camera_from_world, lens.camera_from_world, atol=1e-9)
        np.testing.assert_allclose(read.distortion[:4], lens.distortion[:4], atol=1e-12)


def test_perturbed_calibration_is_off_by_the_requested_error_and_only_for_training_cameras(tmp_path: Path):
    d = read_description(
        described(
            tmp_path,
            cameras={"training": 8, "held_out": 2},
            calibration={"rotation_error_deg": 0.5, "position_error_m": 0.02},
        )
    )
    true = rig.true_lenses(d, rig.cameras(d))
    reported = rig.calibrated_lenses(d, true)
    angles, shifts = [], []
    for a, b in zip(true, reported):
        relative = a.camera_from_world[:3, :3] @ b.camera_from_world[:3, :3].T
        angles.append(np.degrees(np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1))))
        centres = [-x.camera_from_world[:3, :3].T @ x.camera_from_world[:3, 3] for x in (a, b)]
        shifts.append(np.linalg.norm(centres[0] - centres[1]))
    assert np.sqrt(np.mean(np.square(angles[:8])) / 3) == pytest.approx(0.5, rel=0.4)
    assert np.sqrt(np.mean(np.square(shifts[:8])) / 3) == pytest.approx(0.02, rel=0.4)
    assert reported[8:] == true[8:]


# ---- the description ----


def test_defaults_are_the_only_place_of_options_and_complete(root: Path):
    for name in ("demo", "tiny", "empty", "defaults"):
        read_description(root / "resources" / "studio" / f"{name}.yaml")
    comments = [line for line in DEFAULTS.read_text().splitlines() if ":" in line and not line.startswith("#")]
    assert all("#" in line or line.endswith(":") for line in comments), "every option is explained"


def test_a_folder_the_studio_did_not_fill_is_left_alone(tmp_path: Path):
    keep = tmp_path / "dataset" / "videos" / "mine.mp4"
    keep.parent.mkdir(parents=True)
    keep.write_bytes(b"mine")
    with pytest.raises(UserError, match="did not make"):
        capture.run(described(tmp_path), tmp_path / "dataset", tmp_path / "truth", processes=1)
    assert keep.read_bytes() == b"mine"


def test_a_new_description_leaves_nothing_of_the_old_capture(tmp_path: Path):
    folder = film(tmp_path, frames=1, supersampling=1, people=1, calibration={"format": "colmap"})
    # As a workflow does before it runs a step again: what it knows of is gone, the rest is not.
    (folder / "dataset" / "capture.yaml").unlink()
    (folder / "truth" / "truth.json").unlink()
    film(tmp_path, frames=1, people=0, cameras={"held_out": 0})
    left = {str(p.relative_to(folder / "dataset")) for p in (folder / "dataset").rglob("*") if p.is_file()}
    assert left == {
        ".synthetic-studio",
        "capture.yaml",
        "intri.yml",
        "extri.yml",
        *(f"videos/cam{k}.mp4" for k in (1, 2, 3)),
    }


def test_cameras_filmed_together_show_what_each_would_show_alone(tmp_path: Path):
    """Cameras of one clock share people and ray caster; the others have takes of their own. No byte depends on it."""
    options = {"frames": 2, "people": 1, "faults": {"sync_offset_frames": 2.0}, "cameras": {"held_out": 2}}
    description = described(tmp_path, **options)
    read = read_description(description)
    lenses = rig.true_lenses(read, rig.cameras(read))
    assert [[lens.name for lens in take] for take in takes.share_takes(read, lenses, 1)] == [
        ["view1", "view2"],
        ["cam1"],
        ["cam2"],
        ["cam3"],
    ]
    files = []
    for processes in (1, 5):  # of five, every camera has a take of its own
        folder = tmp_path / str(processes)
        capture.run(description, folder / "dataset", folder / "truth", processes=processes)
        files.append({str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()})
    assert len(takes.share_takes(read, lenses, 5)) == 5
    assert files[0] == files[1]
    assert "truth/frames/view2.mkv" in files[0]


def test_planning_a_capture_needs_no_array_library(root: Path):
    import subprocess

    code = (
        "import sys; from pathlib import Path; from studiorecon.studio.description "
        "import read_description, planned_dataset; "
        "planned_dataset(read_description(Path('resources/studio/demo.yaml')), Path('d'), Path('t')); "
        "assert not {'numpy', 'embreex', 'cv2'} & set(sys.modules), 'heavy'"
    )
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True)
