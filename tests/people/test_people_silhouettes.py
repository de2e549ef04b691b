# SPDX-License-Identifier: Apache-2.0
"""People without keypoints: hulls of human size, a body from exact silhouettes, and a made take whose second person was
not detected."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from studiorecon.body.fitting.basis import State
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.body.person_files import read_person
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.images.silhouette import mesh_depth
from studiorecon.people import fit
from studiorecon.people.silhouettes import hull, person_masks, tracking, upright
from studiorecon.people.silhouettes.contour import Silhouette, Targets
from studiorecon.people.silhouettes.foreground import FOREGROUND, UNKNOWN
from studiorecon.people.silhouettes.mask_video import FilmTargets, LabelFilm
from studiorecon.people.silhouettes.silhouette_people import SilhouettePerson, read_standing, write_standing
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera

from tests.made.people_fit import look

VOXEL_M, FPS = 0.05, 30.0


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return [look(f"cam{i}", azimuth).resized((320, 176)) for i, azimuth in enumerate((0, 85, 190, 265))]


@pytest.fixture(scope="module")
def options(default_settings) -> fit.Settings:
    return settings_module.load(fit.Settings, default_settings("people"), "people")


def poses_of(body: BodyModel, frames: int, heading_rad: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Somebody who takes a step and lifts a forearm: poses (T, 72) and pelvis (T, 3)."""
    swing = np.sin(2 * np.pi * 0.9 * np.arange(frames) / FPS)
    poses = np.zeros((frames, 24, 3))
    poses[:, 0] = upright_global_orientation(heading_rad)
    poses[:, 1, 0], poses[:, 2, 0] = -0.1 - 0.4 * swing, -0.1 + 0.4 * swing
    poses[:, 4, 0], poses[:, 5, 0] = 0.3 + 0.2 * swing, 0.3 - 0.2 * swing
    poses[:, 16, 2], poses[:, 17, 2], poses[:, 18, 1] = -1.1, 1.1, -0.6 - 0.3 * swing
    ahead = 0.5 * np.arange(frames) / FPS
    trans = np.stack([ahead * np.cos(heading_rad), ahead * np.sin(heading_rad), np.full(frames, 0.93)], axis=-1)
    return poses.reshape(frames, 72), trans


def silhouettes(body: BodyModel, cameras: list[Camera], pose: np.ndarray, place: np.ndarray) -> list[np.ndarray]:
    surface = body.vertices(pose[None], np.zeros(10), place[None])[0]
    return [(mesh_depth(surface, body.faces, c) > 0).astype(np.uint8) * np.uint8(FOREGROUND) for c in cameras]


