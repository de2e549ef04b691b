# SPDX-License-Identifier: Apache-2.0
"""One percent of what whole steps read is no number, or black, or white: they end, say how many, and keep the rest."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person, write_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.cameras import refine
from studiorecon.configuration import settings as settings_module
from studiorecon.depth import sweep
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.humans import train
from studiorecon.masks import segment
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import Person, write_detections
from studiorecon.splatting.train import state

from tests.made import room as made_room
from tests.made.cameras import detect, ring, walk
from tests.made.humans import WH as VIEW_WH
from tests.made.humans import Made, body, made, score
from tests.made.masks import Scene, scene, segmented
from tests.made.scene import ring as view_ring
from tests.made.steps import call

__all__ = ["body", "made", "scene"]

SHARE = 0.01
NUMBERS = pytest.mark.parametrize("fault", [np.nan, np.inf, 0.0], ids=["nan", "inf", "zero"])
FRAMES = 30


def iou(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union."""
    return (first & second).sum() / (first | second).sum()


def hit(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """One percent of the entries, at least one."""
    return np.random.default_rng(seed).permutation(int(np.prod(shape))).reshape(shape) < max(
        1, round(SHARE * np.prod(shape))
    )


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory, default_settings: Callable[..., dict]) -> Callable[[str], dict]:
    """``swept("black")``: what depth.sweep writes of a made room's first camera when one pixel in a hundred of every
    plate is black."""
    room, cameras = made_room.made_room(table=False), made_room.ring(3, wh=(96, 54))
    thin = {"sweep_width": 96, "wall_step_m": 0.2, "horizontal_step_m": 0.2, "reach_m": 5.0, "furniture_m": 0.5}
    options = settings_module.load(sweep.Settings, default_settings("depth", **thin), "depth")
    pictures = [made_room.photograph(room, camera)[0] for camera in cameras]

    def run(fault: str) -> dict:
        folder = tmp_path_factory.mktemp(fault)
        plates = made_room.write_capture(folder, cameras, pictures)
        for seed, path in enumerate(plates if fault != "clean" else []):
            stored, where = cv2.imread(str(path), cv2.IMREAD_UNCHANGED), hit(cameras[0].hw, seed)
            stored[where] = {"black": [0, 0, 0, 255], "white": [255, 255, 255, 255], "unmeasured": [255, 0, 255, 0]}[
                fault
            ]
            assert cv2.imwrite(str(path), stored)
        sweep.run(options, "cam1", folder / "cameras/images.txt", plates, folder / "sweep.npz")
        return dict(np.load(folder / "sweep.npz"))

    return run


@pytest.fixture(scope="module")
def clean_sweep(swept: Callable[[str], dict]) -> dict:
    return swept("clean")


@pytest.mark.parametrize("fault", ["black", "white", "unmeasured"])
def test_depth_sweep_finds_the_planes_of_the_rest(
    swept: Callable[[str], dict], clean_sweep: dict, fault: str, capsys: pytest.CaptureFixture
) -> None:
    found = swept(fault)
    assert "of the pixels match one of" in capsys.readouterr().out
    assert abs(float(found["floor_m"])) < 0.05
    np.testing.assert_allclose(found["gains"], clean_sweep["gains"], atol=0.02)
    # The yaw, and with it the catalogue, may differ by a step of the search; planes are compared by where they put a
    # pixel.
    turned = (np.degrees(found["yaw_rad"] - clean_sweep["yaw_rad"]) + 45) % 90 - 45
    assert abs(turned) < 2
    both = found["confident"] & clean_sweep["confident"]
    assert both.mean() > 0.6 * clean_sweep["confident"].mean()
    one, other = clean_sweep["planes"][clean_sweep["chosen"]], found["planes"][found["chosen"]]
    same = (np.abs((one[..., :3] * other[..., :3]).sum(-1)) > 0.99) & (np.abs(one[..., 3] - other[..., 3]) < 0.25)
    assert same[both].mean() > 0.9
    if fault == "unmeasured":  # the count: an unmeasured pixel finds no plane
        assert not found["confident"][hit((54, 96), 0)].any()


@NUMBERS
def test_cameras_are_refined_on_the_rest(tmp_path: Path, default_settings: Callable[..., dict], fault: float) -> None:
    truth = ring()
    people = [walk([-0.6, -0.5, 0], [0.02, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.02, 0], FRAMES, 2.0)]
    lenses = [Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)) for c in truth]
    write_json(tmp_path / "calibration.json", {"lenses": [lens.as_json() for lens in lenses], "floor_known": True})
    footage = tuple(
        Footage(c.name, False, c.wh, c.intrinsics.tolist(), 30.0, FRAMES, 0, "v", "", c.wh, 0, 0.0, []) for c in truth
    )
    write_manifest(tmp_path / "manifest.json", Manifest("x", 30.0, FRAMES, footage))
    paths, faults = [], 0
    for seed, clean in enumerate(detect(truth, people, 1.0, np.random.default_rng(0))):
        there = clean.keypoints[..., 2] > 0
        broken = there & hit(there.shape, seed)
        faults += int(broken.sum())
        paths.append(tmp_path / f"{clean.camera}.npz")
        write_detections(
            paths[-1], replace(clean, keypoints=np.where(broken[..., None], [fault, fault, 0.9], clean.keypoints))
        )
    assert faults > 30
    refine.run(
        settings_module.load(refine.Settings, default_settings("cameras"), "cameras"),
        tmp_path / "calibration.json",
        tmp_path / "manifest.json",
        paths,
        [],
        [],
        tmp_path / "m/images.txt",
        tmp_path / "m/heldout/images.txt",
        tmp_path / "refinement.json",
        tmp_path / "refinement.png",
    )
    report = read_json(tmp_path / "refinement.json")
    assert report["unusable_keypoints"] == faults
    assert report["after_px"] < 2.0
    for found, true in zip(read_model(tmp_path / "m"), truth):
        assert np.linalg.norm(found.centre_m - true.centre_m) < 0.005


