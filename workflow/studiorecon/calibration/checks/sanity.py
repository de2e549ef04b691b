# SPDX-License-Identifier: Apache-2.0
"""Plausibility of a calibration without people: lenses that are not sold, cameras that face another way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.geometry.camera_path import scene_centre
from studiorecon.scene.camera import Camera

_FIELD_DEG = (8.0, 160.0)
_OFF_CENTRE = 0.25
_SAME_PLACE_M = 0.05
_ROOM_M = (0.5, 60.0)
_HEIGHT_M = (-0.5, 12.0)


def camera_facts(cameras: Sequence[Camera]) -> dict[str, dict[str, float]]:
    """Per camera: horizontal field of view (degrees), height above z = 0 (m), principal point off the middle (share of
    the size)."""
    return {
        c.name: {
            "field_deg": float(
                np.degrees(np.arctan2([c.principal_px[0], c.wh[0] - c.principal_px[0]], c.focal_px[0]).sum())
            ),
            "height_m": float(c.centre_m[2]),
            "off_centre": float(np.abs(np.array(c.principal_px) / c.wh - 0.5).max()),
        }
        for c in cameras
    }


def calibration_notes(cameras: Sequence[Camera]) -> list[str]:
    """Sentences about properties that no capture of people in a room has; empty for a plausible calibration."""
    found = []
    for name, fact in camera_facts(cameras).items():
        if not _FIELD_DEG[0] <= fact["field_deg"] <= _FIELD_DEG[1]:
            found.append(
                f"camera {name}: its focal length means a view {fact['field_deg']:.0f}° wide; "
                "it is in other units, or for another "
                "picture size"
            )
        if fact["off_centre"] > _OFF_CENTRE:
            found.append(
                f"camera {name}: its principal point is {fact['off_centre']:.0%} off the middle; the "
                "picture was cropped, turned or resized"
            )
        if not _HEIGHT_M[0] <= fact["height_m"] <= _HEIGHT_M[1]:
            found.append(
                f"camera {name}: it is {fact['height_m']:.1f} m above the floor; check calibration.up "
                "and calibration.unit"
            )
    centres = np.array([c.centre_m for c in cameras])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    for a, b in zip(*np.nonzero(np.triu(apart < _SAME_PLACE_M, 1))):
        found.append(
            f"cameras {cameras[a].name} and {cameras[b].name} are {100 * apart[a, b]:.1f} "
            "cm apart: one pose twice, or another unit"
        )
    if not _ROOM_M[0] <= apart.max() <= _ROOM_M[1]:
        found.append(f"the cameras are {apart.max():.3g} m apart at most: check calibration.unit and calibration.scale")
    return found + _looking_elsewhere(cameras)


def _looking_elsewhere(cameras: Sequence[Camera]) -> list[str]:
    """Cameras that do not have the others' common point in their picture (the point closest to all optical axes)."""
    if len(cameras) < 3:
        return []
    found = []
    for v, camera in enumerate(cameras):
        point = scene_centre([c for k, c in enumerate(cameras) if k != v])
        if not all(_in_picture(c, point) for k, c in enumerate(cameras) if k != v):
            continue
        if not _in_picture(camera, point):
            found.append(
                f"camera {camera.name} does not face the point that all others face; its pose may be inverted or "
                "another camera's"
            )
    return found


def _in_picture(camera: Camera, point: np.ndarray) -> bool:
    pixel, depth = camera.project(point[None])
    return bool(depth[0] > 0) and bool((pixel[0] >= 0).all() and (pixel[0] <= camera.wh).all())
