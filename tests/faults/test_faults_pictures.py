# SPDX-License-Identifier: Apache-2.0
"""One percent of what comes in is NaN, infinite or zero: the stages of pictures and depth end, say how many, and keep
the rest."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.background import hole_filling as room
from studiorecon.body.person_boxes import people_regions
from studiorecon.camera_files.colmap import write_model
from studiorecon.clocks import motion_clock
from studiorecon.depth import given
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.geometry.bundle import BundleSettings
from studiorecon.geometry.depth_surface import depth_breaks
from studiorecon.geometry.triangulation import triangulate
from studiorecon.images.exposure import compare
from studiorecon.images.plate import temporal_modes
from studiorecon.images.transfer import Transfer, source, transfer_residual
from studiorecon.masks import log_odds
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.room import RoomBox
from studiorecon.splatting.seeds import seeds_from_depth
from studiorecon.survey import coverage, exposures
from studiorecon.views import forward_warp

from tests.made.cameras import LIMITS, adjust, detect, ring, seen, walk
from tests.made.gaussians import camera, rasterise
from tests.made.gaussians import room as room_of_gaussians

FAULTS = pytest.mark.parametrize("fault", [np.nan, np.inf, 0.0], ids=["nan", "inf", "zero"])
SHARE = 0.01
BOX = RoomBox(0.2, np.array([-5.0, -6.0, 0.0]), np.array([5.5, 6.5, 3.0]), np.ones(6, bool), np.ones(6))
VIEWS = [c.resized((160, 88)) for c in ring(4)]


def with_faults(values: np.ndarray, fault: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A copy in which one percent of the entries (at least one) are the fault, and which ones."""
    hit = np.random.default_rng(seed).permutation(values.size).reshape(values.shape) < max(
        1, round(SHARE * values.size)
    )
    return np.where(hit, fault, values).astype(values.dtype), hit


def look(view) -> tuple[np.ndarray, np.ndarray]:
    """Smooth colours (H, W, 3) float32 and depth (H, W) float32 of the empty room."""
    origin, rays = view.rays()
    depth_m, _ = BOX.intersect(origin, rays)
    at = origin + rays * depth_m[..., None]
    return (0.5 + 0.3 * np.sin(at)).astype(np.float32), depth_m.astype(np.float32)


