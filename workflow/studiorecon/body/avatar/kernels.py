# SPDX-License-Identifier: Apache-2.0
"""Kernels of an avatar: posing Gaussians, gradients back from it, and interpolation between control points.

Loaded when something is posed: steps that only read avatars start without numba.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

# Real SH constants of degree 2 in the order and with the signs of the 3DGS file format.
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
# No reassociation: the same inputs give the same bytes.
_KERNEL: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"nsz", "contract"}}


# The kernels below use scalars: allocating an array of nine for each Gaussian took half their time.
@numba.njit(**_KERNEL)
def _polar(m):
    """Nearest rotation of a row-major matrix by Newton's iteration (Higham 1986), nine numbers, and whether it exists.

    A collapsed or mirrored blend has none.
    """
    a, b, c, d, e, f, g, h, i = m
    for _ in range(40):
        ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
        determinant = a * ca + b * cb + c * cc
        # Determinant below which a blend has no usable polar rotation.
        if not determinant > 1e-6:
            return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), False
        half = 0.5 / determinant
        na, nb, nc = 0.5 * a + half * ca, 0.5 * b + half * cb, 0.5 * c + half * cc
        cd, ce, cf = h * c - i * b, i * a - g * c, g * b - h * a
        cg, ch, ci = b * f - c * e, c * d - a * f, a * e - b * d
        nd, ne, nf = 0.5 * d + half * cd, 0.5 * e + half * ce, 0.5 * f + half * cf
        ng, nh, ni = 0.5 * g + half * cg, 0.5 * h + half * ch, 0.5 * i + half * ci
        change = abs(na - a) + abs(nb - b) + abs(nc - c) + abs(nd - d) + abs(ne - e) + abs(nf - f)
        change += abs(ng - g) + abs(nh - h) + abs(ni - i)
        a, b, c, d, e, f, g, h, i = na, nb, nc, nd, ne, nf, ng, nh, ni
        if change < 1e-5:  # convergence is quadratic: the error is then 1e-10
            break
    return (a, b, c, d, e, f, g, h, i), True


@numba.njit(**_KERNEL)
def _quaternion(r):
    """Unit quaternion (w, x, y, z) of a row-major rotation, by its largest component (R13)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = r
    of_w, of_x, of_y, of_z = 1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz
    if of_w >= of_x and of_w >= of_y and of_w >= of_z:
        w, x, y, z = of_w, zy - yz, xz - zx, yx - xy
    elif of_x >= of_y and of_x >= of_z:
        w, x, y, z = zy - yz, of_x, yx + xy, xz + zx
    elif of_y >= of_z:
        w, x, y, z = xz - zx, yx + xy, of_y, zy + yz
    else:
        w, x, y, z = yx - xy, xz + zx, zy + yz, of_z
    share = 1 / np.sqrt(w * w + x * x + y * y + z * z)
    return w * share, x * share, y * share, z * share


