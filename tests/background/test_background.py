# SPDX-License-Identifier: Apache-2.0
"""background: first Gaussians, painted walls, view weights, and a whole training on a small box room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.background import hole_filling as room
from studiorecon.background import preparation, train
from studiorecon.background.targets import angle_between_axes, cutoff_angle, draw_shares, view_weight
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.images.metrics import psnr
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import write_factors
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import PathStep
from studiorecon.scene.provenance import INFERRED, INVENTED, MEASURED
from studiorecon.scene.room import RoomBox
from studiorecon.scene.support import support_weight
from studiorecon.splatting.seeds import finest_pixels, random_volume, seeds_from_depth

from tests.made.background import BOX, WH, cameras, capture, look, run, settings  # noqa: F401
from tests.made.gaussians import rasterise
from tests.made.scene import ring


@pytest.fixture(scope="module")
def between() -> list[Camera]:
    return ring([45, 135, 225, 315], "view", radius_m=1.9, wh=WH)


def score(folder: Path, cameras: list[Camera]) -> float:
    gaussians = read_ply(folder / "scene.ply")
    return float(np.mean([psnr(rasterise(gaussians, c, near_m=0.1).rgb, look(c)[0]) for c in cameras]))


def test_the_full_path_beats_four_photos_from_views_between_them(
    settings: Callable, capture: dict, between: list[Camera], tmp_path: Path
) -> None:
    marks = run(settings(), capture, tmp_path / "full")
    run(settings(start="random", random_count=4000, fill_unseen=False, views_share=0.0), capture, tmp_path / "fourview")
    full, fourview = score(tmp_path / "full", between), score(tmp_path / "fourview", between)
    assert full > 24
    assert full - fourview > 3.5
    assert len(marks) == read_ply(tmp_path / "full/scene.ply").count
    assert set(np.unique(marks)) == {MEASURED, INFERRED, INVENTED}


def test_exposure_factors_are_divided_out(
    settings: Callable, capture: dict, cameras: list[Camera], tmp_path: Path
) -> None:
    write_factors(tmp_path / "gains.json", {c.name: np.full((1, 3), 0.8 if c.name == "cam2" else 1.0) for c in cameras})
    darker = [tmp_path / "dark.png" if "cam2" in p.name else p for p in capture["plates"]]
    stored = cv2.imread(str(capture["plates"][2]), cv2.IMREAD_UNCHANGED)
    stored[..., :3] = np.rint(stored[..., :3] * 0.8)
    cv2.imwrite(str(tmp_path / "dark.png"), stored)
    errors = {}
    for gains in ([tmp_path / "gains.json"], []):
        run(settings(iterations=150), capture, tmp_path, plates=darker, gains=gains)
        errors[bool(gains)] = score(tmp_path, [cameras[2]])
    assert errors[True] > errors[False] + 2


def test_colours_have_harmonics_only_where_the_survey_calls_for_them(
    settings: Callable, capture: dict, tmp_path: Path
) -> None:
    section = settings(iterations=1)
    for name, specularity, kept in (
        ("asked", [tmp_path / "specularity.json"], 4),
        ("off", [], 1),
        ("nobody asked", None, 4),
    ):
        run(section, capture, tmp_path / name, specularity=specularity)
        assert read_ply(tmp_path / name / "scene.ply").sh.shape[1] == kept
    run(replace(section, limit_sh_to_views=False), capture, tmp_path / "free", specularity=[])
    assert read_ply(tmp_path / "free/scene.ply").sh.shape[1] == 4, "without limit_sh_to_views the setting counts"


def test_wrong_sizes_and_counts_are_refused_by_name(
    settings: Callable, capture: dict, cameras: list[Camera], tmp_path: Path
) -> None:
    write_depth(tmp_path / "small.exr", np.ones((10, 10)), np.ones((10, 10)))
    with pytest.raises(UserError, match=r"small\.exr .*\(10, 10\).*H = 56, W = 96"):
        run(settings(), capture, tmp_path, depths=[tmp_path / "small.exr", *capture["depths"][1:]])
    with pytest.raises(UserError, match="3 plates and 4 depth maps for 4 training cameras"):
        run(settings(), capture, tmp_path, plates=capture["plates"][:3])
    cv2.imwrite(str(tmp_path / "blank.png"), np.zeros((*cameras[0].hw, 4), np.uint8))
    with pytest.raises(UserError, match=r"blank\.png has no measured pixel"):
        run(settings(), capture, tmp_path, plates=[tmp_path / "blank.png", *capture["plates"][1:]])


def test_seeds_lie_on_the_walls_in_the_plates_colours(cameras: list[Camera]) -> None:
    rgb, depth_m = look(cameras[0])
    wanted = np.ones(cameras[0].hw, bool)
    wanted[:, :10] = False
    made, at = seeds_from_depth(cameras[0], rgb, wanted, depth_m, 2, 0.6, 0.7, 1)
    inside = made.means_m @ BOX.axes.T
    distance = np.minimum(np.abs(inside - BOX.low_m), np.abs(inside - BOX.high_m)).min(axis=1)
    assert distance.max() < 1e-3
    assert at[:, 1].min() >= 10
    assert np.allclose(made.sh[:, 0] * 0.28209479 + 0.5, rgb[at[:, 0], at[:, 1]], atol=1e-5)
    # Thin across the wall: the shortest axis is a third or less of the others.
    assert np.all(made.log_scales[:, 2] < made.log_scales[:, 0] - 1)


def test_what_several_photos_show_is_started_from_the_one_that_shows_it_finest() -> None:
    near, far = ring([0, 0], "c", radius_m=1.9, wh=WH)
    back = near.camera_from_world.copy()
    back[2, 3] += 1.5
    far = replace(far, camera_from_world=back)
    (_, near_m), (_, far_m) = look(near), look(far)
    known = np.ones(near.hw, bool)
    own, theirs = finest_pixels([near, far], [near_m, far_m], [known, known])
    assert own.mean() > 0.95, "all that the nearer one sees"
    there, depth_m = near.project(far.unproject(far.pixel_centres(), far_m))
    shared = (depth_m > 0) & (there > 0).all(-1) & (there < WH).all(-1)
    assert shared.mean() > 0.2
    assert theirs[shared].mean() < 0.05
    assert theirs[~shared].mean() > 0.9, "what it alone sees"
    known[:28] = False
    assert not finest_pixels([near, far], [near_m, far_m], [known, known])[0][:28].any()


def test_unknown_depth_seeds_nothing(cameras: list[Camera]) -> None:
    rgb, depth_m = look(cameras[0])
    depth_m[:28] = 0
    _, at = seeds_from_depth(cameras[0], rgb, np.ones(cameras[0].hw, bool), depth_m, 1, 0.6, 0.7, 0)
    assert at[:, 0].min() >= 28


def test_unseen_wall_is_painted_like_the_wall_beside_it(cameras: list[Camera]) -> None:
    pictures, depths = zip(*(look(c) for c in cameras))
    known = [np.ones(c.hw, bool) for c in cameras]
    faces = BOX.rectangles
    painted = {p.face.name: p for p in room.paint(faces, cameras[:1], pictures, known, depths, 0.1)}
    floor = painted["floor"]
    assert 0.2 < floor.seen.mean() < 0.9
    assert np.abs(floor.rgb[~floor.seen].mean(axis=0) - floor.rgb[floor.seen].mean(axis=0)).max() < 0.2
    assert np.allclose(floor.points_m[..., 2], 0)
    # The room as painted, from the camera that it was painted from.
    again = room.draw_faces(cameras[0], list(painted.values()))
    assert np.abs(again - pictures[0])[depths[0] > 0].mean() < 0.06
    # This camera sees nothing of the ceiling: it borrows, and stays a colour.
    assert not painted["ceiling"].seen.any()
    assert np.all((painted["ceiling"].rgb >= 0) & (painted["ceiling"].rgb <= 1))


def test_a_wall_that_no_camera_sees_looks_like_the_walls_that_some_camera_sees(cameras: list[Camera]) -> None:
    """At the same height, and not like the floor before it."""
    camera = cameras[0]
    origin, directions = camera.rays()
    depth_m, face = BOX.intersect(origin, directions)
    height_m = (origin + directions * depth_m[..., None])[..., 2:]
    red, grey = np.array([0.9, 0.1, 0.1]), np.repeat(0.2 + 0.2 * height_m, 3, axis=-1)
    plate = np.where((face >= 4)[..., None], red, grey).astype(np.float32)
    known = np.ones(camera.hw, bool)
    painted = room.paint(BOX.rectangles, [camera], [plate], [known], [depth_m.astype(np.float32)], 0.1)
    unseen = [p for p in painted if not p.seen.any() and p.face.name not in ("floor", "ceiling")]
    seen_m = np.concatenate([p.points_m[p.seen][:, 2] for p in painted if p.face.name not in ("floor", "ceiling")])
    assert unseen
    for own in unseen:
        heights = own.points_m[..., 2].clip(seen_m.min(), seen_m.max())
        np.testing.assert_allclose(own.rgb, np.repeat(0.2 + 0.2 * heights[..., None], 3, axis=-1), atol=0.1)


def test_the_grid_of_a_far_away_room_box_stays_within_its_limit() -> None:
    faces = RoomBox(0.0, np.full(3, -40.0), np.full(3, 40.0), np.zeros(6, bool), np.ones(6)).rectangles
    step_m = room.node_step(faces, 0.04, 5000)
    assert sum(f.nodes(step_m)[..., 0].size for f in faces) < 5500


@pytest.mark.parametrize(
    ("angle", "cutoff", "expected"),
    [
        pytest.param(0.0, 0.0, 3.0, id="I11-at-a-photo"),
        pytest.param(0.1, 0.0, 1.0, id="I11-beside-it"),
        pytest.param(np.pi / 2, np.pi / 4, 1.0, id="I12-beyond-the-cut-off"),  # without the clamp: 3.0, as for a photo
        pytest.param(np.pi / 8, np.pi / 4, 2.0, id="half-way"),
    ],
)
def test_view_weight(angle: float, cutoff: float, expected: float) -> None:
    assert view_weight(angle, cutoff, 2.0) == pytest.approx(expected)


def test_i13_angles_between_equal_axes_are_zero_not_nan(cameras: list[Camera]) -> None:
    # Naive: arccos(1.0000001) is NaN.
    assert angle_between_axes(cameras[0], cameras[0]) == 0
    assert cutoff_angle(cameras) == pytest.approx(0.5 * angle_between_axes(cameras[0], cameras[1]))
    assert cutoff_angle(cameras[:1]) == 0


def test_views_get_their_share_of_the_draws() -> None:
    shares = draw_shares(4, 90, 0.5)
    assert shares[4:].sum() == pytest.approx(0.5)
    assert shares.sum() == pytest.approx(1)
    assert draw_shares(4, 0, 0.5).tolist() == [0.25] * 4
    # What is hole, a person and well seen.
    assert support_weight(np.array([[0, 1, 255]], np.uint8), 0.3) == pytest.approx(np.array([[0.3, 0.0, 1.0]]))


def test_the_random_start_knows_nothing_but_the_cameras(cameras: list[Camera]) -> None:
    made = random_volume(cameras, 1000, 0.06, 1, np.random.default_rng(0))
    assert (made.means_m[:, 2] == 0).sum() == 250
    assert np.ptp(made.means_m[:, 0]) > 2 * 2.4
    assert np.all(made.sh == 0)


def test_generated_frames_stand_aside_for_photos(
    cameras: list[Camera], between: list[Camera], settings: Callable
) -> None:
    """U16: at the cameras' own poses the photos alone."""
    views = [cameras[0], between[0], cameras[1]]
    pictures, supports = [np.zeros((*v.hw, 3), np.uint8) for v in views], [np.full(v.hw, 255, np.uint8) for v in views]
    steps = [PathStep(v, 0.0, "00") for v in views]
    (kept,) = preparation.view_targets(steps, pictures, supports, cameras, [], settings())
    assert np.array_equal(kept.camera.camera_from_world, between[0].camera_from_world)


