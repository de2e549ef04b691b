# SPDX-License-Identifier: Apache-2.0
"""One percent of what stages read is black, a hole or no number: they end, say how many, and keep the rest."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.background import hole_filling as room
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person, write_person
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.depth import given, sweep
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.humans import train
from studiorecon.images.plate import temporal_modes
from studiorecon.images.transfer import Transfer, residual_source, transfer_residual
from studiorecon.masks import segment
from studiorecon.scene.people import Person
from studiorecon.scene.room import RoomBox
from studiorecon.splatting.seeds import seeds_from_depth
from studiorecon.splatting.train import state
from studiorecon.survey import coverage
from studiorecon.views import forward_warp

from tests.made import room as made_room
from tests.made.cameras import ring
from tests.made.humans import WH as VIEW_WH
from tests.made.humans import Made, body, made, score
from tests.made.masks import Scene, scene, segmented
from tests.made.scene import ring as view_ring
from tests.made.steps import call

__all__ = ["body", "made", "scene"]

NUMBERS = pytest.mark.parametrize("fault", [np.nan, np.inf, 0.0], ids=["nan", "inf", "zero"])
BOX = RoomBox(0.2, np.array([-5.0, -6.0, 0.0]), np.array([5.5, 6.5, 3.0]), np.ones(6, bool), np.ones(6))
VIEWS = [c.resized((160, 88)) for c in ring(4)]
KNOWN = np.ones(VIEWS[0].hw, bool)


def hit(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """One percent of the entries, at least one."""
    count = int(np.prod(shape))
    return np.random.default_rng(seed).permutation(count).reshape(shape) < max(1, round(0.01 * count))


def look(view) -> tuple[np.ndarray, np.ndarray]:
    """Smooth colours (H, W, 3) float32 and depth (H, W) float32 of the empty room."""
    origin, rays = view.rays()
    depth_m, _ = BOX.intersect(origin, rays)
    return (0.5 + 0.3 * np.sin(origin + rays * depth_m[..., None])).astype(np.float32), depth_m.astype(np.float32)


@NUMBERS
def test_a_depth_file_says_how_much_of_it_is_no_depth_and_keeps_the_rest(
    fault: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    clean = look(VIEWS[0])[1]
    bad, unsure = hit(clean.shape), hit(clean.shape, 1)
    write_depth(tmp_path / "a.exr", np.where(bad, fault, clean), np.where(unsure, fault, np.ones_like(clean)))
    depth, confidence = read_depth(tmp_path / "a.exr")
    np.testing.assert_array_equal(depth, np.where(bad, 0, clean))
    assert (confidence[unsure] == 0).all()
    said = capsys.readouterr().out
    assert (f"{bad.sum()} depths of {bad.size}" in said and f"{unsure.sum()} confidences" in said) == (fault != 0)
    write_model(tmp_path / "cameras", VIEWS)
    given.run(
        given.Settings(near_m=0.3), VIEWS[0].name, tmp_path / "cameras/images.txt", tmp_path / "a.exr",
        tmp_path / "out.exr",
    )  # fmt: skip
    made_m, sure = read_depth(tmp_path / "out.exr")
    np.testing.assert_array_equal(made_m, np.where(bad, 0, clean))
    assert (sure[bad] == 0).all()


def blended(rgb: np.ndarray, depth: np.ndarray) -> np.ndarray:
    seen = [forward_warp.warp_source(VIEWS[0], rgb, KNOWN, depth, 0.04)]
    found, kept, _ = forward_warp.blend_photos(ring(16)[1].resized((160, 88)), seen, 3, 0.02, 0.3)
    return np.where(kept[..., None] > 0, found, np.nan)


def painted(rgb: np.ndarray, depth: np.ndarray) -> np.ndarray:
    others = [look(view) for view in VIEWS[1:]]
    pictures, depths = [rgb, *(r for r, _ in others)], [depth, *(d for _, d in others)]
    faces = room.paint(BOX.rectangles, VIEWS, pictures, [KNOWN] * 4, depths, 0.5)
    return np.concatenate([np.where(face.seen[..., None], face.rgb, np.nan).reshape(-1, 3) for face in faces])


def surveyed(rgb: np.ndarray, depth: np.ndarray) -> np.ndarray:
    points = coverage.stage_points(VIEWS, 0.5, 2.0)
    return coverage.visible_points(points, VIEWS, [depth, *(look(view)[1] for view in VIEWS[1:])], 0.05).astype(float)


def seeded(rgb: np.ndarray, depth: np.ndarray) -> np.ndarray:
    cloud, at = seeds_from_depth(VIEWS[0], rgb, KNOWN, depth, 3, 0.6, 0.7, 1)
    found = np.full((*KNOWN.shape, 3), np.nan)
    found[tuple(np.asarray(at, int).T)] = cloud.means_m
    return found


def carried(rgb: np.ndarray, depth: np.ndarray) -> np.ndarray:
    transfer = Transfer(depth_tolerance=0.03, angle_power=4.0, feather_px=4.0, smooth_px=1.0)
    photo, render = (np.rint(255 * p).astype(np.uint8) for p in (rgb, 0.8 * rgb))
    clean = look(VIEWS[0])[1]
    found, cover = transfer_residual(
        VIEWS[0], depth, [residual_source(VIEWS[0], photo, render, clean, transfer)], transfer
    )
    return np.where((cover > 0).reshape(*cover.shape, *[1] * (found.ndim - cover.ndim)), found, np.nan)


@pytest.mark.parametrize("stage", [blended, painted, surveyed, seeded, carried])
def test_holes_of_a_depth_map_cost_their_own_places_alone(stage: Callable[..., np.ndarray]) -> None:
    rgb, clean = look(VIEWS[0])
    right, found = stage(rgb, clean), stage(rgb, np.where(hit(clean.shape), 0, clean).astype(np.float32))
    both = np.isfinite(right) & np.isfinite(found)
    assert both.sum() > 0.8 * np.isfinite(right).sum()
    assert np.quantile(np.abs(found - right)[both], 0.98) < 0.05


@pytest.mark.parametrize("fault", [0, 255], ids=["black", "white"])
def test_the_plate_outvotes_single_bad_values(fault: int) -> None:
    clean = np.clip(np.uint8(120) + np.random.default_rng(0).integers(-2, 3, (20, 24, 32, 3)), 0, 255).astype(np.uint8)
    bad, free = hit(clean.shape), np.ones(clean.shape[:3], bool)
    right, _, _ = temporal_modes(clean, free, 8.0)
    found, votes, _ = temporal_modes(np.where(bad, fault, clean).astype(np.uint8), free, 8.0)
    np.testing.assert_allclose(found, right, atol=0.6)
    np.testing.assert_array_equal(votes, 20 - bad.any(axis=-1).sum(axis=0))


@pytest.mark.parametrize("fault", [[0, 0, 0, 255], [255, 0, 255, 0]], ids=["black", "unmeasured"])
def test_the_sweep_finds_the_planes_of_the_rest(
    fault: list[int], tmp_path: Path, default_settings: Callable[..., dict]
) -> None:
    world, cameras = made_room.made_room(table=False), made_room.ring(3, wh=(96, 54))
    thin = {"sweep_width": 96, "wall_step_m": 0.2, "horizontal_step_m": 0.2, "reach_m": 5.0, "furniture_m": 0.5}
    options = settings_module.load(sweep.Settings, default_settings("depth", **thin), "depth")
    pictures, found = [made_room.photograph(world, camera)[0] for camera in cameras], []
    for name in ("clean", "broken"):
        (tmp_path / name).mkdir()
        plates = made_room.write_capture(tmp_path / name, cameras, pictures)
        for seed, path in enumerate(plates if found else []):
            stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            stored[hit(cameras[0].hw, seed)] = fault
            assert cv2.imwrite(str(path), stored)
        out = tmp_path / name / "sweep.npz"
        sweep.run(options, "cam1", tmp_path / name / "cameras/images.txt", plates, out)
        found.append(dict(np.load(out)))
    clean, broken = found
    both = broken["confident"] & clean["confident"]
    assert abs(float(broken["floor_m"])) < 0.05
    assert both.mean() > 0.6 * clean["confident"].mean()
    one, other = clean["planes"][clean["chosen"]], broken["planes"][broken["chosen"]]
    same = (np.abs((one[..., :3] * other[..., :3]).sum(-1)) > 0.99) & (np.abs(one[..., 3] - other[..., 3]) < 0.25)
    assert same[both].mean() > 0.9
    assert fault[3] or not broken["confident"][hit((54, 96))].any()


def with_fault(person: Person, fault: float, frame: int) -> Person:
    """With the fault in one frame's pose, and in its place where it is no number."""
    poses, trans = person.poses.copy(), person.trans.copy()
    poses[frame, 12], trans[frame, 1] = fault, trans[frame, 1] if np.isfinite(fault) else fault
    return replace(person, poses=poses, trans=trans)


