# SPDX-License-Identifier: Apache-2.0
"""One pinhole camera, and the lens a real camera had before its frames were undistorted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A static pinhole camera in the metric world.

    Attributes:
        name: what the user called it.
        wh: width and height in pixels.
        intrinsics: (3, 3) float64, pixels, pixel centres at +0.5, no skew.
        camera_from_world: (4, 4) float64 rigid transform, OpenCV axes.
    """

    name: str
    wh: tuple[int, int]
    intrinsics: np.ndarray
    camera_from_world: np.ndarray

    @property
    def hw(self) -> tuple[int, int]:
        return self.wh[1], self.wh[0]

    @property
    def focal_px(self) -> tuple[float, float]:
        return float(self.intrinsics[0, 0]), float(self.intrinsics[1, 1])

    @property
    def principal_px(self) -> tuple[float, float]:
        return float(self.intrinsics[0, 2]), float(self.intrinsics[1, 2])

    @property
    def rotation_camera_from_world(self) -> np.ndarray:
        return self.camera_from_world[:3, :3]

    @property
    def world_from_camera(self) -> np.ndarray:
        """(4, 4) inverse of ``camera_from_world``, by transposition: exact for a rotation, no linear solve."""
        inverse = np.eye(4)
        inverse[:3, :3] = self.camera_from_world[:3, :3].T
        inverse[:3, 3] = -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]
        return inverse

    @property
    def centre_m(self) -> np.ndarray:
        """(3,) camera centre in the world."""
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """(3,) unit viewing direction in the world."""
        return self.camera_from_world[2, :3].copy()

    def project(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and depth in metres (...,) of world points (..., 3).

        Points at or behind the camera plane get NaN pixels; their depth (≤ 0) says so.
        """
        in_camera = points_m @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        depth_m = in_camera[..., 2]
        safe = np.where(depth_m > 0, depth_m, np.nan)
        pixels = in_camera[..., :2] / safe[..., None] * np.array(self.focal_px) + np.array(self.principal_px)
        return pixels, depth_m

    def unproject(self, pixels: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """World points (..., 3) of pixels (..., 2) at z-depth (...,)."""
        rays = (np.asarray(pixels) - np.array(self.principal_px)) / np.array(self.focal_px)
        in_camera = np.concatenate([rays * depth_m[..., None], depth_m[..., None]], axis=-1)
        return (in_camera - self.camera_from_world[:3, 3]) @ self.camera_from_world[:3, :3]

    def pixel_centres(self) -> np.ndarray:
        """(H, W, 2) pixel coordinates of all pixel centres."""
        height, width = self.hw
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        return np.stack([columns, rows], axis=-1)

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Origin (3,) and directions (H, W, 3) in the world, scaled so that one step along a ray is one metre of z-depth."""
        directions = self.unproject(self.pixel_centres(), np.ones(self.hw)) - self.centre_m
        return self.centre_m, directions

    def resized(self, wh: tuple[int, int]) -> Camera:
        """The same camera with another number of pixels. With centres at +0.5 this is a pure scaling of the intrinsics."""
        scale = np.diag([wh[0] / self.wh[0], wh[1] / self.wh[1], 1.0])
        return replace(self, wh=(int(wh[0]), int(wh[1])), intrinsics=scale @ self.intrinsics)

    def as_json(self) -> dict[str, Any]:
        return {"name": self.name, "wh": list(self.wh), "intrinsics": self.intrinsics, "camera_from_world": self.camera_from_world}

    @staticmethod
    def from_json(value: dict[str, Any]) -> Camera:
        return Camera(
            name=str(value["name"]),
            wh=(int(value["wh"][0]), int(value["wh"][1])),
            intrinsics=np.asarray(value["intrinsics"], dtype=np.float64),
            camera_from_world=np.asarray(value["camera_from_world"], dtype=np.float64),
        )


@dataclass(frozen=True)
class Lens:
    """A calibrated camera as the user has it: pixels of the calibration, distortion not yet removed.

    Attributes:
        name: camera name.
        wh: size in pixels that the calibration refers to.
        intrinsics: (3, 3) float64, pixel centres at +0.5.
        model: ``"opencv"`` (k1 k2 p1 p2 k3 [k4 k5 k6], zeros allowed) or ``"fisheye"`` (k1 k2 k3 k4).
        distortion: coefficients of ``model``; all zero means a pinhole.
        camera_from_world: (4, 4) float64.
        calibration_from_video: (2, 3) affine map from pixels of the video file to pixels of the calibration
            (identity when the video has the calibrated size; a pure scaling when it was resized).
    """

    name: str
    wh: tuple[int, int]
    intrinsics: np.ndarray
    model: str
    distortion: np.ndarray
    camera_from_world: np.ndarray
    calibration_from_video: np.ndarray

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "wh": list(self.wh),
            "intrinsics": self.intrinsics,
            "model": self.model,
            "distortion": self.distortion,
            "camera_from_world": self.camera_from_world,
            "calibration_from_video": self.calibration_from_video,
        }

    @staticmethod
    def from_json(value: dict[str, Any]) -> Lens:
        return Lens(
            name=str(value["name"]),
            wh=(int(value["wh"][0]), int(value["wh"][1])),
            intrinsics=np.asarray(value["intrinsics"], dtype=np.float64),
            model=str(value["model"]),
            distortion=np.asarray(value["distortion"], dtype=np.float64).reshape(-1),
            camera_from_world=np.asarray(value["camera_from_world"], dtype=np.float64),
            calibration_from_video=np.asarray(value["calibration_from_video"], dtype=np.float64),
        )
