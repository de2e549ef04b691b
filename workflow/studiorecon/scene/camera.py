# SPDX-License-Identifier: Apache-2.0
"""One pinhole camera, and the lens of a real camera before its frames were undistorted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.schema import INTRINSIC, RIGID, OptionalField, Schema, flag, metres, real, text, whole

if TYPE_CHECKING:
    from jaxtyping import Float, Num


CAMERA: dict[str, Schema] = {
    "name": text(),
    "wh": whole("2", low=1, unit="pixels"),
    "intrinsics": real("3 3", such=INTRINSIC),
    "camera_from_world": metres("4 4", such=RIGID),
}
LENS: dict[str, Schema] = CAMERA | {
    "wh": whole("2", low=0, unit="pixels"),
    "model": text("opencv", "fisheye"),
    "distortion": real("..."),
    "calibration_from_video": real("2 3"),
    "placed": OptionalField(text()),
    "keypoints_calibrated": OptionalField(flag()),
    "keypoint_distortion": OptionalField(real("...")),
}
"""The schema of ``as_json`` of a camera and of a lens."""


@dataclass(frozen=True)
class Camera:
    """A static pinhole camera in the metric world.

    Attributes:
        name: the user's name of the camera.
        wh: width and height in pixels.
        intrinsics: pixels, pixel centres at +0.5, no skew.
        camera_from_world: rigid transform, OpenCV axes.
    """

    name: str
    wh: tuple[int, int]
    intrinsics: Float[np.ndarray, "3 3"]
    camera_from_world: Float[np.ndarray, "4 4"]

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
    def rotation_camera_from_world(self) -> Num[np.ndarray, "3 3"]:
        return self.camera_from_world[:3, :3]

    @property
    def world_from_camera(self) -> Num[np.ndarray, "4 4"]:
        """Inverse of ``camera_from_world``, by transposition: exact for a rotation, no linear solve."""
        inverse = np.eye(4)
        inverse[:3, :3] = self.camera_from_world[:3, :3].T
        inverse[:3, 3] = -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]
        return inverse

    @property
    def centre_m(self) -> Num[np.ndarray, " 3"]:
        """Camera centre in the world."""
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    @property
    def forward(self) -> Num[np.ndarray, " 3"]:
        """Unit viewing direction in the world."""
        return self.camera_from_world[2, :3].copy()

    def project(self, points_m: Num[np.ndarray, "... 3"]) -> tuple[Num[np.ndarray, "... 2"], Num[np.ndarray, " ..."]]:
        """Pixels and depth in metres of world points; NaN for NaN. Raises ValueError when the last axis is not 3.

        Points at or behind the camera plane get NaN pixels, and their depth is ≤ 0 (C05).
        """
        points = np.asarray(points_m, dtype=np.float64)
        require("points_m", points, (..., 3))
        # One row per axis: numpy is several times faster along long rows than along a last axis of 2 or 3.
        x, y, depth = self.camera_from_world[:3, :3] @ points.reshape(-1, 3).T + self.camera_from_world[:3, 3:]
        # Replace the input of the division, not its result (C06).
        safe = np.where(depth > 0, depth, np.nan)
        pixels = np.empty((len(depth), 2))
        for axis, across in enumerate((x, y)):
            across /= safe
            across *= self.focal_px[axis]
            np.add(across, self.principal_px[axis], out=pixels[:, axis])
        return pixels.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1])

    def unproject(self, pixels: Num[np.ndarray, "... 2"], depth_m: Num[np.ndarray, " ..."]) -> Num[np.ndarray, "... 3"]:
        """World points of pixels at z-depth; not along-ray range (C03). Raises ValueError for unequal shapes.

        The caller decides which depths are valid (C04): 0 gives the camera's centre, a negative depth a point behind
        it.
        """
        pixels, depth = np.asarray(pixels, dtype=np.float64), np.asarray(depth_m, dtype=np.float64)
        require("pixels", pixels, (*depth.shape, 2))
        flat = pixels.reshape(-1, 2)
        rays = np.ones((3, len(flat)))
        for axis in range(2):
            np.subtract(flat[:, axis], self.principal_px[axis], out=rays[axis])
            rays[axis] /= self.focal_px[axis]
        rays *= depth.reshape(-1)
        rays -= self.camera_from_world[:3, 3:]
        points = np.empty((len(flat), 3))
        np.matmul(self.camera_from_world[:3, :3].T, rays, out=points.T)
        return points.reshape(*depth.shape, 3)

    def pixel_centres(self) -> Num[np.ndarray, "H W 2"]:
        """Pixel coordinates of all pixel centres."""
        height, width = self.hw
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        return np.stack([columns, rows], axis=-1)

    def rays(self) -> tuple[Num[np.ndarray, " 3"], Num[np.ndarray, "H W 3"]]:
        """Origin and directions in the world, scaled so that one step along a ray is one metre of z-depth."""
        directions = self.unproject(self.pixel_centres(), np.ones(self.hw)) - self.centre_m
        return self.centre_m, directions

    def resized(self, wh: tuple[int, int]) -> Camera:
        """The same camera with another number of pixels; with centres at +0.5 this only scales the intrinsics."""
        scale = np.diag([wh[0] / self.wh[0], wh[1] / self.wh[1], 1.0])
        return replace(self, wh=(int(wh[0]), int(wh[1])), intrinsics=scale @ self.intrinsics)

    def as_json(self) -> dict[str, Any]:
        return dict(vars(self))


@dataclass(frozen=True)
class Lens:
    """A calibrated camera in the user's footage: pixels of the calibration, distortion not yet removed.

    Attributes:
        wh: size in pixels that the calibration refers to.
        intrinsics: pixel centres at +0.5.
        model: ``"opencv"`` (k1 k2 p1 p2 k3 [k4 k5 k6], zeros allowed) or ``"fisheye"`` (k1 k2 k3 k4).
        distortion: coefficients of ``model``; all zero means a pinhole.
        calibration_from_video: affine map of pixels (identity when the video has the calibrated size; a pure scaling
            when it was resized).
        placed: how that map was determined, in words; "" where capture.yaml gives one other than the identity, and
            where there is none.
        keypoints_calibrated: whether recorded keypoints are in pixels of the calibration, not of the video.
        keypoint_distortion: coefficients of recorded keypoints where only they, or only the video, were undistorted;
            empty where they are the video's.
    """

    name: str
    wh: tuple[int, int]
    intrinsics: Float[np.ndarray, "3 3"]
    model: str
    distortion: Num[np.ndarray, " C"]
    camera_from_world: Float[np.ndarray, "4 4"]
    calibration_from_video: Num[np.ndarray, "2 3"]
    placed: str = ""
    keypoints_calibrated: bool = False
    keypoint_distortion: Num[np.ndarray, " C"] = field(default_factory=lambda: np.zeros(0))

    @property
    def of_keypoints(self) -> Lens:
        """The lens of recorded keypoints."""
        return replace(self, distortion=self.keypoint_distortion) if len(self.keypoint_distortion) else self

    @property
    def has_place(self) -> bool:
        """Whether the video's place in the calibrated picture is known, given or estimated."""
        return bool(self.placed) or not np.array_equal(self.calibration_from_video, np.eye(2, 3))

    def as_json(self) -> dict[str, Any]:
        return dict(vars(self))
