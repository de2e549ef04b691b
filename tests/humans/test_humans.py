# SPDX-License-Identifier: Apache-2.0
"""humans: verdicts on pixels, colours, refined motion, and a whole training of a made person."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import strongest_weights
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.geometry.statistics import Estimate
from studiorecon.humans import rest_pose, train
from studiorecon.humans.crops import (
    IGNORED,
    OUTSIDE,
    PERSON,
    TrainingCrop,
    box_around,
    classify_crops,
    classify_pixels,
    crop_camera,
    mask_inset_px,
    silhouette,
)
from studiorecon.humans.refined_motion import RefinedMotion
from studiorecon.humans.surface_samples import (
    fill_unseen,
    gaussians_on,
    mirror_indices,
    sample_surface,
    surface_neighbours,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import from_entry
from studiorecon.scene.factors import write_factors
from studiorecon.scene.people import Person
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.scene.user_files import read_npz

from tests.made.gaussians import rasterise
from tests.made.humans import FRAMES, WH, Made, body, made, motion_of, score  # noqa: F401
from tests.made.scene import refilmed, ring
from tests.made.steps import call


@pytest.fixture
def settings(default_settings: Callable) -> Callable[..., train.Settings]:
    def load(pose_rad: float = 0.0, **replaced: object) -> train.Settings:
        section = copy.deepcopy(default_settings("humans", **({"iterations": 150, "gaussians": 3000} | replaced)))
        section["rates"]["pose_rad"] = pose_rad
        return settings_module.load(train.Settings, section, "humans")

    return load


def test_a_person_is_recognisable_from_where_no_camera_was(
    made: Made, body: BodyModel, settings: Callable, tmp_path: Path
) -> None:
    between = ring([45, 200], "view", wh=WH)
    call(
        train.run,
        settings(iterations=300),
        **made.options,
        gaussians=tmp_path / "p3.ply",
        avatar=tmp_path / "p3.npz",
        working=tmp_path / "working",
    )
    trained = score(made, body, tmp_path, between)
    (tmp_path / "start").mkdir()
    call(
        train.run,
        settings(iterations=1),
        **made.options,
        gaussians=tmp_path / "start/p3.ply",
        avatar=tmp_path / "start/p3.npz",
        working=tmp_path / "start",
    )
    started = score(made, body, tmp_path / "start", between)
    assert trained > 27
    assert trained > started + 1.5
    written = read_avatar(tmp_path / "p3.ply", tmp_path / "p3.npz", body)
    assert set(np.unique(written.provenance)) <= {MEASURED, INFERRED}
    assert 0.7 < written.seen_share < 1
    # The wall is yellow-green; nothing of the person is, and the picture outside the silhouette stays empty.
    truth, shown = (rasterise(one.posed(2), between[0], near_m=0.05) for one in (made, written))
    assert shown.alpha[truth.alpha < 0.02].mean() < 0.02
    assert shown.alpha[truth.alpha > 0.98].mean() > 0.97
    # No needles, no blankets: every standard deviation stays within the limits.
    limits = settings().limits
    assert np.ptp(written.gaussians.log_scales) <= np.log(limits.largest / limits.smallest) + 1e-5


def test_refinement_on_pictures_brings_wrong_poses_nearer(
    made: Made, body: BodyModel, settings: Callable, tmp_path: Path
) -> None:
    wrong = made.person.poses.copy()
    limbs = [1, 2, 4, 5, 16, 17, 18, 19]
    noise = np.random.default_rng(3).normal(0, 0.08, (FRAMES, 24, 3))
    wrong.reshape(FRAMES, 24, 3)[:, limbs] += noise[:, limbs]
    person = Person(**{**made.person.__dict__, "poses": wrong})
    write_person(tmp_path / "wrong/p3.npz", person)
    options = made.options | {"fit": tmp_path / "wrong/p3.npz"}
    call(
        train.run,
        settings(pose_rad=2e-3, iterations=500, pose_from=100),
        **options,
        gaussians=tmp_path / "p3.ply",
        avatar=tmp_path / "p3.npz",
        working=tmp_path / "working",
    )
    refined = read_avatar(tmp_path / "p3.ply", tmp_path / "p3.npz", body)

    def joint_error_m(poses: np.ndarray, trans: np.ndarray) -> float:
        return float(
            np.linalg.norm(body.joints(poses, np.zeros(10), trans) - made.person.joints, axis=-1)[
                :, [4, 5, 7, 8, 18, 19, 20, 21]
            ].mean()
        )

    before, after = joint_error_m(wrong, made.person.trans), joint_error_m(refined.poses, refined.trans)
    assert after < 0.8 * before


def test_refusals_name_the_person_and_the_remedy(made: Made, settings: Callable, tmp_path: Path) -> None:
    out = {"gaussians": tmp_path / "x.ply", "avatar": tmp_path / "x.npz", "working": tmp_path / "working"}
    with pytest.raises(UserError, match="p7 is not among the people"):
        call(train.run, settings(), **(made.options | {"person": "p7"}), **out)
    with pytest.raises(UserError, match="no training camera shows 60 pixels of p0"):
        call(train.run, settings(), **(made.options | {"person": "p0"}), **out)
    with pytest.raises(UserError, match="3 masks for 4 training cameras"):
        call(train.run, settings(), **(made.options | {"masks": made.options["masks"][:3]}), **out)


def test_verdicts() -> None:
    labels = np.zeros((40, 40), np.uint8)
    labels[10:30, 10:30] = 1
    labels[10:30, 30:34] = 2
    labels[2:5, 2:5] = 255
    labels[18:22, 18:22] = 0  # a lamp before the chest
    body = np.zeros((40, 40), bool)
    body[8:32, 8:32] = True
    verdict = classify_pixels(labels, body, 1, edge_px=1, occluder_px=6)
    assert verdict[15, 15] == PERSON
    assert verdict[20, 20] == IGNORED  # furniture before the person is not a hole in them
    assert verdict[20, 32] == IGNORED  # somebody else
    assert verdict[3, 3] == IGNORED  # nobody in particular
    assert verdict[10, 20] == verdict[9, 20] == IGNORED  # the seam, on both sides
    assert verdict[36, 36] == OUTSIDE
    assert verdict[8, 20] == OUTSIDE  # the silhouette's rim is not certain enough to excuse a missing mask


def test_a_mask_cut_by_the_frame_has_no_seam_there() -> None:
    labels = np.zeros((20, 20), np.uint8)
    labels[10:, 5:15] = 1
    assert classify_pixels(labels, labels > 0, 1, 1, 3)[19, 10] == PERSON


def test_crops_keep_pixels_in_place(body: BodyModel) -> None:
    camera = ring([30], "c", wh=WH)[0]
    point = np.array([[0.1, -0.2, 1.1]])
    box = box_around(camera.project(point)[0], np.zeros(camera.hw, bool), camera.wh, 8)
    left, top, right, bottom = box
    small = crop_camera(camera, box)
    assert small.wh == (right - left, bottom - top)
    assert np.allclose(small.project(point)[0] + [left, top], camera.project(point)[0])
    assert box_around(np.full((3, 2), np.nan), np.zeros(camera.hw, bool), camera.wh, 8) is None
    assert not silhouette(np.full((3, 2), np.nan), camera.hw).any()
    # A vertex next to the camera projects a long way off; the gaps that are closed stay in proportion to the picture.
    torso = np.stack(np.meshgrid(np.arange(10, 20), np.arange(10, 20)), axis=-1).reshape(-1, 2).astype(float)
    with_knee = silhouette(np.concatenate([torso, [[3e7, -2e7]]]), (40, 40))
    assert np.count_nonzero(with_knee) == len(torso)


def test_unseen_colours_come_from_the_other_side_or_from_beside(body: BodyModel) -> None:
    samples = sample_surface(body.rest_vertices(np.zeros(10)), body.faces, body.weights, 3000, np.random.default_rng(0))
    near, twin = surface_neighbours(samples, 8), mirror_indices(samples, 2 * samples.spacing_m)
    truth = 0.5 + 0.4 * np.sin(3 * samples.points_m[:, 1:2] + np.array([0, 1, 2]))  # symmetric bands
    left_hand = samples.points_m[:, 0] > 0.5
    filled = fill_unseen(np.where(left_hand[:, None], 0.0, truth), ~left_hand, near, twin)
    assert np.abs(filled - truth)[left_hand].mean() < 0.1
    both = np.abs(samples.points_m[:, 0]) > 0.6
    beside = fill_unseen(np.where(both[:, None], 0.0, truth), ~both, near, twin)
    assert np.abs(beside - truth)[both].mean() < 0.2
    nothing = np.zeros(len(truth), bool)
    assert np.array_equal(fill_unseen(truth, nothing, near, twin), truth)


def test_samples_lie_evenly_on_the_surface(body: BodyModel) -> None:
    rest = body.rest_vertices(np.zeros(10))
    samples = sample_surface(rest, body.faces, body.weights, 4000, np.random.default_rng(0))
    areas = np.linalg.norm(np.cross(*(rest[body.faces[:, k]] - rest[body.faces[:, 0]] for k in (1, 2))), axis=1) / 2
    centres = rest[body.faces].mean(axis=1)
    for half in (0, 1, 2):
        share = areas[centres[:, half] > 0].sum() / areas.sum()
        assert np.mean(samples.points_m[:, half] > 0) == pytest.approx(share, abs=0.01)
    assert np.allclose(samples.weights.sum(axis=1), 1)


def test_the_gradient_by_joint_turns_matches_differences(body: BodyModel) -> None:
    rng = np.random.default_rng(2)
    poses, trans = motion_of(body)
    samples = sample_surface(body.rest_vertices(np.zeros(10)), body.faces, body.weights, 400, rng)
    posing = Posing(*strongest_weights(samples.weights, 4))
    own = gaussians_on(samples, 0)
    pull = rng.normal(size=own.means_m.shape)

    def moving() -> RefinedMotion:
        return RefinedMotion(poses, trans, body.rest_joints(np.zeros(10)), body.parents)

    def value(motion: RefinedMotion) -> float:
        return float(
            (posing.out(own.means_m.astype(float), own.quaternions, own.sh, motion.transforms(1))[0] * pull).sum()
        )

    motion = moving()
    posing.out(own.means_m, own.quaternions, own.sh, motion.transforms(1))
    gradient = motion.gradient(1, *posing.wrenches(own.means_m, pull, motion.transforms(1)))
    for joint, axis in ((0, 0), (0, 2), (4, 0), (16, 2), (18, 1), (24, 1)):
        values = []
        for step in (1e-5, -1e-5):
            turned = moving()
            if joint < 24:
                turned.local[1, joint] = rotations.exp(step * np.eye(3)[axis]) @ turned.local[1, joint]
            else:
                turned.trans_m[1, axis] += step
            values.append(value(turned))
        assert (values[0] - values[1]) / 2e-5 == pytest.approx(
            gradient[joint, axis], rel=1e-4, abs=1e-4 * np.abs(gradient).max()
        )


def test_smoothness_pulls_a_jerk_back_and_leaves_a_held_pose_alone(body: BodyModel) -> None:
    poses = np.zeros((3, 72))
    still = RefinedMotion(poses, np.zeros((3, 3)), body.rest_joints(np.zeros(10)), body.parents)
    assert np.all(still.smoothness_gradient(1, 50.0) == 0)
    poses[1, 4 * 3] = 0.2
    jerk = RefinedMotion(poses, np.zeros((3, 3)), body.rest_joints(np.zeros(10)), body.parents)
    jerk.step(1, jerk.smoothness_gradient(1, 50.0), 0.05)
    assert jerk.poses[1, 12] == pytest.approx(0.15, abs=1e-6)


def test_a_turning_body_shows_four_cameras_more_sides_than_one_that_stands_still(
    settings: Callable[..., train.Settings],
) -> None:
    """Degree 2 needs nine directions (G15); what counts are those in the body's own frame."""
    requested, frames = settings(sh_degree=2), 12
    cameras = [
        SimpleNamespace(centre_m=np.array([3 * np.cos(a), 3 * np.sin(a), 1.5])) for a in np.pi / 2 * np.arange(4)
    ]
    crops = [SimpleNamespace(frame=frame, camera=camera) for frame in range(frames) for camera in cameras]
    for turn_rad, degree in ((0.0, 1), (0.2, 2)):
        poses = np.zeros((frames, 72))
        poses[:, 2] = turn_rad * np.arange(frames)
        motion = RefinedMotion(poses, np.zeros((frames, 3)), np.zeros((24, 3)), np.r_[-1, np.arange(23)])
        assert rest_pose.supported_degree(requested, motion, crops) == degree
        assert rest_pose.supported_degree(replace(requested, limit_sh_to_views=False), motion, crops) == 2


