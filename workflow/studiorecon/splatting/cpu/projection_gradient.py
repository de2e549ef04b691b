# SPDX-License-Identifier: Apache-2.0
"""Moments of the backward pass → gradients of the parameter blocks; the projection is computed again, not stored."""

from __future__ import annotations

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import (
    BLOCK_FLOATS,
    BLUE,
    COMPENSATED,
    DILATION_PX2,
    FOCAL,
    GREEN,
    INLINE,
    KERNEL,
    LANES,
    LIMITS,
    NEAR,
    OPACITY,
    PIECE,
    QUATERNION,
    RECORD,
    RED,
    SCALE,
)
from studiorecon.splatting.cpu.harmonics import colour_gradient
from studiorecon.splatting.cpu.projection import (
    OPACITY_MIN,
    axes_in_image,
    covariance,
    direction,
    image_from_world,
    in_camera,
    rotation,
    unit_quaternion,
)
from studiorecon.splatting.cpu.simd import (
    above,
    at_least,
    below,
    both,
    broadcast,
    least,
    magnitude,
    mask_from_bits,
    most,
    select,
    where,
)
from studiorecon.splatting.cpu.simd_rows import item, load, store, take_moments

QUATERNION_SQUARE_MIN = np.float32(1e-24)
"""Quaternions shorter than 1e-12 get no gradient: its size would be one over their norm."""
_STEEPEST = np.float32(1e30)


@njit(**INLINE)
def _positive(splats, first, field):
    """Bits of the records from ``first`` on whose ``field`` is above 0."""
    bits = int64(0)
    for lane in range(LANES):
        bits |= int64(item(splats, (first + lane) * RECORD + field) > float32(0)) << lane
    return bits


@njit(**INLINE)
def _moments(moments, first, size, shares):
    """The ten moments of sixteen Gaussians, summed over shares in order; sets the records to zero."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8, m9 = take_moments(moments, first * RECORD)
    for share in range(1, shares):
        n0, n1, n2, n3, n4, n5, n6, n7, n8, n9 = take_moments(moments, (share * size + first) * RECORD)
        m0, m1, m2, m3, m4 = m0 + n0, m1 + n1, m2 + n2, m3 + n3, m4 + n4
        m5, m6, m7, m8, m9 = m5 + n5, m6 + n6, m7 + n7, m8 + n8, m9 + n9
    return m0, m1, m2, m3, m4, m5, m6, m7, m8, m9


@njit(**INLINE)
def _across(e, h, a1, b1, a2, b2):
    """Syy·(e − k·h) for one unit axis (e, h) of the Gaussian and the other two scaled ones, without cancellation."""
    return b1 * (e * b1 - a1 * h) + b2 * (e * b2 - a2 * h) + DILATION_PX2 * e


@njit(**INLINE)
def _compensation_gradient(m0, trace, determinant, sharp, a0, a1, a2, b0, b1, b2):
    """m0 times the gradient of ln √(sharp / determinant) by the rows a and b.

    With s = |a×b|² it is (b×(a×b), (a×b)×a)·(1/s − 1/det) − e·(a, b)/det. Where s → 0 it diverges, but there the splat
    fades below 1/255 and is not drawn, so every drawn splat has s > 1e-6.
    """
    c0, c1, c2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    outer = m0 * DILATION_PX2 / determinant
    inner = outer * (trace - DILATION_PX2) / sharp
    return (
        inner * (b1 * c2 - b2 * c1) - outer * a0,
        inner * (b2 * c0 - b0 * c2) - outer * a1,
        inner * (b0 * c1 - b1 * c0) - outer * a2,
        inner * (c1 * a2 - c2 * a1) - outer * b0,
        inner * (c2 * a0 - c0 * a2) - outer * b1,
        inner * (c0 * a1 - c1 * a0) - outer * b2,
    )


@njit(**INLINE)
def _quaternion_gradient(w, x, y, z, t0, t1, t2):
    """2·q⊗(0, t): gradient by a unit quaternion, tangent to the sphere, of a torque about the Gaussian's own axes."""
    return (
        -2 * (x * t0 + y * t1 + z * t2),
        2 * (w * t0 + y * t2 - z * t1),
        2 * (w * t1 + z * t0 - x * t2),
        2 * (w * t2 + x * t1 - y * t0),
    )


