# SPDX-License-Identifier: Apache-2.0
"""Furniture as upright boxes (primitives), and their intersections with camera rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ListOf, metres, radians, real
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_PRIMITIVE = {
    "centre_m": metres("2"),
    "yaw_rad": radians(),
    "size_m": metres("2", above=0),
    "low_m": metres(),
    "high_m": metres(),
    "evidence": real(),
}


@dataclass(frozen=True)
class Primitive:
    """One upright box.

    Attributes:
        centre_m: x and y of its middle in the world.
        yaw_rad: direction of its first side.
        size_m: lengths along and across that direction.
        low_m, high_m: heights of foot and top.
        evidence: disagreement between the photos that it removes, in pixels, at the width of the fit.
    """

    centre_m: tuple[float, float]
    yaw_rad: float
    size_m: tuple[float, float]
    low_m: float
    high_m: float
    evidence: float

    @property
    def numbers(self) -> Float[np.ndarray, " 7"]:
        """X, y, yaw, both sizes, foot, top: the layout of the kernels."""
        return np.array([*self.centre_m, self.yaw_rad, *self.size_m, self.low_m, self.high_m], np.float64)

    @staticmethod
    def from_numbers(numbers: Float[np.ndarray, " 7"], evidence: float) -> Primitive:
        x, y, yaw, along, across, low, high = (float(n) for n in numbers)
        return Primitive((x, y), yaw, (along, across), low, high, evidence)

    def depth(self, camera: Camera) -> Float[np.ndarray, "H W"]:
        """Z-depth at which a camera's rays enter the primitive; 0 where they miss it."""
        origin, rays = camera.rays()
        depth_m = np.zeros(camera.hw)
        _meet(self.numbers, origin, rays.reshape(-1, 3), depth_m.reshape(-1))
        return depth_m


def depth_with_primitives(
    primitives: Sequence[Primitive], camera: Camera, depth_m: Float[np.ndarray, "H W"]
) -> tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Depth with every nearer primitive, and where a primitive is visible; unknown depth (0) counts as behind."""
    nearest = np.where(depth_m > 0, depth_m, np.inf)
    shown = np.zeros(depth_m.shape, bool)
    for primitive in primitives:
        entered = primitive.depth(camera)
        before = (entered > 0) & (entered < nearest)
        nearest, shown = np.where(before, entered, nearest), shown | before
    return np.where(np.isfinite(nearest), nearest, 0).astype(depth_m.dtype), shown


def write_primitives(path: Path, primitives: Sequence[Primitive]) -> None:
    """Write ``depth/primitives.json``: the primitives in the order of selection."""
    write_json(path, {"primitives": [dict(vars(primitive)) for primitive in primitives]})


def read_primitives(path: Path) -> list[Primitive]:
    """The primitives in ``depth/primitives.json``; raises UserError as ``step_files.read`` does."""
    return read(path, {"primitives": ListOf(_PRIMITIVE)}, lambda value: [_primitive(v) for v in value["primitives"]])


def _primitive(value: dict[str, Any]) -> Primitive:
    made = Primitive(**{**value, "centre_m": tuple(value["centre_m"]), "size_m": tuple(value["size_m"])})
    expect(made.low_m < made.high_m, f"low_m is {made.low_m:g}, not below high_m, {made.high_m:g}")
    return made


@njit(cache=True)
def _meet(primitive, origin, rays, depth_m):
    normal = np.zeros(3)
    c, s = np.cos(primitive[2]), np.sin(primitive[2])
    for i in range(len(rays)):
        depth_m[i] = max(ray_entry_length(primitive, c, s, origin, rays[i], normal), 0.0)


@njit(cache=True)
def ray_entry_length(primitive, c, s, origin, ray, normal):
    """Length along ``ray`` at which it enters a primitive, -1 if it misses; fills the outward ``normal`` there.

    ``c`` and ``s`` are the cosine and sine of its yaw. A ray that starts inside misses, so that a camera inside a piece
    of furniture sees the room.
    """
    x, y = origin[0] - primitive[0], origin[1] - primitive[1]
    ou, ov = c * x + s * y, c * y - s * x
    du, dv = c * ray[0] + s * ray[1], c * ray[1] - s * ray[0]
    near, far = -np.inf, np.inf
    nu, nv, nz = 0.0, 0.0, 0.0
    for axis in range(2):
        o, d, half = (ou, du, primitive[3] / 2) if axis == 0 else (ov, dv, primitive[4] / 2)
        if abs(d) < 1e-12:
            if abs(o) > half:
                return -1.0
            continue
        a, b = (-half - o) / d, (half - o) / d
        if min(a, b) > near:
            near = min(a, b)
            nu, nv = (-np.sign(d), 0.0) if axis == 0 else (0.0, -np.sign(d))
        far = min(far, max(a, b))
    if abs(ray[2]) < 1e-12:
        if origin[2] < primitive[5] or origin[2] > primitive[6]:
            return -1.0
    else:
        a, b = (primitive[5] - origin[2]) / ray[2], (primitive[6] - origin[2]) / ray[2]
        if min(a, b) > near:
            near = min(a, b)
            nu, nv, nz = 0.0, 0.0, -np.sign(ray[2])
        far = min(far, max(a, b))
    if near >= far or near <= 0:
        return -1.0
    normal[0], normal[1], normal[2] = c * nu - s * nv, s * nu + c * nv, nz
    return near