def with_faults(person: Person, fault: float, frame: int) -> tuple[Person, np.ndarray]:
    """One number of the pose in a frame is the fault, and one of the position when it is not finite; the person, and
    (T,) which frame."""
    poses, trans = person.poses.copy(), person.trans.copy()
    poses[frame, 3 * 4], trans[frame, 1] = fault, fault if not np.isfinite(fault) else trans[frame, 1]
    return replace(person, poses=poses, trans=trans), np.arange(len(poses)) == frame


@NUMBERS
def test_a_body_s_bad_frames_are_said_and_count_as_not_measured(
    tmp_path: Path, scene: Scene, fault: float, capsys: pytest.CaptureFixture
) -> None:
    person, frames = with_faults(scene.people[0], fault, 3)
    write_person(tmp_path / "p0.npz", person)
    found = read_person(tmp_path / "p0.npz")
    finite = bool(np.isfinite(fault))
    assert ("p0.npz: 1 frames hold numbers that are not finite" in capsys.readouterr().out) == (not finite)
    np.testing.assert_array_equal(found.valid, scene.people[0].valid & (finite | ~frames))
    np.testing.assert_array_equal(found.poses[~frames], scene.people[0].poses[~frames])
    assert np.isfinite(found.poses).all()
    assert np.isfinite(found.trans).all()
    if not finite:
        write_person(tmp_path / "p0.npz", replace(person, betas=np.full(10, fault)))
        with pytest.raises(UserError, match="numbers of betas are not finite"):
            read_person(tmp_path / "p0.npz")


@NUMBERS
def test_masks_cut_out_the_rest(
    scene: Scene, default_settings: Callable[..., dict], fault: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """A hundredth of the film's pixels is black, and one number of every body is the fault."""
    settings = settings_module.load(segment.Settings, default_settings("masks"), "masks")
    frames, people = scene.frames.copy(), []
    frames[hit(frames.shape[:3], 0)] = 0
    struck = np.zeros(len(frames), bool)
    for k, person in enumerate(scene.people):
        broken, where = with_faults(person, fault, k + 1)
        struck |= where
        write_person(tmp_path / f"p{k}.npz", broken)
        people.append(read_person(tmp_path / f"p{k}.npz"))
    labels = segmented(scene, settings, frames=frames, people=people)
    assert ("not finite" in capsys.readouterr().out) == (not np.isfinite(fault))
    for k in range(2):
        assert iou(labels[~struck] == k + 1, scene.truth[~struck] == k + 1) > 0.85
        # Between its neighbours' places; a frame that was not measured speaks for nobody, so its outline is vague.
        assert iou(labels[struck] == k + 1, scene.truth[struck] == k + 1) > 0.5


@pytest.mark.parametrize("fault", [np.nan, 0.0], ids=["nan", "zero"])
def test_a_person_is_trained_on_the_rest(
    made: Made,
    body: BodyModel,
    default_settings: Callable[..., dict],
    tmp_path: Path,
    fault: float,
    capsys: pytest.CaptureFixture,
) -> None:
    """A hundredth of the film is black, a hundredth of the masks' pixels says somebody else, and one frame's pose holds
    the fault."""
    options = dict(made.options)
    for kind, value in (("videos", 0), ("masks", 1)):
        options[kind] = []
        for seed, path in enumerate(made.options[kind]):
            frames = read_stack(path)
            frames[hit(frames.shape[:3], seed)] = value
            options[kind].append(tmp_path / path.name)
            write_lossless(options[kind][-1], iter(frames), 30.0)
    person, struck = with_faults(made.person, fault, 4)
    write_person(tmp_path / "p3.npz", person)
    section = json.loads(json.dumps(default_settings("humans", iterations=100, gaussians=2000)))
    section["rates"]["pose_rad"] = 0.0
    settings = settings_module.load(train.Settings, section, "humans")
    between, scores = view_ring([45], "view", wh=VIEW_WH), []
    for name, given in (("clean", made.options), ("broken", {**options, "fit": tmp_path / "p3.npz"})):
        (tmp_path / name).mkdir()
        out = {"gaussians": tmp_path / name / "p3.ply", "avatar": tmp_path / name / "p3.npz"}
        call(train.run, settings, **given, **out, working=tmp_path / name)
        scores.append(score(made, body, tmp_path / name, between))
    assert ("1 frames hold numbers that are not finite" in capsys.readouterr().out) == (not np.isfinite(fault))
    written = read_avatar(tmp_path / "broken/p3.ply", tmp_path / "broken/p3.npz", body)
    assert state.finite(written.gaussians).all()
    np.testing.assert_array_equal(written.valid, made.person.valid & (np.isfinite(fault) | ~struck))
    assert scores[1] > scores[0] - 1.5