@NUMBERS
def test_masks_cut_out_the_rest(
    scene: Scene, default_settings: Callable[..., dict], fault: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """A hundredth of the film's pixels is black, and one number of every body is the fault."""
    settings = settings_module.load(segment.Settings, default_settings("masks"), "masks")
    frames, people, finite = scene.frames.copy(), [], bool(np.isfinite(fault))
    frames[hit(frames.shape[:3])] = 0
    for k, person in enumerate(scene.people):
        write_person(tmp_path / f"p{k}.npz", with_fault(person, fault, k + 1))
        people.append(read_person(tmp_path / f"p{k}.npz"))
        struck = np.arange(len(frames)) == k + 1
        np.testing.assert_array_equal(people[-1].valid, person.valid & (finite | ~struck))
        np.testing.assert_array_equal(people[-1].poses[~struck], person.poses[~struck])
    assert ("p0.npz: 1 frames hold numbers that are not finite" in capsys.readouterr().out) == (not finite)
    labels = segmented(scene, settings, frames=frames, people=people)
    for k in range(2):
        for which, least in ((slice(3, None), 0.85), (slice(1, 3), 0.5)):
            mine, true = labels[which] == k + 1, scene.truth[which] == k + 1
            assert (mine & true).sum() > least * (mine | true).sum()
    if not finite:
        write_person(tmp_path / "p0.npz", replace(scene.people[0], betas=np.full(10, fault)))
        with pytest.raises(UserError, match="numbers of betas are not finite"):
            read_person(tmp_path / "p0.npz")


def test_a_person_is_trained_on_the_rest(
    made: Made, body: BodyModel, default_settings: Callable[..., dict], tmp_path: Path
) -> None:
    """A hundredth of the film is black, a hundredth of the masks' pixels says somebody else, and one frame's pose is no
    number."""
    options = dict(made.options)
    for kind, value in (("videos", 0), ("masks", 1)):
        options[kind] = []
        for seed, path in enumerate(made.options[kind]):
            frames = read_stack(path)
            frames[hit(frames.shape[:3], seed)] = value
            options[kind].append(tmp_path / path.name)
            write_lossless(options[kind][-1], iter(frames), 30.0)
    write_person(tmp_path / "p3.npz", with_fault(made.person, np.nan, 4))
    section = json.loads(json.dumps(default_settings("humans", iterations=100, gaussians=2000)))
    section["rates"]["pose_rad"] = 0.0
    settings = settings_module.load(train.Settings, section, "humans")
    scores = []
    for name, brought in (("clean", made.options), ("broken", {**options, "fit": tmp_path / "p3.npz"})):
        (tmp_path / name).mkdir()
        out = {"gaussians": tmp_path / name / "p3.ply", "avatar": tmp_path / name / "p3.npz"}
        call(train.run, settings, **brought, **out, working=tmp_path / name)
        scores.append(score(made, body, tmp_path / name, view_ring([45], "view", wh=VIEW_WH)))
    written = read_avatar(tmp_path / "broken/p3.ply", tmp_path / "broken/p3.npz", body)
    assert state.finite_mask(written.gaussians).all()
    np.testing.assert_array_equal(written.valid, made.person.valid & (np.arange(len(written.valid)) != 4))
    assert scores[1] > scores[0] - 1.5