class TestHull:
    @pytest.fixture
    def pictured(self, body: BodyModel, cameras: list[Camera]) -> list[np.ndarray]:
        poses, trans = poses_of(body, 1)
        return silhouettes(body, cameras, poses[0], trans[0])

    def people(self, cameras: list[Camera], pictured: list[np.ndarray], options: fit.Settings) -> list[hull.HullPart]:
        cells_m, shape = hull.watched_cells(cameras, VOXEL_M, 3)
        return [
            p
            for p in hull.parts(cells_m, shape, cameras, pictured, VOXEL_M)
            if hull.is_person(p, VOXEL_M, options.hull.limits)
        ]

    def test_somebody_stands_where_the_silhouettes_meet(self, cameras, pictured, options) -> None:
        (found,) = self.people(cameras, pictured, options)
        np.testing.assert_allclose(found.place_m, [0, 0], atol=0.1)
        assert found.seen_by.all()

    def test_whoever_only_two_cameras_show_is_nobody(self, cameras, pictured, options) -> None:
        unknown = np.full_like(pictured[0], UNKNOWN)
        assert self.people(cameras, [pictured[0], pictured[1], unknown, unknown], options) == []

    def test_one_camera_with_a_shirt_of_the_walls_colour_cannot_deny(self, cameras, pictured, options) -> None:
        blind = pictured[2].copy()
        rows = np.flatnonzero(blind.any(1))
        blind[rows[len(rows) // 4] : rows[len(rows) // 4] + 8] = 0
        (found,) = self.people(cameras, [*pictured[:2], blind, pictured[3]], options)
        (label,) = person_masks.silhouettes([found], [found.place_m], 2, cameras[2], blind, VOXEL_M)
        assert (label[blind > 0] == FOREGROUND).mean() > 0.85  # fingers are thinner than a cell
        assert (label[(pictured[2] > 0) & (blind == 0)] == UNKNOWN).mean() > 0.7

    def test_what_may_be_somebody_elses_is_unknown(self, body, cameras, options) -> None:
        """Two people in line: their silhouettes meet in a hull with arms of nobody, which each would otherwise wear."""
        poses, trans = poses_of(body, 1)
        places = [trans[0] + [0.9, 0.5, 0], trans[0] - [0.7, 0.5, 0]]
        alone = [silhouettes(body, cameras, poses[0], place) for place in places]
        both = [np.maximum(a, b) for a, b in zip(*alone)]
        found = sorted(self.people(cameras, both, options), key=lambda p: -p.place_m[0])
        assert len(found) == 2
        whole = [
            hull.whole_person(*hull.cells_around(p.place_m, VOXEL_M / 2), cameras, both, VOXEL_M / 2, p.place_m, 0.5)
            for p in found
        ]
        stolen, kept, worn = 0, 0, 0
        for v, camera in enumerate(cameras):
            pictured = person_masks.silhouettes(whole, [p.place_m for p in found], v, camera, both[v], VOXEL_M / 2)
            for k in (0, 1):
                (by_itself,) = person_masks.silhouettes([whole[k]], [found[k].place_m], v, camera, both[v], VOXEL_M / 2)
                others = (alone[k][v] == 0) & (alone[1 - k][v] > 0)
                worn += int(((by_itself == FOREGROUND) & others).sum())
                stolen += int(((pictured[k] == FOREGROUND) & others).sum())
                kept += int(((pictured[k] == FOREGROUND) & (alone[k][v] > 0)).sum())
        own = sum(int((a > 0).sum()) for views in alone for a in views)
        assert worn > 0.03 * own, "the case has ghosts"
        assert stolen < 0.3 * worn
        assert kept > 0.6 * own

    def test_people_whose_hulls_touch_are_told_apart(self, body, cameras, options) -> None:
        poses, trans = poses_of(body, 1)
        true_m = np.array([[0.25, -0.2], [-0.25, 0.2]])
        alone = [silhouettes(body, cameras, poses[0], np.append(place, trans[0, 2])) for place in true_m]
        both = [np.maximum(a, b) for a, b in zip(*alone)]
        cells_m, shape = hull.watched_cells(cameras, VOXEL_M, 3)
        plan = (hull._carved(cells_m, cameras, both)[2].reshape(shape).sum(2) * VOXEL_M >= 0.4).astype(np.uint8)
        assert cv2.connectedComponents(plan)[0] == 2, "the case has one part"
        found = sorted(self.people(cameras, both, options), key=lambda p: -p.place_m[0])
        np.testing.assert_allclose([p.place_m for p in found], true_m, atol=0.12)

    def test_a_person_with_an_arm_of_nobody_stands_where_the_person_does(self, cameras) -> None:
        cells_m = hull.watched_cells(cameras, VOXEL_M, 3)[0]
        trunk = np.linalg.norm(cells_m[:, :2] - [0.2, 0.1], axis=1) < 0.2
        arm = (
            (np.abs(cells_m[:, 1] - 0.1) < 0.12) & (cells_m[:, 0] > 0.2) & (cells_m[:, 0] < 1.4) & (cells_m[:, 2] > 0.6)
        )
        occupied = (trunk | arm) & (cells_m[:, 2] > 0) & (cells_m[:, 2] < 1.7)
        shown = np.tile(occupied[:, None], 4)
        part = hull._part(cells_m, shown, ~shown, occupied)
        np.testing.assert_allclose(part.place_m, [0.2, 0.1], atol=0.12)
        assert np.median(cells_m[occupied, 0]) > 0.4, "the case has an arm"

    def test_who_pass_each_other_keep_their_ways(self, options) -> None:
        """Two people meet and are one part for a moment, while a ghost appears beside them."""
        seen, cell = [], np.zeros((1, 3))
        for t in range(24):
            ways = [np.array([-1.2 + 0.1 * t, 0.1]), np.array([1.2 - 0.1 * t, -0.1])]
            if 11 <= t <= 13:
                ways = [np.array([0.0, 0.0])]
            if 9 <= t <= 14:
                ways = [np.array([0.0, -0.5]), *ways]
            seen.append((t, [hull.HullPart(place, cell, np.ones(4, bool), np.zeros((1, 4), bool)) for place in ways]))
        first, second = hull.tracks(seen, 12.0, options.hull.limits)
        np.testing.assert_allclose([first.places_m[-1], second.places_m[-1]], [[1.1, 0.1], [-1.1, -0.1]], atol=1e-9)

    def test_a_low_thing_is_nobody(self, cameras, pictured, options) -> None:
        sat = []
        for picture in pictured:
            rows = np.flatnonzero(picture.any(1))
            low = picture.copy()
            low[: rows[len(rows) * 6 // 10]] = 0
            sat.append(low)
        assert self.people(cameras, sat, options) == []

    def test_who_is_seen_for_a_moment_leaves_no_track(self, cameras, pictured, options) -> None:
        found = self.people(cameras, pictured, options)
        seen = [(3 * t, found if t < 4 else []) for t in range(10)]
        assert hull.tracks(seen, FPS, options.hull.limits) == []
        assert len(hull.tracks([(t, found) for t, _ in seen], FPS, options.hull.limits)) == 1


def test_a_body_follows_its_silhouettes_and_survives_its_file(
    body: BodyModel, cameras, options, tmp_path: Path
) -> None:
    frames = 12
    poses, trans = poses_of(body, frames)
    labels = [silhouettes(body, cameras, p, t) for p, t in zip(poses, trans)]
    film = LabelFilm(np.array([c.wh for c in cameras]), enumerate(labels))
    walk = upright.UprightWalk(FilmTargets(film), dict(enumerate(trans[:, :2])), FPS)
    surface = Silhouette(body, cameras, options.hull.contour)
    start = upright.shaped(surface, walk, upright.find(surface, walk, 0.0, 1.7))
    names = tuple(c.name for c in cameras)
    person = SilhouettePerson("p1", names, names, trans[:, :2], film, start)
    write_standing(tmp_path / "standing.npz", [person])
    (back,) = read_standing(tmp_path / "standing.npz")
    assert back.frames.tolist() == list(range(frames))
    assert all((a == b).all() for a, b in zip(back.labels[5], labels[5]))
    assert back.start.facing == start.facing
    fitted = fit.fit_standing(back, cameras, body, frames, FPS, options)
    error_mm = 1000 * np.linalg.norm(fitted.joints - body.joints(poses, np.zeros(10), trans), axis=-1)
    assert error_mm.mean() < 60
    assert fitted.valid.all()
    # Not surer than it is right, by more than a factor of two.
    assert error_mm.mean() < 2 * 1000 * np.sqrt(3) * fitted.sigma.mean()


def _arm_taken_away(body: BodyModel, cameras: list[Camera], picture: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Silhouettes of somebody with the left arm to the side, which ``picture`` does not show; (H, W) bool the arm in
    camera 0."""
    poses, trans = poses_of(body, 1)
    poses[0, 48:54] = 0.0
    poses[0, 54:57] = 0.0
    pictured = silhouettes(body, cameras, poses[0], trans[0])
    joints = body.joints(poses, np.zeros(10), trans)[0]
    arms = []
    for camera, label in zip(cameras, pictured):
        drawn = np.zeros(label.shape, np.uint8)
        shoulder, hand = camera.project(joints[[18, 22]])[0]
        cv2.line(drawn, tuple(int(x) for x in shoulder), tuple(int(x) for x in 1.3 * hand - 0.3 * shoulder), 1, 16)
        arms.append((drawn > 0) & (label > 0))
    pictured[picture] = np.where(arms[picture], np.uint8(0), pictured[picture])
    return pictured, arms[0]


def test_an_arm_that_cameras_miss_is_no_background_to_the_others(body: BodyModel, cameras, options) -> None:
    pictured, arm = _arm_taken_away(body, cameras, picture=1)
    other, _ = _arm_taken_away(body, cameras, picture=2)
    pictured[2] = other[2]
    cells_m, shape = hull.watched_cells(cameras, VOXEL_M, 3)
    (part,) = [
        p
        for p in hull.parts(cells_m, shape, cameras, pictured, VOXEL_M)
        if hull.is_person(p, VOXEL_M, options.hull.limits)
    ]
    # A shadow on the floor beside the feet hangs together with the silhouette as well.
    foot = cameras[0].project(np.array([part.place_m[0], part.place_m[1], 0.0]))[0].astype(int)
    rows, columns = np.flatnonzero(pictured[0].any(1)), np.flatnonzero(pictured[0][foot[1] - 2])
    shadow = np.zeros(pictured[0].shape, bool)
    shadow[rows.max() - 3 : rows.max() + 1, columns.max() : columns.max() + 25] = True
    pictured[0][shadow] = FOREGROUND
    (label,) = person_masks.silhouettes([part], [part.place_m], 0, cameras[0], pictured[0], VOXEL_M)
    # Without what is beside the hull the forearm would be background here: it is not inside it.
    carved = np.isfinite(person_masks._reach_m(part, part.place_m, cameras[0], VOXEL_M))
    assert carved[arm].mean() < 0.6, "the case has an arm outside the hull"
    assert (label[arm] == FOREGROUND).mean() > 0.9
    assert (label[shadow & ~carved] != FOREGROUND).all()


def test_one_arm_hangs_while_the_other_is_up(body: BodyModel, cameras, options) -> None:
    """The left hand is cut from all silhouettes and the forearm starts folded before the chest; the right arm is
    raised."""
    poses, trans = poses_of(body, 1)
    poses[0, 48:60] = [0, 0, -1.2, 0, 0, 0.3, 0, 0, 0, 0, 1.5, 0]
    pictured = silhouettes(body, cameras, poses[0], trans[0])
    joints = body.joints(poses, np.zeros(10), trans)[0]
    for camera, label in zip(cameras, pictured):
        wrist = camera.project(joints[[20]])[0][0]
        cv2.circle(label, tuple(int(x) for x in wrist), 5, int(UNKNOWN), cv2.FILLED)
    targets = Targets.of(pictured)
    surface = Silhouette(body, cameras, options.hull.contour)
    true = State(rotations.exp(poses.reshape(-1, 24, 3)), trans, np.zeros(10), 0.0, np.zeros((0, 3)))
    folded = true.local.copy()
    folded[0, 18] = rotations.exp(np.array([0.0, -2.3, 0.0]))
    start = State(folded, trans, np.zeros(10), 0.0, np.zeros((0, 3)))
    found = surface.joints(tracking.arms_settled(surface, targets, start))
    assert np.linalg.norm(surface.joints(start) - joints, axis=-1)[20] > 0.2
    assert np.linalg.norm(found - joints, axis=-1)[[18, 19, 20, 21]].max() < 0.12


def test_legs_that_start_exchanged_come_out_right(body: BodyModel, cameras, options) -> None:
    frames = 6
    poses, trans = poses_of(body, 4 * frames)
    poses, trans = poses[2::4], trans[2::4]
    film = LabelFilm(
        np.array([c.wh for c in cameras]), enumerate(silhouettes(body, cameras, p, t) for p, t in zip(poses, trans))
    )
    walk = upright.UprightWalk(FilmTargets(film), dict(enumerate(trans[:, :2])), FPS / 4)
    surface = Silhouette(body, cameras, options.hull.contour)
    true = State(rotations.exp(poses.reshape(-1, 24, 3)), trans, np.zeros(10), 0.0, np.zeros((0, 3)))
    first = tracking.legs_exchanged(true.at(np.arange(frames) == 2))

    def knees_off_mm(found: dict) -> np.ndarray:
        joints = np.stack([surface.joints(found[t][0]) for t in range(frames)])
        return 1000 * np.linalg.norm((joints - body.joints(poses, np.zeros(10), trans))[:, [4, 5, 7, 8]], axis=-1).mean(
            1
        )

    # Each frame by itself fits either way; one way alone keeps the start's.
    assert knees_off_mm(tracking.follow(surface, walk, 2, first, both_legs=False)).max() > 100
    assert knees_off_mm(tracking.follow(surface, walk, 2, first)).max() < 100


@pytest.mark.slow
def test_an_undetected_person_of_a_made_take_comes_out(root: Path, default_settings, tmp_path: Path) -> None:
    from studiorecon.studio import capture

    from tests.made.real_take import front_end_of

    described = {
        "seed": 5,
        "frames": 24,
        "fps": 12.0,
        "size": [480, 272],
        "people": 2,
        "plates": True,
        "cameras": {"held_out": 0},
        "detections": {"noise_px": 0.5},
    }
    (tmp_path / "take.yaml").write_text(yaml.safe_dump(described))
    capture.run(tmp_path / "take.yaml", tmp_path / "dataset", tmp_path / "truth", None, 1)
    for path in (tmp_path / "dataset" / "keypoints").glob("*/*.json"):
        recorded = json.loads(path.read_text())
        del recorded["people"][0]
        path.write_text(json.dumps(recorded))
    out = tmp_path / "out"
    assert front_end_of(open_dataset(tmp_path / "dataset"), root, out, default_settings)[0] == ["p0", "p1"]
    options = settings_module.load(fit.Settings, default_settings("people"), "people")
    files = [out / f"cam{i}.npz" for i in range(1, 5)]
    places = [], [out / "silhouettes/p1.npz"], [], root / "resources/body.npz", out / "p1.npz"
    fit.run(options, "p1", out / "model/images.txt", out / "manifest.json", files, *places)
    with np.load(tmp_path / "truth/bodies/p0.npz") as truth:
        error_mm = 1000 * np.linalg.norm(read_person(out / "p1.npz").joints - truth["joints"], axis=-1)
    assert error_mm.mean() < 60
