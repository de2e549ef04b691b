# SPDX-License-Identifier: Apache-2.0
"""Projects parameter blocks to splat records: EWA projection (3DGS), sixteen Gaussians at a time.

A splat is the ellipse q = A·(dx − k·dy)² + c·dy² with alpha = 2^(log2 opacity − q); A = s·Syy/det, k = Sxy/Syy, c =
s/Syy with s = log2(e)/2 and det = |m1×m2|² + e(|m1|² + |m2|²) + e², where m1, m2 are the rows of J·W·R·S and e is the
dilation. Unlike the usual conic from a·c − b², nothing cancels: on 300:1 needles in float32 the worst error is 1e-5
instead of 19 %.

Dilation makes small splats too bright (121 times at σ 0.05 px, G06). With energy compensation (Mip-Splatting) the
opacity is multiplied by √(|m1×m2|² / det), the ratio of the two areas; as a sum of squares it is never negative.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from studiorecon.splatting.conventions import (
    ALPHA_LOG2_MIN,
    BLOCK_FLOATS,
    CENTRE,
    COMPENSATED,
    DILATION_PX2,
    FOCAL,
    INLINE,
    KERNEL,
    LANES,
    LIMITS,
    LOG2_E,
    NEAR,
    OPACITY,
    PIECE,
    PRINCIPAL,
    QUATERNION,
    RECORD,
    SANE,
    SCALE,
    SIZE,
)
from studiorecon.splatting.cpu.harmonics import colour
from studiorecon.splatting.cpu.simd import (
    above,
    at_least,
    below,
    bits_from_mask,
    both,
    broadcast,
    least,
    log2,
    magnitude,
    mask_from_bits,
    most,
    root,
    select,
    where,
    zeros,
)
from studiorecon.splatting.cpu.simd_rows import load, store, store_records

HALF_LOG2_E = np.float32(0.5) * LOG2_E
OPACITY_MIN = np.float32(1e-12)
"""Opacities are raised to this before the logarithm: far below 1/255, and a normal float."""
SQUARE_MIN = np.float32(1e-30)
"""Added to squared lengths before a division."""


@njit(**INLINE)
def in_camera(parameters, base, camera):
    """Camera coordinates of the block's means."""
    x, y, z = load(parameters, base), load(parameters, base + LANES), load(parameters, base + 2 * LANES)
    return (
        camera[0] * x + camera[1] * y + camera[2] * z + camera[9],
        camera[3] * x + camera[4] * y + camera[5] * z + camera[10],
        camera[6] * x + camera[7] * y + camera[8] * z + camera[11],
    )


@njit(**INLINE)
def unit_quaternion(parameters, base):
    """Normalised (w, x, y, z) of the block, one over the norm, and the squared norm; no rotation for zero
    quaternions."""
    row = base + QUATERNION * LANES
    w, x, y, z = (
        load(parameters, row),
        load(parameters, row + LANES),
        load(parameters, row + 2 * LANES),
        load(parameters, row + 3 * LANES),
    )
    square = w * w + x * x + y * y + z * z
    inverse = np.float32(1) / root(square + SQUARE_MIN)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse, square


@njit(**INLINE)
def rotation(w, x, y, z):
    """Row-major rotation matrix of unit quaternions."""
    return (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )


@njit(**INLINE)
def image_from_world(camera, ax, ay, inverse_depth):
    """J·W, two rows: derivative of the pixel by the world position at tangents (ax, ay)."""
    sx, sy = camera[FOCAL] * inverse_depth, camera[FOCAL + 1] * inverse_depth
    return (
        sx * (camera[0] - ax * camera[6]),
        sx * (camera[1] - ax * camera[7]),
        sx * (camera[2] - ax * camera[8]),
        sy * (camera[3] - ay * camera[6]),
        sy * (camera[4] - ay * camera[7]),
        sy * (camera[5] - ay * camera[8]),
    )


@njit(**INLINE)
def axes_in_image(t, r):
    """J·W·R, two rows of three: the Gaussian's unit axes in the image."""
    t00, t01, t02, t10, t11, t12 = t
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = r
    return (
        t00 * r00 + t01 * r10 + t02 * r20,
        t00 * r01 + t01 * r11 + t02 * r21,
        t00 * r02 + t01 * r12 + t02 * r22,
        t10 * r00 + t11 * r10 + t12 * r20,
        t10 * r01 + t11 * r11 + t12 * r21,
        t10 * r02 + t11 * r12 + t12 * r22,
    )


@njit(**INLINE)
def covariance(a0, a1, a2, b0, b1, b2):
    """Dilated Sxx, Syy, Sxy of the image covariance with rows m1 = a, m2 = b; its determinant with and without
    dilation.

    Both determinants are sums of squares, so nothing cancels (G03, G04).
    """
    xx, yy, xy = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2, a0 * b0 + a1 * b1 + a2 * b2
    c0, c1, c2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    sharp = c0 * c0 + c1 * c1 + c2 * c2
    determinant = sharp + DILATION_PX2 * (xx + yy) + DILATION_PX2 * DILATION_PX2
    return xx + DILATION_PX2, yy + DILATION_PX2, xy, determinant, sharp


