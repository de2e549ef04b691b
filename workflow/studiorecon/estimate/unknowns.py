# SPDX-License-Identifier: Apache-2.0
"""The unknowns of an estimate as one vector: cameras first, then points, then named others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Numbers of a camera: turn about its own axes (rad), centre (m), log focal length, k1, principal point (px).
TURN, CENTRE, LOG_FOCAL, RADIAL, PRINCIPAL = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10)
PER_CAMERA = 10


@dataclass(frozen=True)
class Unknowns:
    """Values of all unknowns.

    Attributes:
        rotations: camera from world; a camera's turn is a small rotation on the left of it.
        values: all numbers; turns are 0, because steps are multiplied into ``rotations``.
        starts: name of a group of numbers → where it begins in ``values``.
    """

    rotations: Num[np.ndarray, "V 3 3"]
    values: Num[np.ndarray, " U"]
    starts: Mapping[str, int]

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        radial: Num[np.ndarray, " V"],
        points_m: Num[np.ndarray, "N 3"],
        **others: Num[np.ndarray, " M"],
    ) -> Unknowns:
        """The unknowns that begin at ``cameras`` with their ``radial`` terms k1, ``points_m`` and ``others``."""
        numbers = np.zeros((len(cameras), PER_CAMERA))
        for v, camera in enumerate(cameras):
            numbers[v, CENTRE], numbers[v, LOG_FOCAL] = camera.centre_m, np.log(camera.focal_px[0])
            numbers[v, RADIAL], numbers[v, PRINCIPAL] = radial[v], camera.principal_px
        parts = {"cameras": numbers.ravel(), "points": np.asarray(points_m, np.float64).ravel(), **others}
        starts, at = {}, 0
        for name, part in parts.items():
            starts[name], at = at, at + len(part)
        return cls(
            np.stack([c.camera_from_world[:3, :3] for c in cameras]), np.concatenate(list(parts.values())), starts
        )

    @property
    def views(self) -> int:
        return len(self.rotations)

    @property
    def of_cameras(self) -> Num[np.ndarray, "V 10"]:
        """Numbers of the cameras."""
        return self.values[: PER_CAMERA * self.views].reshape(-1, PER_CAMERA)

    def columns(
        self, name: str, row: Integer[np.ndarray, " M"] | int, numbers: Sequence[int] | range, width: int
    ) -> Integer[np.ndarray, "M K"]:
        """Indices of ``numbers`` of the rows ``row`` of a group whose rows have ``width`` numbers."""
        return self.starts[name] + np.atleast_1d(row)[:, None] * width + np.asarray(numbers)[None]

    def camera(self, like: Camera, view: int) -> Camera:
        """The pinhole of a view; name and size are those of ``like``."""
        numbers, pose = self.of_cameras[view], np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotations[view], -self.rotations[view] @ numbers[CENTRE]
        focal = np.exp(numbers[LOG_FOCAL])
        (cx, cy), aspect = numbers[PRINCIPAL], like.focal_px[1] / like.focal_px[0]
        return replace(
            like, intrinsics=np.array([[focal, 0, cx], [0, focal * aspect, cy], [0, 0, 1.0]]), camera_from_world=pose
        )

    def group(self, name: str, size: int) -> Num[np.ndarray, " M"]:
        """The ``size`` numbers of a group."""
        return self.values[self.starts[name] : self.starts[name] + size]

    def with_group(self, name: str, numbers: Num[np.ndarray, " M"]) -> Unknowns:
        """The unknowns with other ``numbers`` of a group."""
        values = self.values.copy()
        values[self.starts[name] : self.starts[name] + len(numbers)] = numbers
        return replace(self, values=values)

    def moved(self, step: Num[np.ndarray, " U"]) -> Unknowns:
        """The unknowns after a step."""
        values = self.values + step
        turns = values[: PER_CAMERA * self.views].reshape(-1, PER_CAMERA)[:, TURN]
        rotations = exp(turns) @ self.rotations
        turns[:] = 0.0
        return replace(self, rotations=rotations, values=values)