@njit(**KERNEL)
def _gradients_of_blocks(begin, end, parameters, camera, degree, splats, visible, moments, gradient, screen):
    size = len(visible)
    shares = len(moments) // (RECORD * size)
    left, right, top, bottom = camera[LIMITS], camera[LIMITS + 1], camera[LIMITS + 2], camera[LIMITS + 3]
    fx, fy = camera[FOCAL], camera[FOCAL + 1]
    for block in range(begin, end):
        first, base = block * LANES, block * BLOCK_FLOATS
        bits = int64(0)
        for lane in range(LANES):
            bits |= int64(visible[first + lane]) << lane
        if bits == 0:
            continue
        seen = mask_from_bits(bits)
        # Repeats the forward projection.
        x, y, z = in_camera(parameters, base, camera)
        inverse_depth = float32(1) / select(above(z, broadcast(camera[NEAR])), z, broadcast(float32(1)))
        tangent_x, tangent_y = x * inverse_depth, y * inverse_depth
        ax = least(most(tangent_x, broadcast(left)), broadcast(right))
        ay = least(most(tangent_y, broadcast(top)), broadcast(bottom))
        free_x = both(at_least(tangent_x, broadcast(left)), at_least(broadcast(right), tangent_x))
        free_y = both(at_least(tangent_y, broadcast(top)), at_least(broadcast(bottom), tangent_y))
        qw, qx, qy, qz, inverse_norm, square = unit_quaternion(parameters, base)
        r = rotation(qw, qx, qy, qz)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = r
        e0, e1, e2, h0, h1, h2 = axes_in_image(image_from_world(camera, ax, ay, inverse_depth), r)
        row = base + SCALE * LANES
        s0, s1, s2 = load(parameters, row), load(parameters, row + LANES), load(parameters, row + 2 * LANES)
        a0, a1, a2, b0, b1, b2 = e0 * s0, e1 * s1, e2 * s2, h0 * s0, h1 * s1, h2 * s2
        xx, yy, xy, determinant, sharp = covariance(a0, a1, a2, b0, b1, b2)
        ellipse_a, inverse_yy = yy / determinant, float32(1) / yy
        k = xy * inverse_yy
        # Moments → gradients by the centre and by the ellipse (A, k, c), here without the factor log2(e)/2.
        m0, m1, m2, m3, m4, m5, m6, m7, m8, m9 = _moments(moments, first, size, shares)
        m0, m1, m2 = where(seen, m0), where(seen, m1), where(seen, m2)
        by_a, by_k, by_c = float32(-0.5) * where(seen, m3), ellipse_a * where(seen, m4), float32(-0.5) * where(seen, m5)
        by_px = ellipse_a * m1
        by_py = inverse_yy * m2 - k * by_px
        store(screen, first, where(seen, by_px))
        store(screen, size + first, where(seen, by_py))
        # → by the rows a, b of the image covariance's root, through f = e − k·h: the part of each axis across the
        # conjugate one. Written as cross products it does not cancel, which the same in (Sxx, Sxy, Syy) does along
        # needles.
        f0, f1, f2 = _across(e0, h0, a1, b1, a2, b2), _across(e1, h1, a2, b2, a0, b0), _across(e2, h2, a0, b0, a1, b1)
        f0, f1, f2 = f0 * inverse_yy, f1 * inverse_yy, f2 * inverse_yy
        w0, w1, w2 = f0 * s0, f1 * s1, f2 * s2
        p, q, v = -2 * ellipse_a * ellipse_a * by_a, inverse_yy * by_k, -2 * inverse_yy * inverse_yy * by_c
        ga0, ga1, ga2 = p * w0 + q * b0, p * w1 + q * b1, p * w2 + q * b2
        z0, z1, z2 = q * w0 + v * b0, q * w1 + v * b1, q * w2 + v * b2
        if camera[COMPENSATED] > 0:
            x0, x1, x2, y0, y1, y2 = _compensation_gradient(m0, xx + yy, determinant, sharp, a0, a1, a2, b0, b1, b2)
            ga0, ga1, ga2 = ga0 + x0, ga1 + x1, ga2 + x2
            z0, z1, z2 = z0 + y0 + k * x0, z1 + y1 + k * x1, z2 + y2 + k * x2
        gb0, gb1, gb2 = z0 - k * ga0, z1 - k * ga1, z2 - k * ga2
        store(gradient, row, where(seen, ga0 * f0 + z0 * h0))
        store(gradient, row + LANES, where(seen, ga1 * f1 + z1 * h1))
        store(gradient, row + 2 * LANES, where(seen, ga2 * f2 + z2 * h2))
        pa0, pa1, pa2, pb0, pb1, pb2 = ga0 * s0, ga1 * s1, ga2 * s2, gb0 * s0, gb1 * s1, gb2 * s2
        # Torque about the Gaussian's own axes: a gradient by rotations alone, so nothing has to be projected out
        # afterwards.
        torque0 = pa1 * f2 - pa2 * f1 + s1 * z1 * h2 - s2 * z2 * h1
        torque1 = pa2 * f0 - pa0 * f2 + s2 * z2 * h0 - s0 * z0 * h2
        torque2 = pa0 * f1 - pa1 * f0 + s0 * z0 * h1 - s1 * z1 * h0
        gw, gx, gy, gz = _quaternion_gradient(qw, qx, qy, qz, torque0, torque1, torque2)
        turned = both(seen, above(square, broadcast(QUATERNION_SQUARE_MIN)))
        row = base + QUATERNION * LANES
        store(gradient, row, where(turned, gw * inverse_norm))
        store(gradient, row + LANES, where(turned, gx * inverse_norm))
        store(gradient, row + 2 * LANES, where(turned, gy * inverse_norm))
        store(gradient, row + 3 * LANES, where(turned, gz * inverse_norm))
        row = base + OPACITY * LANES
        store(gradient, row, where(seen, m0 / most(load(parameters, row), broadcast(OPACITY_MIN))))
        # → by J·W, which depends on depth and on the tangents.
        u00, u01, u02 = (
            pa0 * r00 + pa1 * r01 + pa2 * r02,
            pa0 * r10 + pa1 * r11 + pa2 * r12,
            pa0 * r20 + pa1 * r21 + pa2 * r22,
        )
        u10, u11, u12 = (
            pb0 * r00 + pb1 * r01 + pb2 * r02,
            pb0 * r10 + pb1 * r11 + pb2 * r12,
            pb0 * r20 + pb1 * r21 + pb2 * r22,
        )
        d0, d2 = (
            u00 * camera[0] + u01 * camera[1] + u02 * camera[2],
            u00 * camera[6] + u01 * camera[7] + u02 * camera[8],
        )
        d1, d3 = (
            u10 * camera[3] + u11 * camera[4] + u12 * camera[5],
            u10 * camera[6] + u11 * camera[7] + u12 * camera[8],
        )
        by_inverse_depth = fx * (d0 - ax * d2) + fy * (d1 - ay * d3)
        by_tangent_x = fx * by_px - where(free_x, fx * inverse_depth * d2)
        by_tangent_y = fy * by_py - where(free_y, fy * inverse_depth * d3)
        by_x, by_y = by_tangent_x * inverse_depth, by_tangent_y * inverse_depth
        by_z = (
            where(seen, m9) - (by_inverse_depth + by_tangent_x * x + by_tangent_y * y) * inverse_depth * inverse_depth
        )
        # → by the colour, whose clamp at 0 passes nothing, and by the viewing direction.
        red = where(both(seen, mask_from_bits(_positive(splats, first, RED))), m6)
        green = where(both(seen, mask_from_bits(_positive(splats, first, GREEN))), m7)
        blue = where(both(seen, mask_from_bits(_positive(splats, first, BLUE))), m8)
        dx, dy, dz, inverse_distance = direction(parameters, base, camera)
        vx, vy, vz = colour_gradient(parameters, gradient, base, degree, seen, dx, dy, dz, red, green, blue)
        # Harmonics near float32's limit change so fast with the direction that the change overflows.
        steepest = broadcast(_STEEPEST)
        described = both(
            below(magnitude(vx), steepest), both(below(magnitude(vy), steepest), below(magnitude(vz), steepest))
        )
        vx, vy, vz = where(described, vx), where(described, vy), where(described, vz)
        along = vx * dx + vy * dy + vz * dz
        wx = camera[0] * by_x + camera[3] * by_y + camera[6] * by_z + (vx - along * dx) * inverse_distance
        wy = camera[1] * by_x + camera[4] * by_y + camera[7] * by_z + (vy - along * dy) * inverse_distance
        wz = camera[2] * by_x + camera[5] * by_y + camera[8] * by_z + (vz - along * dz) * inverse_distance
        store(gradient, base, where(seen, wx))
        store(gradient, base + LANES, where(seen, wy))
        store(gradient, base + 2 * LANES, where(seen, wz))


@njit(parallel=True, **KERNEL)
def project_gradient(parameters, camera, degree, splats, visible, moments, gradient, screen):
    """Fill ``gradient`` (as parameter blocks, by activated scale and opacity) and ``screen`` (2·N: dL/dx, then dL/dy,
    px).

    Blocks without a visible Gaussian are left as they are.
    """
    blocks = len(visible) // LANES
    for piece in prange(-(-blocks // PIECE)):
        begin = piece * PIECE
        _gradients_of_blocks(
            begin, min(begin + PIECE, blocks), parameters, camera, degree, splats, visible, moments, gradient, screen
        )
