# SPDX-License-Identifier: Apache-2.0
"""objects.find: whether a thing is round, told from the outlines of ellipsoids in flight."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.objects.object_tracks import FollowSettings, ObjectTrack, track_object
from studiorecon.objects.residual import ResidualRegion
from studiorecon.objects.sightings import Sighting
from studiorecon.scene.camera import Camera

from tests.made.objects import CAMERAS, FPS, FRAMES

BALL_M, LONG_M = np.array([0.12, 0.12, 0.12]), np.array([0.24, 0.09, 0.06])
NO_CROP = np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.uint8)
SETTINGS = FollowSettings(speed_m_s=12.0, gap_s=0.5, min_s=0.4)


def outline_px(camera: Camera, centre_m: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    """(48, 2) outline of an ellipsoid with half axes ``half_m``: the tangent circle of a unit sphere, seen from where
    it is one."""
    eye = (camera.centre_m - centre_m) / half_m
    distance = np.linalg.norm(eye)
    towards = eye / distance
    sideways = np.cross(towards, [0.0, 0.0, 1.0])
    sideways /= np.linalg.norm(sideways)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    circle = towards / distance + np.sqrt(1 - 1 / distance**2) * (
        np.cos(angle) * sideways + np.sin(angle) * np.cross(towards, sideways)
    )
    return camera.project(centre_m + half_m * circle)[0]


def flown(shapes_m: list[np.ndarray]) -> ObjectTrack | str:
    """What is told of a thing that crosses the room and in frame t is an ellipsoid with the half axes
    ``shapes_m[t]``."""
    path_m = np.stack([np.linspace(-0.7, 0.7, FRAMES), np.full(FRAMES, 0.1), np.full(FRAMES, 0.9)], axis=1)
    track = []
    for frame, (centre_m, half_m) in enumerate(zip(path_m, shapes_m, strict=True)):
        seen = {}
        for view, camera in enumerate(CAMERAS):
            points = outline_px(camera, centre_m, half_m)
            x, y = (points - points.mean(axis=0)).T
            area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
            seen[view] = ResidualRegion(view, points.mean(axis=0), area, points, True, (0, 0), *NO_CROP)
        track.append((frame, Sighting(centre_m, float(np.prod(half_m) ** (1 / 3)), seen)))
    return track_object(track, CAMERAS, FRAMES, FPS, SETTINGS)


@pytest.mark.parametrize("at", [0, FRAMES // 2, FRAMES - 1], ids=["first", "middle", "last"])
@pytest.mark.parametrize(
    ("mostly", "once", "is_round"), [(BALL_M, LONG_M, True), (LONG_M, BALL_M, False)], ids=["ball", "board"]
)
def test_round_is_what_all_moments_say_whichever_one_differs(
    mostly: np.ndarray, once: np.ndarray, is_round: bool, at: int
) -> None:
    track = flown([once if frame == at else mostly for frame in range(FRAMES)])
    assert isinstance(track, ObjectTrack), track
    assert track.is_sphere is is_round
