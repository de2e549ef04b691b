# SPDX-License-Identifier: Apache-2.0
"""people: surface points from bodies that a network saw in every camera (U33), planted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.models import smpl
from studiorecon.people import fit
from studiorecon.people.fitting import surface_points
from studiorecon.people.fitting.surface_points import skin_px, triangulate_surface
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, read_detections, write_detections

from tests.made.network_bodies import seen_by_a_network
from tests.made.scene import ring
from tests.made.smpl import write_smpl

FRAMES = 6


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    """The bundled body, said to be SMPL's: its shapes stand for those of the network."""
    return replace(BodyModel.load(root / "resources/body.npz"), identity="smpl planted")


@pytest.fixture(scope="module")
def truth(body: BodyModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (T, 72), betas and places (T, 3) of somebody who turns and swings arms and legs."""
    rng = np.random.default_rng(4)
    poses = np.zeros((FRAMES, 24, 3))
    time = np.arange(FRAMES)
    poses[:, 0] = [np.pi / 2, 0, 0]
    for joint, axis, size in (
        (1, 0, -0.5),
        (2, 0, 0.5),
        (4, 0, 0.6),
        (16, 2, -1.1),
        (17, 2, 1.1),
        (18, 1, -0.5),
        (19, 1, 0.7),
    ):
        poses[:, joint, axis] = size * (0.7 + 0.3 * np.sin(time + joint))
    betas = rng.normal(0, 0.7, body.shapes)
    trans = np.column_stack([0.05 * time, 0.02 * time, np.full(FRAMES, 0.95)])
    return poses.reshape(FRAMES, 72), betas, trans


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return ring([10, 100, 190, 280], "cam")


@pytest.fixture(scope="module")
def found(body: BodyModel, truth, cameras: list[Camera]) -> list[Detections]:
    return seen_by_a_network(body, truth, cameras)


def whose(found: list[Detections]) -> dict[tuple[str, int], str]:
    return {(d.camera, 0): "p0" for d in found}


def joints_off_m(body: BodyModel, truth, cameras, found, settings: fit.Settings) -> float:
    """Mean error of the joints after the step's own arithmetic."""
    names, keypoints = fit.person_keypoints("p0", found, whose(found), body, FRAMES)
    points = fit.triangulate_keypoints(
        names, keypoints, cameras, settings.triangulation, settings.fit.unverified_sigma_m
    )
    skin = triangulate_surface(
        "p0",
        found,
        whose(found),
        cameras,
        body,
        FRAMES,
        settings.triangulation,
        settings.fit.unverified_sigma_m,
        settings.fit.vertices,
    )
    person, _ = fit.fit_person("p0", points, body, 24.0, settings, skin if settings.fit.vertex_weight > 0 else None)
    return float(np.linalg.norm(person.joints - body.joints(*truth), axis=-1).mean())


@pytest.fixture
def settings(default_settings: Callable) -> fit.Settings:
    return settings_module.load(fit.Settings, default_settings("people"), "people")


def test_pixels_of_the_skin_are_those_of_the_body(
    body: BodyModel, truth, cameras: list[Camera], found: list[Detections]
) -> None:
    poses, betas, trans = truth
    vertices = body.proxy_vertices[::40]
    exact = replace(
        found[1],
        body_pose=poses.reshape(FRAMES, 24, 3)[:, 1:],
        body_root=rotations.log(
            cameras[1].rotation_camera_from_world @ rotations.exp(poses.reshape(FRAMES, 24, 3)[:, 0])
        ),
        body_shape=np.tile(betas, (FRAMES, 1)),
    )
    expected, _ = cameras[1].project(body.vertices(poses, betas, trans, vertices)[3].astype(np.float64))
    np.testing.assert_allclose(skin_px(exact, 3, cameras[1], body, vertices), expected, atol=0.01)


def test_surfaces_help_where_keypoints_are_few(
    body: BodyModel, truth, cameras: list[Camera], found: list[Detections], settings: fit.Settings
) -> None:
    alone = replace(settings, fit=replace(settings.fit, vertex_weight=0.0))
    without, with_skin = (joints_off_m(body, truth, cameras, found, s) for s in (alone, settings))
    assert with_skin < 0.6 * without, f"{1000 * with_skin:.0f} mm with the surface, {1000 * without:.0f} mm without"


def test_with_smpls_file_every_vertex_counts_where_the_paper_has_it(
    root: Path, tmp_path: Path, cameras: list[Camera], settings: fit.Settings, truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper's preset: SMPL's own file, the paper's solver, and all 6,890 vertices of a network's bodies."""
    smpl.run(write_smpl(tmp_path / "SMPL_NEUTRAL.pkl", BodyModel.load(root / "resources/body.npz")), tmp_path / "b.npz")
    body = BodyModel.load(tmp_path / "b.npz")
    found = seen_by_a_network(body, truth, cameras)
    about = (FRAMES, settings.triangulation, settings.fit.unverified_sigma_m)
    some, every = (triangulate_surface("p0", found, whose(found), cameras, body, *about, count) for count in (100, 0))
    assert len(every.vertices) == body.vertex_count == 6890
    np.testing.assert_allclose(every.points_m[:, some.vertices], some.points_m, atol=1e-6)
    monkeypatch.setattr(surface_points, "_AT_ONCE", 2 * 6890)
    parts = triangulate_surface("p0", found, whose(found), cameras, body, *about, 0)
    np.testing.assert_allclose(parts.points_m, every.points_m, atol=1e-6)
    papers = replace(settings.fit, solver="paper", beta_weight=10.0, vertices=0, vertex_weight=1.0, iterations=5)
    without = replace(papers, vertex_weight=0.0)
    off_m = [joints_off_m(body, truth, cameras, found, replace(settings, fit=f)) for f in (papers, without)]
    assert off_m[0] < off_m[1], f"{1000 * off_m[0]:.0f} mm with the vertices, {1000 * off_m[1]:.0f} mm without"


def test_without_bodies_and_in_another_shape_space_there_is_no_surface(
    body: BodyModel,
    cameras: list[Camera],
    found: list[Detections],
    settings: fit.Settings,
    capsys: pytest.CaptureFixture,
) -> None:
    about = (FRAMES, settings.triangulation, settings.fit.unverified_sigma_m, 100)
    keypoints = [replace(d, body_pose=None, pelvis=None, body_root=None, body_shape=None) for d in found]
    assert triangulate_surface("p0", keypoints, whose(found), cameras, body, *about) is None
    assert capsys.readouterr().out == ""
    bundled = replace(body, identity="somebody else")
    assert triangulate_surface("p0", found, whose(found), cameras, bundled, *about) is None
    assert "SMPL's, this scene's are somebody else" in capsys.readouterr().out
    # Whom the identities do not name has no surface either.
    nobody = triangulate_surface("p7", found, whose(found), cameras, body, *about)
    assert np.isnan(nobody.points_m).all()


def test_bodies_survive_their_file(found: list[Detections], tmp_path: Path) -> None:
    write_detections(tmp_path / "cam0.npz", found[0])
    back = read_detections(tmp_path / "cam0.npz")
    np.testing.assert_array_equal(back.body_root, found[0].body_root)
    np.testing.assert_array_equal(back.body_shape, found[0].body_shape)
