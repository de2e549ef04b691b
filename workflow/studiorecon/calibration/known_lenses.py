# SPDX-License-Identifier: Apache-2.0
"""Known lenses without poses: removes their distortion from people's points before poses are estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.calibration.formats.lenses import read_lenses
from studiorecon.calibration.names import pairings
from studiorecon.camera_files.raw_camera import check_camera
from studiorecon.geometry.crop_hypotheses import crop_hypotheses
from studiorecon.geometry.lens import apply_pixel_map
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.progress import say
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.people import Detections


def lenses_of_cameras(
    files: Sequence[Path], sizes: Mapping[str, tuple[int, int]], maps: Mapping[str, Any]
) -> dict[str, Lens]:
    """camera → its lens at the identity, from ``files`` without poses; a single lens is every camera's. Empty without
    files."""
    if not files:
        return {}
    raw = {camera.name: camera for camera in read_lenses(files)}
    source = files[0].name
    if len(raw) == 1:
        of_camera = dict.fromkeys(sizes, next(iter(raw)))
    else:
        pairing = pairings(list(sizes), list(raw), source)[0]
        of_camera = pairing.calibrated
        if pairing.how:
            say(pairing.sentence(source))
    found = {}
    for camera, name in of_camera.items():
        checked, notes = check_camera(camera, raw[name], source)
        about = checked.wh, checked.intrinsics, checked.model, checked.distortion
        lens = Lens(camera, *about, np.eye(4), np.eye(2, 3))
        place = crop_hypotheses(apply_pixel_map(lens, maps.get(camera)), sizes[camera])[0]
        found[camera] = place.lens
        for note in [*notes, *([f"camera {camera}: {place.how}"] if place.how else [])]:
            say(note)
    say(f"the lenses of {', '.join(found)} come from {', '.join(file.name for file in files)}")
    return found


def ideal_pinhole(lens: Lens, wh: tuple[int, int]) -> Camera:
    """The pinhole with square pixels and a central principal point for which poses are estimated."""
    focal = float(lens.intrinsics[0, 0] / _scale(lens, wh))
    return Camera(lens.name, wh, np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]]), np.eye(4))


def undistort_detections(seen: Detections, lens: Lens, wh: tuple[int, int]) -> Detections:
    """The detections in pixels of ``ideal_pinhole``; points outside of the lens's field are dropped."""
    camera, found = to_pinhole(seen, lens, wh)
    wanted = ideal_pinhole(lens, wh)
    points = found.keypoints.copy()
    focal = np.diag(wanted.intrinsics)[:2] / np.diag(camera.intrinsics)[:2]
    points[..., :2] = (points[..., :2] - camera.intrinsics[:2, 2]) * focal + wanted.intrinsics[:2, 2]
    return replace(seen, keypoints=points)


def lens_at_pose(lens: Lens, found: Camera) -> Lens:
    """The lens with the pose and focal length of the estimated camera."""
    intrinsics = lens.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= found.focal_px[0] / ideal_pinhole(lens, found.wh).focal_px[0]
    return replace(lens, intrinsics=intrinsics, camera_from_world=found.camera_from_world)


def _scale(lens: Lens, wh: tuple[int, int]) -> float:
    """Calibration pixels per pixel of the film."""
    return float(lens.calibration_from_video[0, 0]) if lens.has_place or 0 in lens.wh else lens.wh[0] / wh[0]