@numba.njit(**_KERNEL)
def _turn_sh(r, sh, i, out):
    """Rotate the SH of Gaussian ``i``: the value along r·d is the given one's along d. Its inverse is r transposed."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = r
    for channel in range(3):
        out[i, 0, channel] = sh[i, 0, channel]
        if sh.shape[1] > 1:  # degree 1 is a vector
            vx, vy, vz = -sh[i, 3, channel], -sh[i, 1, channel], sh[i, 2, channel]
            out[i, 1, channel] = -(r10 * vx + r11 * vy + r12 * vz)
            out[i, 2, channel] = r20 * vx + r21 * vy + r22 * vz
            out[i, 3, channel] = -(r00 * vx + r01 * vy + r02 * vz)
        if sh.shape[1] > 4:  # degree 2 is a symmetric matrix without trace
            xy, yz, xz = _C2[0] * sh[i, 4, channel] / 2, _C2[1] * sh[i, 5, channel] / 2, _C2[3] * sh[i, 7, channel] / 2
            zz = 2 * _C2[2] * sh[i, 6, channel]
            xx, yy = -zz / 2 + _C2[4] * sh[i, 8, channel], -zz / 2 - _C2[4] * sh[i, 8, channel]
            t00 = r00 * xx + r01 * xy + r02 * xz
            t10 = r10 * xx + r11 * xy + r12 * xz
            t20 = r20 * xx + r21 * xy + r22 * xz
            t01 = r00 * xy + r01 * yy + r02 * yz
            t11 = r10 * xy + r11 * yy + r12 * yz
            t21 = r20 * xy + r21 * yy + r22 * yz
            t02 = r00 * xz + r01 * yz + r02 * zz
            t12 = r10 * xz + r11 * yz + r12 * zz
            t22 = r20 * xz + r21 * yz + r22 * zz
            out[i, 4, channel] = 2 * (t00 * r10 + t01 * r11 + t02 * r12) / _C2[0]
            out[i, 5, channel] = 2 * (t10 * r20 + t11 * r21 + t12 * r22) / _C2[1]
            out[i, 6, channel] = (t20 * r20 + t21 * r21 + t22 * r22) / (2 * _C2[2])
            out[i, 7, channel] = 2 * (t00 * r20 + t01 * r21 + t02 * r22) / _C2[3]
            new_xx, new_yy = t00 * r00 + t01 * r01 + t02 * r02, t10 * r10 + t11 * r11 + t12 * r12
            out[i, 8, channel] = (new_xx - new_yy) / (2 * _C2[4])


@numba.njit(**_KERNEL)
def _blend(bones, weights, world_from_rest):
    """The blended transform of one Gaussian, row-major: its nine numbers, its translation, and the strongest bone."""
    a = b = c = d = e = f = g = h = j = x = y = z = 0.0
    strongest = 0
    for k in range(bones.shape[0]):
        share = weights[k]
        if share == 0:
            continue
        if share > weights[strongest]:
            strongest = k
        m = world_from_rest[bones[k]]
        a, b, c, x = a + share * m[0, 0], b + share * m[0, 1], c + share * m[0, 2], x + share * m[0, 3]
        d, e, f, y = d + share * m[1, 0], e + share * m[1, 1], f + share * m[1, 2], y + share * m[1, 3]
        g, h, j, z = g + share * m[2, 0], h + share * m[2, 1], j + share * m[2, 2], z + share * m[2, 3]
    return (a, b, c, d, e, f, g, h, j), (x, y, z), bones[strongest]


@numba.njit(**_KERNEL)
def pose_gaussians(
    bones,
    weights,
    world_from_rest,
    means,
    quaternions,
    sh,
    linear,
    turn,
    turn_quaternions,
    posed_means,
    posed_quaternions,
    posed_sh,
):
    """Pose canonical Gaussians; quaternions keep their length (the renderer normalises).

    Also fills the inputs of ``pull_back_gradients``: the blended ``linear``, its polar rotation ``turn`` (N, 3, 3) and
    that as ``turn_quaternions`` (N, 4).
    """
    for i in range(bones.shape[0]):
        blended, (x, y, z), strongest = _blend(bones[i], weights[i], world_from_rest)
        a, b, c, d, e, f, g, h, j = blended
        own, found = _polar(blended)
        if not found:
            m = world_from_rest[strongest]
            own = m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]
        for r in range(3):
            for s in range(3):
                linear[i, r, s], turn[i, r, s] = blended[3 * r + s], own[3 * r + s]
        mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
        posed_means[i, 0] = x + a * mx + b * my + c * mz
        posed_means[i, 1] = y + d * mx + e * my + f * mz
        posed_means[i, 2] = z + g * mx + h * my + j * mz
        p, q, r, s = _quaternion(own)
        turn_quaternions[i, 0], turn_quaternions[i, 1], turn_quaternions[i, 2], turn_quaternions[i, 3] = p, q, r, s
        qw, qx, qy, qz = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        posed_quaternions[i, 0] = p * qw - q * qx - r * qy - s * qz
        posed_quaternions[i, 1] = p * qx + q * qw + r * qz - s * qy
        posed_quaternions[i, 2] = p * qy - q * qz + r * qw + s * qx
        posed_quaternions[i, 3] = p * qz + q * qy - r * qx + s * qw
        _turn_sh(own, sh, i, posed_sh)


@numba.njit(**_KERNEL)
def pull_back_gradients(
    grad_means, grad_quaternions, grad_sh, linear, turn, turn_quaternions, out_means, out_quaternions, out_sh
):
    """Turn gradients at posed Gaussians into gradients at canonical ones; skinning weights are constant."""
    for i in range(grad_means.shape[0]):
        gx, gy, gz = grad_means[i, 0], grad_means[i, 1], grad_means[i, 2]
        for c in range(3):
            out_means[i, c] = linear[i, 0, c] * gx + linear[i, 1, c] * gy + linear[i, 2, c] * gz
        p, q = turn_quaternions[i, 0], turn_quaternions[i, 1]
        r, s = turn_quaternions[i, 2], turn_quaternions[i, 3]
        w, x, y, z = grad_quaternions[i, 0], grad_quaternions[i, 1], grad_quaternions[i, 2], grad_quaternions[i, 3]
        out_quaternions[i, 0] = p * w + q * x + r * y + s * z
        out_quaternions[i, 1] = p * x - q * w - r * z + s * y
        out_quaternions[i, 2] = p * y + q * z - r * w - s * x
        out_quaternions[i, 3] = p * z - q * y + r * x - s * w
        inverse = (
            turn[i, 0, 0],
            turn[i, 1, 0],
            turn[i, 2, 0],
            turn[i, 0, 1],
            turn[i, 1, 1],
            turn[i, 2, 1],
            turn[i, 0, 2],
            turn[i, 1, 2],
            turn[i, 2, 2],
        )
        _turn_sh(inverse, grad_sh, i, out_sh)


@numba.njit(**_KERNEL)
def bone_wrenches(means, grad_means, bones, weights, world_from_rest, force, torque):
    """Sum the posed-mean gradients of each bone: ``force`` (24, 3), and ``torque`` (24, 3) about the origin.

    A small turn ω of a joint at p moves every point x of its subtree by ω × (x − p), so the loss changes by ω · (Σ
    torque − p × Σ force) over the bones of the subtree.
    """
    for i in range(means.shape[0]):
        g0, g1, g2 = grad_means[i, 0], grad_means[i, 1], grad_means[i, 2]
        if g0 == 0.0 and g1 == 0.0 and g2 == 0.0:
            continue
        mx, my, mz = means[i, 0], means[i, 1], means[i, 2]
        for k in range(bones.shape[1]):
            w = weights[i, k]
            if w == 0.0:
                continue
            b = bones[i, k]
            t = world_from_rest
            x = t[b, 0, 0] * mx + t[b, 0, 1] * my + t[b, 0, 2] * mz + t[b, 0, 3]
            y = t[b, 1, 0] * mx + t[b, 1, 1] * my + t[b, 1, 2] * mz + t[b, 1, 3]
            z = t[b, 2, 0] * mx + t[b, 2, 1] * my + t[b, 2, 2] * mz + t[b, 2, 3]
            force[b, 0] += w * g0
            force[b, 1] += w * g1
            force[b, 2] += w * g2
            torque[b, 0] += w * (y * g2 - z * g1)
            torque[b, 1] += w * (z * g0 - x * g2)
            torque[b, 2] += w * (x * g1 - y * g0)


@numba.njit(cache=True)
def spread(near, shares, values, out):
    for i in range(near.shape[0]):
        for c in range(values.shape[1]):
            total = np.float32(0)
            for k in range(near.shape[1]):
                total += shares[i, k] * values[near[i, k], c]
            out[i, c] = total


@numba.njit(cache=True)
def gather(near, shares, gradient, out):
    for i in range(near.shape[0]):
        for c in range(gradient.shape[1]):
            value = gradient[i, c]
            if np.isfinite(value):
                for k in range(near.shape[1]):
                    out[near[i, k], c] += shares[i, k] * value
