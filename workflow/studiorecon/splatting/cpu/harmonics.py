# SPDX-License-Identifier: Apache-2.0
"""Colour from spherical harmonics (degree 0 to 3, 3DGS order and signs), sixteen Gaussians at a time, and its gradient.

``degree_supported`` computes how many bands the cameras can distinguish.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.splatting.conventions import INLINE, LANES, SH
from studiorecon.splatting.cpu.simd import broadcast, madd, where
from studiorecon.splatting.cpu.simd_rows import load, store

if TYPE_CHECKING:
    from jaxtyping import Num

C0 = np.float32(0.28209479177387814)
C1 = np.float32(0.4886025119029199)
D0, D2, D4 = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)
T0, T1, T2 = np.float32(-0.5900435899266435), np.float32(2.890611442640554), np.float32(-0.4570457994644658)
T3, T5 = np.float32(0.3731763325901154), np.float32(1.445305721320277)

BAND = 3 * LANES
"""Floats from one band's coefficients to the next one's. Kernels add it up where they call: numba compiles a function
anew for every literal number it is given."""
DEGREE_MAX = 3
DISTINCT_DEG = 5.0
"""Directions closer than this show the same colour of every band up to degree 3, so they count once."""


def degree_supported(directions: Num[np.ndarray, "N 3"]) -> int:
    """The largest degree d, at most 3, for which there are (d + 1)² distinct viewing directions (G15).

    ``directions`` point from the surface to the cameras; zeros and NaN do not count. With fewer directions than
    coefficients, the bands fit every camera's exposure error exactly and invent colours in between.
    """
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    usable = np.isfinite(length[:, 0]) & (length[:, 0] > 0)
    distinct: list[np.ndarray] = []
    for unit in directions[usable] / length[usable]:
        if all(unit @ other < np.cos(np.radians(DISTINCT_DEG)) for other in distinct):
            distinct.append(unit)
    return max(0, min(DEGREE_MAX, int(np.sqrt(len(distinct))) - 1))


@njit(**INLINE)
def degree_one(x, y, z):
    """Three basis functions of degree 1 at unit directions."""
    return -C1 * y, C1 * z, -C1 * x


@njit(**INLINE)
def degree_two(x, y, z):
    """Five basis functions of degree 2 at unit directions."""
    return D0 * x * y, -D0 * y * z, D2 * (2 * z * z - x * x - y * y), -D0 * x * z, D4 * (x * x - y * y)


@njit(**INLINE)
def degree_three(x, y, z):
    """Seven basis functions of degree 3 at unit directions."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        T0 * y * (3 * xx - yy),
        T1 * x * y * z,
        T2 * y * (4 * zz - xx - yy),
        T3 * z * (2 * zz - 3 * xx - 3 * yy),
        T2 * x * (4 * zz - xx - yy),
        T5 * z * (xx - yy),
        T0 * x * (xx - 3 * yy),
    )


@njit(**INLINE)
def _accumulate(parameters, row, weight, red, green, blue):
    return (
        madd(weight, load(parameters, row), red),
        madd(weight, load(parameters, row + LANES), green),
        madd(weight, load(parameters, row + 2 * LANES), blue),
    )


@njit(**INLINE)
def colour(parameters, base, degree, x, y, z):
    """Red, green and blue (not yet clamped at 0) of the block at ``base`` seen along the unit directions (x, y, z)."""
    first, half = base + SH * LANES, broadcast(np.float32(0.5))
    r, g, b = _accumulate(parameters, first, broadcast(C0), half, half, half)
    if degree > 0:
        w1, w2, w3 = degree_one(x, y, z)
        r, g, b = _accumulate(parameters, first + 1 * BAND, w1, r, g, b)
        r, g, b = _accumulate(parameters, first + 2 * BAND, w2, r, g, b)
        r, g, b = _accumulate(parameters, first + 3 * BAND, w3, r, g, b)
    if degree > 1:
        w4, w5, w6, w7, w8 = degree_two(x, y, z)
        r, g, b = _accumulate(parameters, first + 4 * BAND, w4, r, g, b)
        r, g, b = _accumulate(parameters, first + 5 * BAND, w5, r, g, b)
        r, g, b = _accumulate(parameters, first + 6 * BAND, w6, r, g, b)
        r, g, b = _accumulate(parameters, first + 7 * BAND, w7, r, g, b)
        r, g, b = _accumulate(parameters, first + 8 * BAND, w8, r, g, b)
    if degree > 2:
        w9, w10, w11, w12, w13, w14, w15 = degree_three(x, y, z)
        r, g, b = _accumulate(parameters, first + 9 * BAND, w9, r, g, b)
        r, g, b = _accumulate(parameters, first + 10 * BAND, w10, r, g, b)
        r, g, b = _accumulate(parameters, first + 11 * BAND, w11, r, g, b)
        r, g, b = _accumulate(parameters, first + 12 * BAND, w12, r, g, b)
        r, g, b = _accumulate(parameters, first + 13 * BAND, w13, r, g, b)
        r, g, b = _accumulate(parameters, first + 14 * BAND, w14, r, g, b)
        r, g, b = _accumulate(parameters, first + 15 * BAND, w15, r, g, b)
    return r, g, b


