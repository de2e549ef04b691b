# SPDX-License-Identifier: Apache-2.0
"""New views between cameras: the path's shape and ends, warps that are exact where they claim support, honest holes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import read_stack, to_bytes
from studiorecon.geometry.camera_path import look_at, with_pose
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import write_factors
from studiorecon.scene.path import write_path
from studiorecon.views import path as views_path
from studiorecon.views import synthesize
from studiorecon.views.forward_warp import WarpSource, blend_photos, close_pinholes, warp_photo, warp_source

from tests.made.room import made_room, photograph, ring, write_capture


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(((a - b)[where] ** 2).mean()))


@pytest.fixture(scope="module")
def photos() -> list[WarpSource]:
    room = made_room()
    return [
        warp_source(c, rgb, np.ones(c.hw, bool), depth, 0.04) for c in ring() for rgb, depth in [photograph(room, c)]
    ]


def test_segments_share_their_ends_and_start_at_photos(default_settings: Callable) -> None:
    cameras, segments = ring(), 4
    settings = load(views_path.Settings, default_settings("views", views_per_segment=6), "views")
    steps, _ = views_path.plan_views(cameras, settings)
    assert len(steps) == segments * 7
    assert [s.segment for s in steps] == [f"{k // 7:02d}" for k in range(segments * 7)]
    assert all(s.frame == 0 for s in steps)
    photo_poses = np.stack([c.camera_from_world for c in cameras])
    for k in range(segments):
        first, last = steps[7 * k].camera, steps[7 * k + 6].camera
        assert np.abs(photo_poses - first.camera_from_world).max((1, 2)).min() < 1e-9
        assert np.abs(photo_poses - last.camera_from_world).max((1, 2)).min() < 1e-9
        if k:
            assert np.abs(steps[7 * k - 1].camera.camera_from_world - first.camera_from_world).max() < 1e-9


def test_paper_preset_gives_481_distinct_views(root: Path, default_settings: Callable) -> None:
    import yaml

    preset = yaml.safe_load((root / "config/presets/paper.yaml").read_text())["views"]
    settings = load(views_path.Settings, {**default_settings("views"), **preset}, "views")
    steps, _ = views_path.plan_views(ring(), settings)
    assert len(steps) - (len({s.segment for s in steps}) - 1) == 481


def test_a_photo_carried_into_its_own_camera_is_itself(photos: list[WarpSource]) -> None:
    photo = photos[0]
    rgb, depth, count = warp_photo(photo, photo.camera, 3, 0.02)
    inside = photo.usable & (count > 4)
    assert inside.mean() > 0.9
    # Samples lie inside their pixel, so averaging them blurs by a fraction of a pixel at most.
    assert psnr(rgb, photo.rgb, inside) > 30
    assert np.median(np.abs(depth - photo.depth_m)[inside] / photo.depth_m[inside]) < 0.01


def test_warped_views_match_the_truth_where_they_claim_support(photos: list[WarpSource]) -> None:
    between = replace(ring(8)[1], name="view")
    truth, depth = photograph(made_room(), between)
    rgb, support, found = blend_photos(between, photos, 3, 0.02, np.radians(15))
    sure = support > 0.9
    assert sure.mean() > 0.8
    assert psnr(rgb, truth, sure) > 23
    assert (np.abs(found - depth)[sure] < 0.05 * depth[sure]).mean() > 0.97
    assert (support[found == 0] == 0).all()


def floor_look(azimuth_deg: float, apart_m: float, high_m: float) -> Camera:
    """At a place on the floor, from so far and so high."""
    turn = np.radians(azimuth_deg)
    eye = np.array([apart_m * np.cos(turn), apart_m * np.sin(turn), high_m])
    intrinsics = np.array([[160.0, 0, 80], [0, 160.0, 45], [0, 0, 1]])
    return with_pose(Camera("look", (160, 90), intrinsics, np.eye(4)), look_at(eye, np.zeros(3)), eye)


def floor_photo(camera: Camera, brightness: float) -> WarpSource:
    """Boards 12 cm wide along x, box-filtered from 5 × 5 rays to a pixel, and so bright."""
    fine = camera.resized((5 * camera.wh[0], 5 * camera.wh[1]))
    origin, rays = fine.rays()
    points = origin + rays * np.where(rays[..., 2:] < 0, -origin[2] / np.minimum(rays[..., 2:], -1e-9), 0)
    grey = 0.5 + 0.25 * np.sign(np.sin(points[..., 1] * np.pi / 0.12))
    grey = brightness * grey.reshape(camera.hw[0], 5, camera.hw[1], 5).mean(axis=(1, 3))
    origin, rays = camera.rays()
    depth_m = np.where(rays[..., 2] < 0, -origin[2] / np.minimum(rays[..., 2], -1e-9), 0)
    return warp_source(camera, np.repeat(grey[..., None], 3, axis=2), np.ones(camera.hw, bool), depth_m, 0.04)


def test_detail_is_of_the_sharpest_photo_and_brightness_of_the_nearest_direction() -> None:
    """A photo from beside the view sees the boards along their width at a grazing angle, as one grey; one from a
    quarter turn off sees them sharply, in other light."""
    view = floor_look(90.0, 3.0, 1.5)
    beside, across = floor_photo(floor_look(80.0, 7.0, 1.0), 1.0), floor_photo(floor_look(0.0, 2.5, 1.8), 0.8)
    wanted = floor_photo(view, 1.0)
    near = np.zeros(view.hw, bool)
    near[35:55, 60:100] = True
    near &= blend_photos(view, [beside], 3, 0.02, np.radians(15))[1] > 0

    def reported(*photos: WarpSource) -> tuple[float, float]:
        own = blend_photos(view, photos, 3, 0.02, np.radians(15))[0][near].mean(axis=-1)
        return float(np.corrcoef(own, wanted.rgb[near].mean(axis=-1))[0, 1]), float(own.mean())

    assert reported(beside)[0] < 0.5
    sharp, bright = reported(beside, across)
    assert sharp > 0.8
    assert bright == pytest.approx(reported(beside)[1], abs=0.02), "not as dark as the sharper photo"
    assert reported(across, beside) == pytest.approx((sharp, bright), abs=1e-6), "whichever comes first"


def test_what_no_photo_sees_is_a_hole_in_the_mask(photos: list[WarpSource], default_settings: Callable) -> None:
    between = replace(ring(8)[1], name="view")
    _, depth = photograph(made_room(), between)
    points = between.unproject(between.pixel_centres(), depth)
    seen = np.zeros(between.hw, bool)
    for photo in photos[:1]:
        pixels, z = photo.camera.project(points)
        column, row = (np.nan_to_num(pixels, nan=-1)[..., k] for k in (0, 1))
        inside = (z > 0.1) & (column >= 2) & (row >= 2) & (column < 190) & (row < 106)
        nearest = photo.depth_m[np.clip(row, 0, 107).astype(int), np.clip(column, 0, 191).astype(int)]
        seen |= inside & (z < 1.1 * nearest)
    settings = load(synthesize.Settings, default_settings("views"), "views")
    [(picture, mask)] = synthesize.synthesize_views([between], photos[:1], settings)
    assert 0.2 < (~seen).mean() < 0.9
    deep = cv2.erode((~seen).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert (mask[deep] == 0).mean() > 0.97
    # Painted over in the picture: no black holes.
    assert picture[~seen].mean() > 40
    assert mask.max() == 255


def test_unmeasured_plate_pixels_and_unknown_depth_are_not_carried(photos: list[WarpSource]) -> None:
    photo = photos[0]
    measured = np.ones(photo.camera.hw, bool)
    measured[:, :96] = False
    depth = photo.depth_m.copy()
    depth[:50] = 0
    carried = warp_source(photo.camera, np.where(measured[..., None], photo.rgb, 9.0), measured, depth, 0.04)
    rgb, _, count = warp_photo(carried, photo.camera, 3, 0.02)
    assert (count[:, :95] == 0).all()
    assert (count[:49] == 0).all()
    assert rgb.max() <= 1.0


def test_pinholes_close_and_holes_stay() -> None:
    rgb, depth, count = np.full((20, 20, 3), 0.5), np.full((20, 20), 3.0), np.full((20, 20), 9.0)
    for row, column in ((5, 5), (8, 12)):
        depth[row, column], count[row, column], rgb[row, column] = np.inf, 0, 0
    depth[12:17, 4:9], count[12:17, 4:9] = np.inf, 0
    closed_rgb, closed_depth, closed = close_pinholes(rgb, depth, count)
    assert closed[5, 5] == closed[8, 12] == 0.5
    assert closed_rgb[5, 5] == pytest.approx(0.5)
    assert closed_depth[8, 12] == pytest.approx(3.0)
    assert (closed[13:16, 5:8] == 0).all()


def test_segment_files_hold_pictures_and_support(tmp_path: Path, default_settings: Callable) -> None:
    room, cameras = made_room(), ring()
    pictures, depths = zip(*(photograph(room, c) for c in cameras))
    gains = {c.name: np.full(3, g) for c, g in zip(cameras, (1.1, 0.9, 1.0, 1.0))}
    plates = write_capture(tmp_path, cameras, [np.clip(p * gains[c.name], 0, 1) for c, p in zip(cameras, pictures)])
    maps = [tmp_path / f"{c.name}.exr" for c in cameras]
    for path, depth in zip(maps, depths):
        write_depth(path, depth, np.ones(depth.shape))
    write_factors(tmp_path / "gains.json", {name: own[None] for name, own in gains.items()})
    section = default_settings("views", views_per_segment=2)
    steps, _ = views_path.plan_views(cameras, load(views_path.Settings, section, "views"))
    write_path(tmp_path / "path.json", steps, 24.0)
    settings = load(synthesize.Settings, section, "views")
    model = tmp_path / "cameras/images.txt"
    common = (tmp_path / "path.json", model, plates, maps, [tmp_path / "gains.json"])
    synthesize.run(settings, "01", *common, tmp_path / "01.mkv", tmp_path / "01.mask.mkv")
    made, mask = read_stack(tmp_path / "01.mkv"), read_stack(tmp_path / "01.mask.mkv")
    assert made.shape == (3, 108, 192, 3)
    assert mask.shape == (3, 108, 192)
    # The first view of segment 01 is the second camera, at the rig's mean exposure rather than its own.
    error = np.abs(made[0].astype(float) - to_bytes(pictures[1]))[mask[0] == 255]
    assert np.median(error) < 4
    with pytest.raises(UserError, match="no segment 09; it holds 00, 01, 02, 03"):
        synthesize.run(settings, "09", *common, tmp_path / "x.mkv", tmp_path / "x.mask.mkv")