@njit(**INLINE)
def direction(parameters, base, camera):
    """Unit direction from the camera to the block's means, and one over the distance."""
    x = load(parameters, base) - camera[CENTRE]
    y = load(parameters, base + LANES) - camera[CENTRE + 1]
    z = load(parameters, base + 2 * LANES) - camera[CENTRE + 2]
    inverse = np.float32(1) / root(x * x + y * y + z * z + SQUARE_MIN)
    return x * inverse, y * inverse, z * inverse, inverse


@njit(**INLINE)
def _sane_parameters(parameters, base, square):
    """Lanes whose position, scale, rotation and opacity are finite and below absurd sizes."""
    limit = broadcast(SANE)
    sane = both(
        below(square, broadcast(np.float32(np.inf))), at_least(load(parameters, base + OPACITY * LANES), zeros())
    )
    for axis in range(3):
        sane = both(sane, below(magnitude(load(parameters, base + axis * LANES)), limit))
        sane = both(sane, below(magnitude(load(parameters, base + (SCALE + axis) * LANES)), limit))
    return sane


@njit(**KERNEL)
def _project_blocks(begin, end, parameters, camera, degree, splats, depth_m, visible, refused):
    left, right, top, bottom = camera[LIMITS], camera[LIMITS + 1], camera[LIMITS + 2], camera[LIMITS + 3]
    one, zero, limit = broadcast(np.float32(1)), zeros(), broadcast(SANE)
    for block in range(begin, end):
        first, base = block * LANES, block * BLOCK_FLOATS
        x, y, z = in_camera(parameters, base, camera)
        front = above(z, broadcast(camera[NEAR]))
        inverse_depth = one / select(front, z, one)
        ax, ay = x * inverse_depth, y * inverse_depth
        px, py = camera[FOCAL] * ax + camera[PRINCIPAL], camera[FOCAL + 1] * ay + camera[PRINCIPAL + 1]
        ax, ay = least(most(ax, broadcast(left)), broadcast(right)), least(most(ay, broadcast(top)), broadcast(bottom))
        qw, qx, qy, qz, _, square = unit_quaternion(parameters, base)
        a0, a1, a2, b0, b1, b2 = axes_in_image(
            image_from_world(camera, ax, ay, inverse_depth), rotation(qw, qx, qy, qz)
        )
        row = base + SCALE * LANES
        s0, s1, s2 = load(parameters, row), load(parameters, row + LANES), load(parameters, row + 2 * LANES)
        xx, yy, xy, determinant, sharp = covariance(a0 * s0, a1 * s1, a2 * s2, b0 * s0, b1 * s1, b2 * s2)
        a, k, c = HALF_LOG2_E * yy / determinant, xy / yy, HALF_LOG2_E / yy
        opacity = load(parameters, base + OPACITY * LANES)
        if camera[COMPENSATED] > 0:
            opacity = opacity * root(sharp / determinant)
        opacity = log2(most(opacity, broadcast(OPACITY_MIN)))
        # The ellipse where alpha falls to 1/255, and its bounding box.
        reach = opacity - ALPHA_LOG2_MIN
        square_radius = most(reach, zero) * (np.float32(2) / LOG2_E)
        half_w, half_h = root(square_radius * xx), root(square_radius * yy)
        in_x = both(above(px + half_w, zero), below(px - half_w, broadcast(camera[SIZE])))
        in_y = both(above(py + half_h, zero), below(py - half_h, broadcast(camera[SIZE + 1])))
        seen = both(both(front, at_least(reach, zero)), both(in_x, in_y))
        sane = _sane_parameters(parameters, base, square)
        drawable = both(
            both(below(half_w, limit), below(half_h, limit)),
            both(below(magnitude(px), limit), below(magnitude(py), limit)),
        )
        tiny = broadcast(np.float32(1e-25))
        drawable = both(drawable, both(below(magnitude(k), limit), both(above(a, tiny), above(c, tiny))))
        insane = bits_from_mask(sane) ^ 0xFFFF
        bits = bits_from_mask(both(both(seen, sane), drawable))
        insane |= bits_from_mask(seen) & (bits_from_mask(drawable) ^ 0xFFFF)
        if bits:
            dx, dy, dz, _ = direction(parameters, base, camera)
            red, green, blue = colour(parameters, base, degree, dx, dy, dz)
            shown = both(
                below(magnitude(red), limit), both(below(magnitude(green), limit), below(magnitude(blue), limit))
            )
            insane |= bits & (bits_from_mask(shown) ^ 0xFFFF)
            bits &= bits_from_mask(shown)
            kept = mask_from_bits(bits)
            store_records(
                splats,
                first * RECORD,
                px,
                py,
                a,
                k,
                c,
                opacity,
                where(kept, most(red, zero)),
                where(kept, most(green, zero)),
                where(kept, most(blue, zero)),
                z,
                half_w,
                half_h,
            )
            store(depth_m, first, z)
        count = 0
        for lane in range(LANES):
            visible[first + lane] = (bits >> lane) & 1
            count += (insane >> lane) & 1
        refused[block] = count


@njit(parallel=True, **KERNEL)
def project(parameters, camera, degree, splats, depth_m, visible, refused):
    """Fill records (N·16), depths (N) and visibility (N, 0/1); ``refused`` (N/16) counts Gaussians with absurd values.

    Records of lanes that are not visible are left unchanged.
    """
    blocks = len(visible) // LANES
    for piece in prange(-(-blocks // PIECE)):
        begin = piece * PIECE
        _project_blocks(
            begin, min(begin + PIECE, blocks), parameters, camera, degree, splats, depth_m, visible, refused
        )