@FAULTS
def test_depth_files_say_how_much_of_them_is_no_depth(
    fault: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    clean = look(VIEWS[0])[1]
    depth, hit = with_faults(clean, fault)
    sure, unsure = with_faults(np.ones_like(clean), fault, seed=1)
    write_depth(tmp_path / "a.exr", depth, sure)
    read, confidence = read_depth(tmp_path / "a.exr")
    np.testing.assert_array_equal(read[~hit], clean[~hit])
    assert (read[hit] == 0).all()
    assert (confidence[unsure] == 0).all()
    said = "".join(capsys.readouterr())
    assert (f"{hit.sum()} depths of {hit.size}" in said and f"{unsure.sum()} confidences" in said) == (fault != 0)


@FAULTS
def test_depth_a_given_map_loses_only_its_faults(fault: float, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    clean = look(VIEWS[0])[1]
    depth, hit = with_faults(clean, fault)
    write_depth(tmp_path / "given.exr", depth, np.ones_like(depth))
    write_model(tmp_path / "cameras", VIEWS)
    model = tmp_path / "cameras" / "images.txt"
    given.run(given.Settings(near_m=0.3), VIEWS[0].name, model, tmp_path / "given.exr", tmp_path / "out.exr")
    made, sure = read_depth(tmp_path / "out.exr")
    np.testing.assert_array_equal(made[~hit], clean[~hit])
    assert (made[hit] == 0).all()
    assert (sure[hit] == 0).all()
    assert "99 % known" in "".join(capsys.readouterr()).replace("99%", "99 %")


@FAULTS
def test_depth_breaks_are_those_of_the_clean_map_and_the_faults(fault: float) -> None:
    clean = look(VIEWS[0])[1]
    depth, hit = with_faults(clean, fault)
    broken = depth_breaks(depth, 0.04)
    assert broken[hit].all()
    near = np.zeros_like(hit)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            near |= np.roll(hit, (dy, dx), (0, 1))
    np.testing.assert_array_equal(broken[~near], depth_breaks(clean, 0.04)[~near])


@FAULTS
def test_views_carry_the_rest_of_a_photo(fault: float) -> None:
    rgb, clean = look(VIEWS[0])
    depth, hit = with_faults(clean, fault)
    target = ring(16)[1].resized((160, 88))
    everything = np.ones_like(hit)
    right, support, _ = forward_warp.blend(
        target, [forward_warp.source(VIEWS[0], rgb, everything, clean, 0.04)], 3, 0.02, 0.3
    )
    found, kept, made_depth = forward_warp.blend(
        target, [forward_warp.source(VIEWS[0], rgb, everything, depth, 0.04)], 3, 0.02, 0.3
    )
    assert np.isfinite(found).all()
    assert np.isfinite(made_depth).all()
    both = (support > 0) & (kept > 0)
    assert both.sum() > 0.85 * (support > 0).sum()
    assert np.quantile(np.abs(found - right)[both], 0.999) < 0.05
    assert np.abs(found - right)[both].max() < 0.15
    # The count: what is lost is missing from the support, which the mask file keeps.
    assert (kept > 0).sum() < (support > 0).sum()


@FAULTS
def test_survey_judges_as_without_the_faults(fault: float) -> None:
    clean = [look(v) for v in VIEWS]
    broken = [with_faults(depth, fault, seed)[0] for seed, (_, depth) in enumerate(clean)]
    points = coverage.stage_points(VIEWS, 0.5, 2.0)
    right = coverage.visible_points(points, VIEWS, [depth for _, depth in clean], 0.05)
    found = coverage.visible_points(points, VIEWS, broken, 0.05)
    assert (right != found).mean() < SHARE
    measured = np.ones(VIEWS[0].hw, bool)
    views = [exposures.ExposureView(v, rgb, measured, depth) for v, (rgb, _), depth in zip(VIEWS, clean, broken)]
    shared, errors = exposures.overlaps(views, 0.05, exposures.MIN_PIXELS)
    value, error, _ = exposures.disagreement(len(views), shared, errors)
    # One exposure filmed all of it: nothing beyond what the threshold lets pass.
    assert value + exposures.INTERVAL * error <= 0.01
    json.dumps(value)


@FAULTS
def test_survey_colours_that_are_no_numbers_do_not_move_the_gains(fault: float) -> None:
    first = np.random.default_rng(0).uniform(0.2, 0.8, (2000, 3))
    broken, hit = with_faults(first, fault)
    found = compare(0, 1, broken, first / 1.1, 50)
    assert found.pixels == 2000 - hit.any(axis=1).sum()
    np.testing.assert_allclose(found.log_ratio, np.log(1.1), atol=1e-9)


@FAULTS
def test_background_starts_from_the_rest(fault: float) -> None:
    rgb, clean = look(VIEWS[0])
    depth, hit = with_faults(clean, fault)
    measured = np.ones_like(hit)
    right, right_at = seeds_from_depth(VIEWS[0], rgb, measured, clean, 3, 0.6, 0.7, 1)
    found, at = seeds_from_depth(VIEWS[0], rgb, measured, depth, 3, 0.6, 0.7, 1)
    assert 0.85 * right.count < found.count < right.count
    assert all(
        np.isfinite(getattr(found, name)).all()
        for name in ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")
    )
    where = {tuple(place): i for i, place in enumerate(right_at.tolist())}
    same = [where[tuple(place)] for place in at.tolist()]
    np.testing.assert_array_equal(found.means_m, right.means_m[same])


@FAULTS
def test_background_paints_the_room_box_from_the_rest(fault: float) -> None:
    pictures = [look(v) for v in VIEWS]
    faces = BOX.rectangles
    plates, known = [rgb for rgb, _ in pictures], [np.ones(v.hw, bool) for v in VIEWS]
    right = room.paint(faces, VIEWS, plates, known, [depth for _, depth in pictures], 0.5)
    broken = [with_faults(depth, fault, seed)[0] for seed, (_, depth) in enumerate(pictures)]
    for one, other in zip(right, room.paint(faces, VIEWS, plates, known, broken, 0.5)):
        assert np.isfinite(other.rgb).all()
        # A node is lost when its pixel is faulty or touches one.
        assert (one.seen != other.seen).sum() <= max(0.2 * one.seen.sum(), 4)
        both = one.seen & other.seen
        assert np.abs(one.rgb - other.rgb)[both].sum() <= 0.01 * 3 * both.sum()


@FAULTS
@pytest.mark.parametrize("field", ["means_m", "quaternions", "log_scales", "logit_opacities", "sh"])
def test_render_leaves_out_gaussians_that_are_no_numbers(
    field: str, fault: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    clean, view = room_of_gaussians(2000, 1), camera(96, 60)
    values, hit = with_faults(getattr(clean, field), fault)
    write_ply(tmp_path / "a.ply", replace(clean, **{field: values}))
    found = rasterise(read_ply(tmp_path / "a.ply"), view, near_m=0.1)
    assert np.isfinite(found.rgb).all()
    assert np.isfinite(found.depth_m).all()
    rows = hit.reshape(clean.count, -1).any(axis=1)
    # An infinite logit is an opacity of 1: legal, and drawn.
    bad = not np.isfinite(fault) and not (field == "logit_opacities" and np.isinf(fault))
    assert (f"{rows.sum()} of {clean.count} Gaussians" in "".join(capsys.readouterr())) == bad
    if bad:
        kept = type(clean)(
            *(getattr(clean, n)[~rows] for n in ("means_m", "quaternions", "log_scales", "logit_opacities", "sh"))
        )
        np.testing.assert_allclose(found.rgb, rasterise(kept, view, near_m=0.1).rgb, atol=1e-5)


@FAULTS
def test_enhance_carries_residuals_of_the_rest(fault: float) -> None:
    transfer = Transfer(depth_tolerance=0.03, angle_power=4.0, feather_px=4.0, smooth_px=1.0)
    rgb, clean = look(VIEWS[0])
    photo, render = (np.rint(255 * p).astype(np.uint8) for p in (rgb, 0.8 * rgb))
    depth, _ = with_faults(clean, fault)
    right, cover = transfer_residual(VIEWS[0], clean, [source(VIEWS[0], photo, render, clean, transfer)], transfer)
    found, less = transfer_residual(VIEWS[0], depth, [source(VIEWS[0], photo, render, depth, transfer)], transfer)
    assert np.isfinite(found).all()
    assert np.isfinite(less).all()
    both = (cover > 0) & (less > 0)
    assert both.sum() > 0.8 * (cover > 0).sum()
    np.testing.assert_allclose(found[both], right[both], atol=1e-5)


@pytest.mark.parametrize("fault", [0, 255], ids=["zero", "white"])
def test_capture_the_plate_outvotes_single_bad_values(fault: int) -> None:
    """Film is 8 bit, so black and white are its faults; every pixel loses at most a vote or two and keeps its
    colour."""
    rng = np.random.default_rng(0)
    clean = np.clip(np.uint8(120) + rng.integers(-2, 3, (20, 24, 32, 3)), 0, 255).astype(np.uint8)
    frames, hit = with_faults(clean, fault)
    free = np.ones(frames.shape[:3], bool)
    right, _, _ = temporal_modes(clean, free, 8.0)
    found, votes, _ = temporal_modes(frames, free, 8.0)
    np.testing.assert_allclose(found, right, atol=0.6)
    np.testing.assert_array_equal(votes, 20 - hit.any(axis=-1).sum(axis=0))


@FAULTS
def test_capture_people_stand_where_their_other_keypoints_say(fault: float) -> None:
    cameras = ring(2)
    detections = detect(cameras, [walk(np.zeros(3), np.array([0.01, 0, 0]), 30)], 1.0, np.random.default_rng(0))[0]
    broken, _ = with_faults(detections.keypoints, fault)
    frames = np.arange(0, 30, 5)
    hw = (704, 1280)
    right = people_regions(detections, frames, hw, 0.03, 2)
    found = people_regions(replace(detections, keypoints=broken), frames, hw, 0.03, 2)
    assert (right & found).sum() > 0.9 * right.sum()


@FAULTS
def test_capture_clocks_are_compared_or_called_undetermined(fault: float) -> None:
    rng = np.random.default_rng(0)
    energy = np.abs(np.convolve(rng.normal(size=300), np.ones(3), "same"))
    broken = with_faults(energy, fault)[0]
    for other in (broken, energy):
        lag = motion_clock.compare(other, energy, 30.0)
        assert lag.rows == 0
        assert np.isfinite(lag.correlation)
        assert lag.reason or lag.valid


@FAULTS
def test_cameras_are_refined_and_points_placed_from_the_rest(fault: float) -> None:
    rng = np.random.default_rng(0)
    cameras, points = ring(4), rng.uniform([-0.8, -0.8, 0.1], [0.8, 0.8, 1.9], (200, 3))
    clean = seen(cameras, points, 0.5, rng)
    pixels, hit = with_faults(clean, fault)
    weights = np.ones(pixels.shape[:2])
    right, found = (triangulate(p, weights, cameras, LIMITS) for p in (clean, pixels))
    touched = hit.any(axis=(0, 2))
    np.testing.assert_array_equal(found.points_m[~touched], right.points_m[~touched])
    assert found.valid.all()
    assert np.linalg.norm(found.points_m - points, axis=1).max() < 0.02
    # The count: a view that is out is missing from the inliers.
    assert not found.inliers[hit.any(axis=-1)].any()
    settings = BundleSettings(iterations=15, prior_deg=0.3, prior_m=0.03)
    huber_px = np.full(4, 6.0)
    moved, _ = adjust(cameras, pixels, weights * found.inliers, found.points_m, huber_px, settings)
    reference, _ = adjust(cameras, clean, weights, right.points_m, huber_px, settings)
    for one, other in zip(moved, reference):
        np.testing.assert_allclose(one.centre_m, other.centre_m, atol=2e-3)


@FAULTS
def test_masks_a_colour_difference_is_finite_and_local(fault: float) -> None:
    settings = log_odds.DifferenceSettings()
    rgb, _ = look(VIEWS[0])
    picture = rgb.copy()
    picture[30:50, 60:90] = [0.9, 0.1, 0.1]
    broken, hit = with_faults(picture, fault)
    right = log_odds.colour_difference(picture, rgb, settings)
    found = log_odds.colour_difference(np.nan_to_num(broken, posinf=0.0), rgb, settings)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[~hit.any(axis=-1)], right[~hit.any(axis=-1)], atol=1e-4)