@pytest.mark.parametrize(("cut_px", "expected"), [(-2, (0, 0)), (0, (0, 0)), (1, (0, 2)), (2, (2, 3)), (5, (5, 6))])
def test_masks_cut_too_small_are_measured_and_teach_no_hole(cut_px: int, expected: tuple[int, int]) -> None:
    """Ten looks at a disc; two of them half hidden by furniture, which bends an outline but is no cut."""
    rows, columns = np.mgrid[:80, :80]
    away = np.hypot(rows - 40, columns - 40)
    looks = []
    for frame in range(10):
        labels = (away < 25 - cut_px).astype(np.uint8)
        if frame < 2:
            labels[45:] = 0
        looks.append(
            TrainingCrop(
                frame,
                0,
                Camera("c", (80, 80), np.eye(3), np.eye(4)),
                np.zeros((80, 80, 3), np.uint8),
                labels,
                away < 25,
            )
        )
    inset = mask_inset_px(looks, 1)
    assert expected[0] <= inset <= expected[1]
    crop = list(classify_crops(looks, 1, 1, 12, inset))[-1]
    hidden = (away < 25) & (away >= 25 - cut_px)
    if inset:
        assert (crop.verdict[hidden] != OUTSIDE).all()  # taken for background it would be carved away
        assert (crop.verdict[away < 22.5] == PERSON).all()  # but for the seam
    assert (crop.verdict[away > 30] == OUTSIDE).all()