def test_holes_of_views_go_over_from_their_rim_to_the_painted_room(
    cameras: list[Camera], between: list[Camera], settings: Callable
) -> None:
    view = between[0]
    truth, depth_m = look(view)
    painted = [
        room.PaintedFace(face, nodes, np.full(nodes.shape, 0.25), np.ones(nodes.shape[:2], bool))
        for face in BOX.rectangles
        for nodes in [face.nodes(0.1)]
    ]
    support = np.full(view.hw, 255, np.uint8)
    support[:20] = 0
    picture, steps = np.rint(truth * 255).astype(np.uint8), [PathStep(view, 0.0, "00")]
    (target,) = preparation.view_targets(steps, [picture], [support], cameras, painted, settings())
    inside = depth_m[:20] > 0
    assert inside[:10].any()
    np.testing.assert_allclose(target.rgb[:10][inside[:10]], 0.25, atol=1e-3)
    own, found = (np.abs(rgb - 0.25).mean(-1) for rgb in (picture[:20] / 255, target.rgb[:20]))
    reported = inside & (own > 0.05)
    assert (found[reported] < own[reported]).all()
    assert found[19][reported[19]].mean() > 0.1 * own[19][reported[19]].mean(), (
        "beside the rim what it goes on as counts"
    )
    np.testing.assert_allclose(target.rgb[20:], picture[20:] / 255, atol=1e-6)
    (bare,) = preparation.view_targets(steps, [picture], [support], cameras, [], settings())
    np.testing.assert_allclose(bare.rgb, picture / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("count", "wanted", "cap", "degree"), [(4, 3, True, 1), (4, 3, False, 3), (3, 1, True, 0), (16, 2, True, 2)]
)
def test_harmonics_go_no_further_than_the_real_cameras_do(
    settings: Callable[..., train.Settings],
    capsys: pytest.CaptureFixture,
    count: int,
    wanted: int,
    cap: bool,
    degree: int,
) -> None:
    """Naive: four photos and degree 2 reproduce every camera's exposure error exactly (G15)."""
    requested = settings(limit_sh_to_views=cap)
    requested = replace(requested, training=replace(requested.training, sh_degree=wanted))
    cameras = ring([360 * i / count for i in range(count)], "c")
    start = random_volume(cameras, 50, 0.1, 3, np.random.default_rng(0))
    assert preparation.limit_harmonics(requested, start, cameras).training.sh_degree == degree
    assert ("cameras cannot resolve more" in capsys.readouterr().out) == (degree < wanted)
