# SPDX-License-Identifier: Apache-2.0
"""render: replacement of a person, on planted people of known shape."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack, to_bytes
from studiorecon.humans import proxy as humans_proxy
from studiorecon.render import shot as render_shot
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.render.replacement import donor_from_avatar, replace_people, retarget
from studiorecon.render.shot import read_composite
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import read_path
from studiorecon.scene.people import Person
from studiorecon.splatting.scene_files import SceneFiles

from tests.defaults import loaded
from tests.made.scene import avatar, render_options, ring, write_scene
from tests.made.steps import call


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def people(body: BodyModel) -> list[Avatar]:
    """Two people of different build at different places, both walking."""
    rng = np.random.default_rng(3)
    first, second = avatar(body, rng, "p0"), avatar(body, rng, "p1")
    index, betas = np.arange(0, len(body.weights), 12), np.array([-1.5, 0.5, 0, 0, 0, 0, 0, 0, 0, 0])
    short = replace(second.gaussians, means_m=body.rest_vertices(betas)[index].astype(np.float32))
    return [first, replace(second, gaussians=short, betas=betas, trans=second.trans + np.array([0.5, 1.0, -0.05]))]


def same(one: Avatar, other: Avatar) -> None:
    for name in ("means_m", "quaternions", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_allclose(getattr(one.posed(2.5), name), getattr(other.posed(2.5), name), atol=2e-6)


def test_the_replacement_stands_where_the_performer_was(people: list[Avatar], body: BodyModel) -> None:
    """Every Gaussian projects to the donor's own surface in the performer's pose and position, feet on the floor."""
    performer, other = people
    stand_in = retarget(donor_from_avatar(other), performer)
    index = np.arange(0, len(body.weights), 12)
    camera = ring([30], "cam")[0]
    for frame in (0, 5):
        pose, trans = performer.poses[frame][None], performer.trans[frame][None].copy()
        trans[0, 2] += (
            body.vertices(pose, performer.betas, trans, body.proxy_vertices)[..., 2].min()
            - body.vertices(pose, other.betas, trans, body.proxy_vertices)[..., 2].min()
        )
        # One joint per Gaussian, as for the planted people.
        expected = performer.model.joint_transforms(pose, other.betas, trans)[0][other.bones[:, 0]]
        rest = body.rest_vertices(other.betas)[index]
        surface = np.einsum("nxy,ny->nx", expected[:, :3, :3], rest) + expected[:, :3, 3]
        drawn = stand_in.posed(frame).means_m.astype(np.float64)
        np.testing.assert_allclose(camera.project(drawn)[0], camera.project(surface)[0], atol=0.01)
        np.testing.assert_allclose(stand_in.trans[frame, :2], performer.trans[frame, :2])
        lowest = [
            a.model.vertices(pose, a.betas, a.trans[frame][None], body.proxy_vertices)[..., 2].min()
            for a in (stand_in, performer)
        ]
        # Without the shift the shorter person's feet hang centimetres above the floor.
        assert lowest[0] == pytest.approx(lowest[1], abs=1e-6)
    assert np.abs(stand_in.trans[:, 2] - performer.trans[:, 2]).min() > 0.02


def test_swapping_twice_changes_nothing(people: list[Avatar]) -> None:
    swapped = replace_people(people, {"p0": "p1", "p1": "p0"}, "swap")
    assert [p.person for p in swapped] == ["p0", "p1"]
    assert np.abs(swapped[0].posed(2.5).sh - people[1].gaussians.sh).max() < 1e-6
    for one, other in zip(replace_people(swapped, {"p0": "p1", "p1": "p0"}, "swap"), people):
        same(one, other)


def test_colours_that_drift_over_another_time_take_their_mean(people: list[Avatar]) -> None:
    rng = np.random.default_rng(0)
    start = TemporalNetwork.start(np.array([-1.0, -1.0, -1.0]), np.ones(3) * 2, people[0].frames, rng, 8, 2)
    start.flat[:] = rng.normal(0, 0.3, len(start.flat))
    drifting = replace(people[0], network=start)
    settled = donor_from_avatar(drifting).gaussians
    moments = np.linspace(0, people[0].frames - 1, 8)
    expected = np.mean([drifting.posed(t).sh[:, 0] for t in moments], axis=0)
    np.testing.assert_allclose(settled.sh[:, 0], expected, atol=1e-5)
    assert np.abs(expected - people[0].gaussians.sh[:, 0]).max() > 0.01


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, people=1, filmed=False)
    return folder


def film(scene: Path, default_settings: Callable, wanted: dict[str, str]) -> tuple[np.ndarray, np.ndarray]:
    section = default_settings("render")
    section["shots"] = {"swap": {**section["shots"]["orbit"], "frames": 2, "replace": wanted}}
    options = render_options(scene, "swap")
    call(render_shot.run, settings_module.load(render_shot.Settings, section, "render"), **options)
    return read_stack(options["video"]), read_stack(options["truth"])


def test_a_canonical_file_takes_a_persons_place_in_a_film(
    scene: Path, default_settings: Callable, body: BodyModel, tmp_path: Path
) -> None:
    plain, measured = film(scene, default_settings, {})
    own = read_avatar(scene / "humans/p0.ply", scene / "humans/p0.npz", body).gaussians
    green = np.zeros_like(own.sh)
    green[:, 0] = [-1.5, 1.5, -1.5]
    write_ply(tmp_path / "green.ply", replace(own, sh=green, means_m=own.means_m + np.float32([0, 0.3, 0])))
    pictures, truth = film(scene, default_settings, {"p0": str(tmp_path / "green.ply")})
    where = np.abs(pictures.astype(int) - plain).max(axis=-1) > 40
    assert where.sum() > 200
    assert (truth[where] == 0).mean() > 0.9, "the new person is invented"
    assert (measured[where] == 0).mean() < 0.1
    # The performer's own weights and shape, in green: the target that the bound stranger must cover.
    (tmp_path / "own").mkdir()
    write_ply(tmp_path / "own/green.ply", replace(own, sh=green))
    shutil.copy(scene / "humans/p0.npz", tmp_path / "own/green.npz")
    masks = [greenish(p) for p in (pictures, film(scene, default_settings, {"p0": str(tmp_path / "own/green.ply")})[0])]
    overlap = (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum()
    assert overlap > 0.8, "the new person covers what the performer covered"


def test_who_is_left_out_leaves_the_room_behind(scene: Path, default_settings: Callable) -> None:
    files, section = render_options(scene, "swap"), default_settings("render")
    filmed, _ = film(scene, default_settings, {})
    path = files["path"].read_bytes()
    without, _ = film(scene, default_settings, {"p0": "nobody"})
    assert files["path"].read_bytes() == path, "the camera goes where it would have gone"
    assert (np.abs(without.astype(int) - filmed).max(axis=-1) > 20).sum() > 200, "somebody stood there"
    near_m = loaded(render_shot.Settings).near_m
    canvas = CompositeRenderer(read_composite(SceneFiles(files["background"], files["provenance"]), "swap", {}), near_m)
    for picture, step in zip(without, read_path(files["path"])[0]):
        rendering, _ = canvas.draw(step.camera, step.frame, section["background_rgb"])
        np.testing.assert_array_equal(picture, to_bytes(rendering.rgb))


def greenish(pictures: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(pictures.astype(int), -1, 0)
    return (green - red > 60) & (green - blue > 60)


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        ({"p7": "p0"}, r"render\.shots\.swap\.replace names p7, but the people of this scene are p0"),
        ({"p0": "p1"}, r"replace names p1, but the people of this scene are p0"),
        ({"p0": "background/scene.ply"}, r"background/scene\.ply"),
        ({"p0": "nobody.ply"}, r"nobody\.ply is missing"),
    ],
)
def test_who_cannot_stand_in_is_named(scene: Path, default_settings: Callable, wanted: dict, sentence: str) -> None:
    placed = {name: str(scene / source) if source.endswith("ply") else source for name, source in wanted.items()}
    with pytest.raises(UserError, match=sentence):
        film(scene, default_settings, placed)


def test_a_file_without_its_motion_is_bound_like_any_other(
    scene: Path, body: BodyModel, people: list[Avatar], tmp_path: Path
) -> None:
    """With its ``.npz`` a person keeps the trained weights; without it, the surface's are close to them."""
    ply = read_ply(scene / "humans/p0.ply")
    write_ply(tmp_path / "alone.ply", ply)
    alone = replace_people(people[:1], {"p0": str(tmp_path / "alone.ply")}, "swap")[0]
    beside = replace_people(people[:1], {"p0": str(scene / "humans/p0.ply")}, "swap")[0]
    off_mm = 1000 * np.linalg.norm(alone.posed(3).means_m - beside.posed(3).means_m, axis=1)
    assert np.median(off_mm) < 15