def test_a_limb_that_a_cut_took_away_wholly_is_the_person_and_one_behind_furniture_is_not() -> None:
    """An arm 8 px thick beside a trunk of 40 px: masks cut by 5 px lose it; a mask that fits and lacks it says that
    something hides it."""
    body = np.zeros((80, 80), bool)
    body[10:70, 10:50] = True
    arm = np.zeros_like(body)
    arm[30:38, 50:75] = True
    body |= arm
    small = cv2.erode(body.astype(np.uint8), np.ones((11, 11), np.uint8))
    assert not small[arm].any()
    verdict = classify_pixels(small, body, 1, 1, 12, 5)
    assert (verdict[32:36, 52:73] == PERSON).all()
    assert (verdict[~cv2.dilate(body.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)] == OUTSIDE).all()
    furniture = (body & ~arm).astype(np.uint8)
    assert not (classify_pixels(furniture, body, 1, 1, 12, 0)[arm] == PERSON).any()
    other = small + 2 * arm.astype(np.uint8)
    assert (classify_pixels(other, body, 1, 1, 12, 5)[32:36, 52:73] == IGNORED).all(), "somebody else stands there"


def test_people_are_trained_in_one_light(made: Made, body: BodyModel, settings: Callable, tmp_path: Path) -> None:
    """Divided out, a person is within 0.3 dB of one filmed without a light that goes down by a quarter."""

    def trained(name: str, **changes: object) -> float:
        folder = tmp_path / name
        folder.mkdir()
        written = {"gaussians": folder / "p3.ply", "avatar": folder / "p3.npz", "working": folder / "working"}
        call(train.run, settings(), **(made.options | changes), **written)
        return score(made, body, folder, ring([45, 200], "view", wh=WH))

    plain = trained("plain")
    course = np.linspace(1, 0.75, FRAMES)[:, None].repeat(3, axis=1)
    write_factors(tmp_path / "light.json", {f"cam{k}": course for k in range(4)})
    videos = refilmed(made.options["videos"], tmp_path / "filmed", [course] * 4)
    divided = trained("divided", videos=videos, exposure=[tmp_path / "light.json"])
    assert divided > plain - 0.3
    assert trained("left", videos=videos) < divided - 3.0


def test_the_threshold_of_the_settings_decides_on_the_network(
    made: Made, settings: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six frames are too few to see colours drift: how much they do is given, how it is decided is asked."""
    monkeypatch.setattr(train, "drifting_share", lambda residual: Estimate(0.3, (0.29, 0.31)))
    runs = {"default": ({}, "on"), "higher": ({"temporal_appearance": 0.4}, "off")}
    for name, (thresholds, verdict) in runs.items():
        folder = tmp_path / name
        folder.mkdir()
        temporal = {"use": "auto", "start": 2, "width": 8, "points": 64}
        call(
            train.run,
            replace(settings(iterations=4, gaussians=400, temporal=temporal), thresholds=thresholds),
            **made.options,
            gaussians=folder / "p3.ply",
            avatar=folder / "p3.npz",
            working=folder / "working",
        )
        written = read_npz(folder / "p3.npz")
        decision = from_entry(json.loads(str(written["decision"])))
        assert decision.verdict == verdict, (name, decision)
        assert ("network" in " ".join(written)) == (verdict == "on"), sorted(written)