@njit(**INLINE)
def _spread(parameters, gradient, row, mask, weight, red, green, blue):
    """Store the gradient of the band at ``row`` and return dL/d(basis function)."""
    store(gradient, row, where(mask, weight * red))
    store(gradient, row + LANES, where(mask, weight * green))
    store(gradient, row + 2 * LANES, where(mask, weight * blue))
    return madd(
        red, load(parameters, row), madd(green, load(parameters, row + LANES), blue * load(parameters, row + 2 * LANES))
    )


@njit(**INLINE)
def colour_gradient(parameters, gradient, base, degree, mask, x, y, z, red, green, blue):
    """Store the gradients of all harmonics for colour gradients, 0 outside ``mask``; return dL/d(x, y, z), not
    tangential.
    """
    first = base + SH * LANES
    _spread(parameters, gradient, first, mask, broadcast(C0), red, green, blue)
    dx = broadcast(np.float32(0))
    dy, dz = dx, dx
    if degree > 0:
        w1, w2, w3 = degree_one(x, y, z)
        dy = dy - C1 * _spread(parameters, gradient, first + 1 * BAND, mask, w1, red, green, blue)
        dz = dz + C1 * _spread(parameters, gradient, first + 2 * BAND, mask, w2, red, green, blue)
        dx = dx - C1 * _spread(parameters, gradient, first + 3 * BAND, mask, w3, red, green, blue)
    if degree > 1:
        w4, w5, w6, w7, w8 = degree_two(x, y, z)
        f4 = D0 * _spread(parameters, gradient, first + 4 * BAND, mask, w4, red, green, blue)
        f5 = D0 * _spread(parameters, gradient, first + 5 * BAND, mask, w5, red, green, blue)
        f6 = (2 * D2) * _spread(parameters, gradient, first + 6 * BAND, mask, w6, red, green, blue)
        f7 = D0 * _spread(parameters, gradient, first + 7 * BAND, mask, w7, red, green, blue)
        f8 = (2 * D4) * _spread(parameters, gradient, first + 8 * BAND, mask, w8, red, green, blue)
        dx = dx + y * f4 - x * f6 - z * f7 + x * f8
        dy = dy + x * f4 - z * f5 - y * f6 - y * f8
        dz = dz - y * f5 + 2 * z * f6 - x * f7
    if degree > 2:
        w9, w10, w11, w12, w13, w14, w15 = degree_three(x, y, z)
        f9 = T0 * _spread(parameters, gradient, first + 9 * BAND, mask, w9, red, green, blue)
        f10 = T1 * _spread(parameters, gradient, first + 10 * BAND, mask, w10, red, green, blue)
        f11 = T2 * _spread(parameters, gradient, first + 11 * BAND, mask, w11, red, green, blue)
        f12 = T3 * _spread(parameters, gradient, first + 12 * BAND, mask, w12, red, green, blue)
        f13 = T2 * _spread(parameters, gradient, first + 13 * BAND, mask, w13, red, green, blue)
        f14 = T5 * _spread(parameters, gradient, first + 14 * BAND, mask, w14, red, green, blue)
        f15 = T0 * _spread(parameters, gradient, first + 15 * BAND, mask, w15, red, green, blue)
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        dx = dx + 6 * xy * f9 + yz * f10 - 2 * xy * f11 - 6 * xz * f12
        dx = dx + (4 * zz - 3 * xx - yy) * f13 + 2 * xz * f14 + 3 * (xx - yy) * f15
        dy = dy + 3 * (xx - yy) * f9 + xz * f10 + (4 * zz - xx - 3 * yy) * f11 - 6 * yz * f12
        dy = dy - 2 * xy * f13 - 2 * yz * f14 - 6 * xy * f15
        dz = dz + xy * f10 + 8 * yz * f11 + (6 * zz - 3 * xx - 3 * yy) * f12 + 8 * xz * f13 + (xx - yy) * f14
    return dx, dy, dz
