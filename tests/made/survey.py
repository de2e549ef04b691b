# SPDX-License-Identifier: Apache-2.0
"""What tests of survey and their neighbours share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.settings import load
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import write_lossless
from studiorecon.images.plate import write_plate
from studiorecon.rig.body_points import person_tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.decisions import Decision
from studiorecon.scene.people import write_identities, write_people
from studiorecon.scene.room import RoomBox, write_room
from studiorecon.survey import decide as step
from studiorecon.survey.effects import EARLY
from studiorecon.survey.effects.surveyed import SurveyedEffect
from studiorecon.survey.evidence import Evidence, SurveyInput
from studiorecon.survey.exposures import ExposureView

from tests.made.cameras import look_at

WH = (96, 64)


def ring(
    azimuths_deg: list[float], radius_m: float = 3.0, wh: tuple[int, int] = WH, focal_px: float = 60.0
) -> list[Camera]:
    """Cameras 1.5 m high that look at a point 1 m above the origin."""
    cameras = []
    for index, azimuth in enumerate(np.radians(azimuths_deg)):
        centre = np.array([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), 1.5])
        cameras.append(look_at(f"c{index}", centre, np.array([0, 0, 1.0]), wh, focal_px))
    return cameras


def floor_view(camera: Camera, gain: float | tuple = 1.0, noise: float = 0.0, seed: int = 0) -> ExposureView:
    """The floor z = 0 with a soft pattern, seen by a camera of the given exposure."""
    origin, rays = camera.rays()
    down = rays[..., 2] < -1e-6
    depth_m = np.where(down, -origin[2] / np.where(down, rays[..., 2], -1.0), 0.0)
    points = origin + depth_m[..., None] * rays
    pattern = 0.4 + 0.1 * np.sin(2 * points[..., :1] + np.array([0, 1, 2])) * np.cos(1.5 * points[..., 1:2])
    rgb = pattern * np.asarray(gain) + np.random.default_rng(seed).normal(0, noise, (*camera.hw, 3))
    return ExposureView(
        camera, rgb.astype(np.float32), np.ones(camera.hw, bool), np.where(depth_m < 20, depth_m, 0).astype(np.float32)
    )


def decided(
    effect: SurveyedEffect, settings: step.Settings, views: list[ExposureView], people: list[str] | None = None
) -> Decision:
    """One effect alone, of cameras with plates and depth."""
    nobody = person_tracks([], {}, [], 0, 0.0)
    evidence = Evidence(SurveyInput([v.camera for v in views], people, views, [], nobody, 0.0, 30.0), settings)
    found = effect.measure(evidence, effect.threshold)
    return effect.decide(found.value, found.interval, found.reason, detail=found.detail)


@pytest.fixture
def settings(default_settings) -> step.Settings:
    return load(step.Settings, default_settings("survey"), "survey")


@pytest.fixture
def files(tmp_path: Path) -> dict:
    """What the step reads: three cameras that look at a floor for twelve frames, and one person without keypoints."""
    cameras = ring([0, 120, 240])
    write_model(tmp_path / "cameras", cameras)
    footage = tuple(
        Footage(c.name, False, c.wh, c.intrinsics.tolist(), 30.0, 12, 0, "v", "", c.wh, 0, 0.0, []) for c in cameras
    )
    write_manifest(tmp_path / "manifest.json", Manifest("s", 30.0, 12, footage))
    write_people(tmp_path / "people.tsv", [("p0", 5, "c0,c1", 1.0, "keypoints")])
    write_identities(tmp_path / "identities.tsv", {})
    write_room(
        tmp_path / "room.json",
        RoomBox(0.0, np.array([-4, -4, 0.0]), np.array([4, 4, 3.0]), np.ones(6, bool), np.ones(6)),
    )
    rng = np.random.default_rng(0)
    for view in map(floor_view, cameras):
        picture = np.rint(view.rgb * 255)
        write_plate(tmp_path / f"{view.camera.name}.png", picture.astype(np.uint8), view.measured)
        write_depth(tmp_path / f"{view.camera.name}.exr", view.depth_m, np.ones(view.camera.hw, np.float32))
        noisy = [
            np.clip(picture + np.rint(rng.normal(0, 1, picture.shape)), 0, 255).astype(np.uint8) for _ in range(12)
        ]
        write_lossless(tmp_path / f"{view.camera.name}.mkv", noisy, 30.0)
    named = {
        key: [tmp_path / f"{c.name}.{end}" for c in cameras]
        for key, end in (("videos", "mkv"), ("plates", "png"), ("depths", "exr"))
    }
    return named | {
        "manifest": tmp_path / "manifest.json",
        "model": tmp_path / "cameras/images.txt",
        "people": [tmp_path / "people.tsv"],
        "identities": [tmp_path / "identities.tsv"],
        "detections": [],
        "room_box": tmp_path / "room.json",
        "decisions": tmp_path / "survey/decisions.json",
        "artefacts": [tmp_path / "survey" / effect.artefact.file for effect in EARLY if effect.artefact],
    }
