# SPDX-License-Identifier: Apache-2.0
"""Prior knowledge of lenses, and pixels with and without an estimated distortion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factors.lenses import PRINCIPAL_SHARE, RADIAL_SIGMA
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.rig.floor_marks import FloorMarks
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Horizontal field of view of a camera of which nothing is known: phones and webcams.
_USUAL_HFOV_DEG = 65.0


@dataclass(frozen=True)
class LensKnowledge:
    """Prior of V cameras.

    Attributes:
        expected, sigma: log focal length, k1 and principal point.
        makes: cameras with equal ones have similar lenses.
        given: cameras at their calibrated poses in a world whose floor is z = 0; empty without a calibration.
        pose_sigma: standard deviations of turns (rad) and moves (m) from there.
    """

    expected: Num[np.ndarray, "V 4"]
    sigma: Num[np.ndarray, "V 4"]
    makes: tuple[object, ...]
    given: tuple[Camera, ...] = ()
    pose_sigma: Num[np.ndarray, "V 6"] | None = None


def lens_knowledge(
    cameras: Sequence[Camera],
    focal_px: Mapping[str, tuple[float, float]],
    straight: Collection[str],
    usual_sigma: float,
) -> LensKnowledge:
    """The prior of the lenses. ``focal_px``: camera → focal length and its sigma as a share; all others have the usual
    focal length with ``usual_sigma``. ``straight``: cameras without distortion."""
    expected, sigma, makes = [], [], []
    for camera in cameras:
        side, held = max(camera.wh), camera.name in straight
        usual_px = 0.5 * side / np.tan(np.radians(_USUAL_HFOV_DEG) / 2)
        focal, share = focal_px.get(camera.name, (usual_px, usual_sigma))
        expected.append([np.log(focal), 0.0, camera.wh[0] / 2, camera.wh[1] / 2])
        rest = [0.0, 0.0, 0.0] if held else [RADIAL_SIGMA, PRINCIPAL_SHARE * side, PRINCIPAL_SHARE * side]
        sigma.append([share, *rest])
        makes.append(camera.name if held else camera.wh)
    return LensKnowledge(np.array(expected), np.array(sigma), tuple(makes))


def calibrated(
    cameras: Sequence[Camera], turn_deg: float, move_m: float, focal: float = 0.0, radial: float = 0.0
) -> LensKnowledge:
    """The prior of calibrated cameras with standard deviations of turns, moves, log focal lengths and k1."""
    expected = [[np.log(c.focal_px[0]), 0.0, *c.principal_px] for c in cameras]
    sigma = np.tile([focal, radial, 0.0, 0.0], (len(cameras), 1))
    poses = np.tile([*3 * [np.radians(turn_deg)], *3 * [move_m]], (len(cameras), 1))
    return LensKnowledge(np.array(expected), sigma, tuple(c.name for c in cameras), tuple(cameras), poses)


def distort_marks(marks: FloorMarks, cameras: Sequence[Camera], radial: Num[np.ndarray, " V"]) -> FloorMarks:
    """The marks in distorted pixels."""
    view = np.repeat(np.arange(len(cameras)), marks.pixels.shape[1])
    return replace(
        marks, pixels=distort_points(marks.pixels.reshape(-1, 2), cameras, radial, view).reshape(marks.pixels.shape)
    )


def undistort_tracks(
    seen: Sequence[Detections], cameras: Sequence[Camera], radial: Num[np.ndarray, " V"]
) -> list[Detections]:
    """The detections without the distortion of ``radial``, in pixels of ``cameras``; points without a ray are
    dropped."""
    found = []
    for d, camera, k1 in zip(seen, cameras, radial, strict=True):
        points = d.keypoints.copy()
        points[..., :2] = undistort_points(points[..., :2], camera, k1)
        points[..., 2] = np.where(np.isfinite(points[..., 0]), points[..., 2], 0.0)
        found.append(replace(d, keypoints=points) if k1 else d)
    return found


def undistort_points(pixels: Num[np.ndarray, "... 2"], camera: Camera, radial: float) -> Num[np.ndarray, "... 2"]:
    """Pixels without the distortion of a lens with k1 ``radial``; NaN where it has no such ray."""
    focal, principal = np.array(camera.focal_px), np.array(camera.principal_px)
    rays, _ = undistort((pixels - principal) / focal, "opencv", np.array([radial]))
    return rays * focal + principal


def distort_points(
    pixels: Num[np.ndarray, "M 2"],
    cameras: Sequence[Camera],
    radial: Num[np.ndarray, " V"],
    view: Integer[np.ndarray, " M"],
) -> Num[np.ndarray, "M 2"]:
    """Pixels of pinholes as the lenses of their cameras ``view``, with k1 ``radial``, distort them."""
    found = pixels.copy()
    for v, camera in enumerate(cameras):
        own, focal, principal = view == v, np.array(camera.focal_px), np.array(camera.principal_px)
        found[own] = distort((pixels[own] - principal) / focal, "opencv", np.array([radial[v]])) * focal + principal
    return found
