# SPDX-License-Identifier: Apache-2.0
"""Refinement lets lenses move only when people call for it: planted lenses both ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.cameras import refine
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry.distortion import distort
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import detect, ring, walk

FRAMES = 40
NOISE_PX = 2.0
# Somebody in the middle and somebody near the border of the pictures, where a lens shows.
PEOPLE = [walk([-1.2, -0.5, 0], [0.03, 0.01, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.03, 0], FRAMES, 2.0)]


@pytest.fixture
def options(default_settings):
    return settings_module.load(refine.Settings, default_settings("cameras"), "cameras")


def decided(given: list[Camera], options, radial: float = 0.0, truth: list[Camera] | None = None) -> refine.Refinement:
    """What refinement makes of people seen by ``truth`` (the ring), through lenses with ``radial``, when it is told
    ``given``."""
    truth = truth or ring()
    seen = [bent(d, c, radial) for d, c in zip(detect(truth, PEOPLE, NOISE_PX, np.random.default_rng(3)), truth)]
    return refine.decide(given, [], seen, FRAMES, 30.0, True, options)


def bent(seen: Detections, camera: Camera, radial: float) -> Detections:
    points = seen.keypoints.copy()
    focal, principal = np.array(camera.focal_px), np.array(camera.principal_px)
    points[..., :2] = (
        distort((points[..., :2] - principal) / focal, "opencv", np.array([radial, 0, 0, 0, 0])) * focal + principal
    )
    return replace(seen, keypoints=points)


def other_focal(camera: Camera, factor: float) -> Camera:
    return replace(camera, intrinsics=camera.intrinsics * np.where(np.diag([True, True, False]), factor, 1.0))


def test_right_lenses_are_left_alone_to_the_bit(options):
    outcome = decided(ring(), options)
    assert outcome.report["freedom"] == "given"
    assert all((a.intrinsics == b.intrinsics).all() for a, b in zip(outcome.training, ring()))


def test_a_camera_that_zoomed_gets_its_focal_length_back(options):
    given = [other_focal(ring()[0], 1.1), *ring()[1:]]
    outcome = decided(given, options)
    assert outcome.report["freedom"] == "focal"
    longer = {c["camera"]: c["focal_longer"] for c in outcome.report["changes"]}
    assert longer["c0"] == pytest.approx(1 / 1.1 - 1, abs=0.02)
    assert max(abs(longer[c]) for c in ("c1", "c2", "c3")) < 0.02
    assert outcome.report["after_px"] < 1.1 * np.sqrt(2 * np.log(2)) * NOISE_PX


def test_a_camera_that_was_knocked_keeps_its_lens(options):
    pose = ring()[0].camera_from_world.copy()
    pose[:3, 3] += [0.05, -0.02, 0.0]
    outcome = decided([replace(ring()[0], camera_from_world=pose), *ring()[1:]], options)
    assert outcome.report["freedom"] in ("poses", "moved")


def test_distortion_that_was_left_in_is_found_and_its_setting_named(options, capsys):
    wide = [other_focal(c, 0.5) for c in ring(radius_m=2.6)]
    outcome = decided(wide, options, radial=-0.15, truth=wide)
    assert outcome.report["freedom"] == "radial"
    assert "set calibration.radial: {c0: -0." in capsys.readouterr().out
    for change in outcome.report["changes"]:
        assert change["radial_k1"] == pytest.approx(-0.15, abs=0.06), "people leave part of it to their own places"


def test_scale_and_gravity_are_kept(options):
    given = [other_focal(ring()[0], 1.1), *ring()[1:]]
    found = decided(given, options).training
    spread = [
        np.array([c.centre_m - np.mean([d.centre_m for d in cams], axis=0) for c in cams]) for cams in (found, given)
    ]
    assert np.linalg.norm(spread[0]) == pytest.approx(np.linalg.norm(spread[1]), rel=1e-3)
    for a, b in zip(found, given):
        assert np.degrees(np.arccos(min(1.0, a.camera_from_world[:3, 2] @ b.camera_from_world[:3, 2]))) < 0.5