def test_the_bare_body_of_a_persons_build_stands_in_for_them(body: BodyModel, root: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    filmed = avatar(body, rng, "p0")
    betas = np.array([0.8, -0.5, 0, 0, 0, 0, 0, 0, 0, 0])
    joints = body.joints(filmed.poses, betas, filmed.trans)
    sigma = np.zeros(joints.shape[:2])
    fitted = Person(
        "p0", body.identity, filmed.fps, filmed.poses, filmed.trans, betas, joints, filmed.valid, sigma, True
    )
    write_person(tmp_path / "p0.npz", fitted)
    humans_proxy.run(
        humans_proxy.Settings(3000, 0), root / "resources/body.npz", tmp_path / "p0.npz", tmp_path / "p0.plain.ply"
    )
    stand_in = replace_people([replace(filmed, betas=betas)], {"p0": str(tmp_path / "p0.plain.ply")}, "plain")[0]
    surface = body.vertices(filmed.poses[3:4], betas, filmed.trans[3:4])[0]
    off_mm = 1000 * scipy.spatial.cKDTree(surface).query(stand_in.posed(3).means_m)[0]
    assert np.median(off_mm) < 12
    shades = np.unique(np.round(stand_in.gaussians.sh[:, 0], 3), axis=0)
    assert len(shades) >= 8, "two shades of every part"
