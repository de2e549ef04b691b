# SPDX-License-Identifier: Apache-2.0
"""The same cameras in a world that was turned, shifted and enlarged, and the strategies that draw such worlds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera

# The same examples in every run, few enough for every push.
FEW = settings(max_examples=15, deadline=None, derandomize=True)
MANY = settings(max_examples=60, deadline=None, derandomize=True)


@dataclass(frozen=True)
class World:
    """New point = scale · rotation (3, 3) · old point + shift (3,)."""

    rotation: np.ndarray
    shift: np.ndarray
    scale: float = 1.0

    def points(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.shift

    def camera(self, camera: Camera) -> Camera:
        """The camera that sees of the new world what ``camera`` saw of the old one."""
        turned = camera.rotation_camera_from_world @ self.rotation.T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned, -turned @ self.points(camera.centre_m)
        return replace(camera, camera_from_world=pose)


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


def vectors(reach: float) -> st.SearchStrategy[np.ndarray]:
    return st.tuples(*[numbers(-reach, reach)] * 3).map(np.array)


def turns() -> st.SearchStrategy[np.ndarray]:
    """Rotations by up to five radians about any axis."""
    return vectors(2.9).map(exp)


def worlds() -> st.SearchStrategy[World]:
    return st.builds(World, turns(), vectors(20.0), numbers(0.5, 2.0))


def rigid_worlds() -> st.SearchStrategy[World]:
    return st.builds(World, turns(), vectors(20.0))


def level_worlds(scaled: bool = False) -> st.SearchStrategy[World]:
    """Worlds that keep the floor: turned about the vertical, shifted along the floor."""
    about_z = numbers(-3.1, 3.1).map(lambda a: exp([0, 0, a]))
    along = st.tuples(numbers(-20, 20), numbers(-20, 20)).map(lambda v: np.array([*v, 0.0]))
    return st.builds(World, about_z, along, numbers(0.5, 2.0) if scaled else st.just(1.0))
