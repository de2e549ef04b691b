# SPDX-License-Identifier: Apache-2.0
"""The synthetic studio's camera positions, lenses and rays, and the errors of the user's calibration."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.distortion import undistort
from studiorecon.scene.camera import Camera, Lens
from studiorecon.studio.description import Description

if TYPE_CHECKING:
    from jaxtyping import Float

_FIRST_AZIMUTH_DEG = 45.0


def cameras(description: Description) -> list[Camera]:
    """All cameras as ideal pinholes, in the order of ``description.names``.

    Training cameras are evenly spaced up to a seeded jitter, at seeded heights; held-out ones are exactly halfway
    between even positions, at the middle height.
    """
    rig = description.cameras
    rng = np.random.default_rng([description.seed, 11])
    gap = 360.0 / rig.training if rig.layout == "ring" else rig.arc_deg / (rig.training - 1)
    first = _FIRST_AZIMUTH_DEG if rig.layout == "ring" else _FIRST_AZIMUTH_DEG - rig.arc_deg / 2
    low, high = rig.height_m
    found = []
    for k, name in enumerate(description.training):
        azimuth = first + k * gap + rig.jitter_deg * rng.uniform(-1, 1)
        found.append(_camera(description, name, azimuth, float(rng.uniform(low, high))))
    for k, name in enumerate(description.held_out):
        found.append(_camera(description, name, first + (k + 0.5) * gap, (low + high) / 2))
    return found


def _camera(description: Description, name: str, azimuth_deg: float, height_m: float) -> Camera:
    rig = description.cameras
    angle = np.radians(azimuth_deg)
    centre = np.array([rig.radius_m * np.cos(angle), rig.radius_m * np.sin(angle), height_m])
    forward = np.asarray(rig.look_at_m) - centre
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ centre
    width, height = description.size
    focal = 0.5 * width / np.tan(np.radians(rig.hfov_deg) / 2)
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(name, (width, height), intrinsics, camera_from_world)


def true_lenses(description: Description, ideal: list[Camera]) -> list[Lens]:
    """The true lenses of the footage: training cameras have the planted radial distortion."""
    lenses = []
    for camera in ideal:
        k1 = description.faults.radial_distortion if camera.name in description.training else 0.0
        distortion = np.array([k1, 0.0, 0.0, 0.0, 0.0])
        affine = np.eye(3)[:2]
        lenses.append(
            Lens(camera.name, camera.wh, camera.intrinsics, "opencv", distortion, camera.camera_from_world, affine)
        )
    return lenses


def calibrated_lenses(description: Description, lenses: list[Lens]) -> list[Lens]:
    """The lenses in the calibration file: the poses of training cameras have the planted errors."""
    import cv2

    rng = np.random.default_rng([description.seed, 12])
    described = []
    for lens in lenses:
        # Drawn for every camera, so that one camera's error does not depend on the number of held-out ones.
        rotation_error = np.radians(description.calibration.rotation_error_deg) * rng.standard_normal(3)
        centre_error = description.calibration.position_error_m * rng.standard_normal(3)
        if lens.name not in description.training:
            described.append(lens)
            continue
        rotation = lens.camera_from_world[:3, :3]
        centre = -rotation.T @ lens.camera_from_world[:3, 3] + centre_error
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = cv2.Rodrigues(rotation_error)[0] @ rotation
        camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ centre
        described.append(replace(lens, camera_from_world=camera_from_world))
    return described


def sync_offsets_frames(description: Description) -> dict[str, float]:
    """Clock error of each camera in frames: frame k shows the moment k + offset. Held-out cameras are exact."""
    rng = np.random.default_rng([description.seed, 13])
    most = description.faults.sync_offset_frames
    return {n: most * float(rng.uniform(-1, 1)) if n in description.training else 0.0 for n in description.names}


def ray_directions(lens: Lens, supersampling: int) -> Float[np.ndarray, "S N 3"]:
    """World directions of the S = n² rays of every pixel, one metre of z-depth long; S = 1 is the pixel's centre."""
    width, height = lens.wh
    steps = (np.arange(supersampling) + 0.5) / supersampling
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    rotation = lens.camera_from_world[:3, :3]
    found = []
    for dy in steps:
        for dx in steps:
            pixels = np.stack([columns.ravel() + dx, rows.ravel() + dy], axis=-1)
            seen = (pixels - lens.intrinsics[:2, 2]) / np.diag(lens.intrinsics)[:2]
            if lens.distortion.any():
                seen, valid = undistort(seen, lens.model, lens.distortion)
                # Beyond the lens's fold nothing is visible; such rays go straight ahead, far outside any useful radius.
                seen = np.where(valid[:, None], seen, 0.0)
            found.append(np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ rotation)
    return np.stack(found)
