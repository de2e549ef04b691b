# SPDX-License-Identifier: Apache-2.0
"""The points' part of a body's normal equations, frame by frame, compiled.

A point moves with the few joints between it and the pelvis, 8 of 24 for a wrist, and its three coordinates have the
same weight. So neither zeros nor rows are formed: turns ω_i, ω_j about world axes meet in w (D_i·D_j 1 − D_j D_iᵀ), a
turn and a vector v in w D_i × v. Turns are ordered by axis, then joint: row 24 a + j; see ``problem``.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def add_points(skeleton, points, state, weight, residual, own, rows, shared, shared_side):
    """Add all frames' points to ``own``, ``rows`` (F, S + 1, 75), ``shared`` and ``shared_side``.

    ``skeleton``: parents (24,) and the bones' derivatives by betas (24, 3, B). ``points``: share (K, 24) and share of
    each subtree (K, 24); the joints that carry a point and those that move it, ascending, padded with −1 (K, 25) each;
    the offsets' derivatives by betas (24, K, 3, B); the joint in whose axes a correction is (K,); the number of
    corrections. ``state``: world rotations and joints about the pelvis, offsets (24, K, 3), scale. ``weight`` (F, K),
    ``residual`` and points about the pelvis (F, K, 3) each, stacked. With a single row in ``rows``, the gradient,
    shared unknowns are left out.
    """
    parents, bones = skeleton
    share, subtree, carriers, movers, shape_offsets, carrier, corrected = points
    world, joints, offsets, scale = state
    shapes = bones.shape[2]
    everything = rows.shape[1] > 1
    turned, reach, lever = np.empty((24, 24, 9)), np.empty((24, 3)), np.empty((24, 3))
    moved, by_shape = np.empty((24, 3, shapes)), np.empty((shapes + 1, 3))
    carried, axis = np.empty(3), np.empty(3)
    for f in range(world.shape[0]):
        turned[:], reach[:] = 0.0, 0.0
        if everything:
            _moved_joints(world[f], parents, bones, moved)
        for k in range(share.shape[0]):
            w = weight[f, k]
            if w == 0.0:
                continue
            for i in movers[k]:
                if i < 0:
                    break
                for x in range(3):
                    lever[i, x] = -subtree[k, i] * joints[f, i, x]
            for j in carriers[k]:
                if j < 0:
                    break
                for x in range(3):
                    carried[x] = share[k, j] * joints[f, j, x]
                    for y in range(3):
                        carried[x] += world[f, j, x, y] * offsets[j, k, y]
                i = j
                while i >= 0:
                    for x in range(3):
                        lever[i, x] += carried[x]
                    i = parents[i]
            for i in movers[k]:
                if i < 0:
                    break
                for x in range(3):
                    lever[i, x] *= scale
                    reach[i, x] += w * lever[i, x]
                for j in movers[k]:
                    if j > i or j < 0:
                        break
                    block, dot = turned[j, i], 0.0
                    for x in range(3):
                        dot += lever[i, x] * lever[j, x]
                        for y in range(3):
                            block[3 * x + y] -= w * lever[i, x] * lever[j, y]
                    for x in range(3):
                        block[4 * x] += w * dot
            own[f, 72, 72] += w
            _add_row(rows[f, -1], movers[k], lever, w, residual[0, f, k])
            if everything:
                _by_shape(world[f], share[k], carriers[k], shape_offsets[:, k], moved, scale, by_shape)
                by_shape[shapes] = residual[1, f, k]
                for b in range(shapes + 1):
                    _add_row(rows[f, b], movers[k], lever, w, by_shape[b])
                    shared_side[b] += w * _dot(by_shape[b], residual[0, f, k])
                    for c in range(b + 1):
                        shared[b, c] += w * _dot(by_shape[b], by_shape[c])
                if k < corrected:
                    for x in range(3):
                        # A correction moves its point along an axis of the joint that carries it most, by the scale.
                        for y in range(3):
                            axis[y] = scale * world[f, carrier[k], y, x]
                        own_row = shapes + 1 + 3 * k + x
                        _add_row(rows[f, own_row], movers[k], lever, w, axis)
                        shared_side[own_row] += w * _dot(axis, residual[0, f, k])
                        shared[own_row, own_row] += w * scale * scale
                        for b in range(shapes + 1):
                            shared[own_row, b] += w * _dot(axis, by_shape[b])
        _spread(turned, reach, own[f])
    for b in range(shared.shape[0]):
        for c in range(b):
            shared[c, b] = shared[b, c]


@numba.njit(cache=True, nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True)
def _add_row(row, movers, lever, w, vector):
    """Add the product of a point's turns and shift with its move along ``vector`` (3,) to a row (75,)."""
    x, y, z = w * vector[0], w * vector[1], w * vector[2]
    for i in movers:
        if i < 0:
            break
        row[i] += lever[i, 1] * z - lever[i, 2] * y
        row[24 + i] += lever[i, 2] * x - lever[i, 0] * z
        row[48 + i] += lever[i, 0] * y - lever[i, 1] * x
    row[72] += x
    row[73] += y
    row[74] += z


@numba.njit(cache=True, nogil=True)
def _moved_joints(world, parents, bones, moved):
    """Fill ``moved`` (24, 3, B) with the joints' derivatives by betas."""
    for j in range(24):
        parent = parents[j]
        for x in range(3):
            for b in range(bones.shape[2]):
                change = 0.0
                if parent >= 0:
                    change = moved[parent, x, b]
                    for y in range(3):
                        change += world[parent, x, y] * bones[j, y, b]
                moved[j, x, b] = change


@numba.njit(cache=True, nogil=True)
def _by_shape(world, share, carriers, shape_offsets, moved, scale, out):
    """Fill the first B rows of ``out`` (B + 1, 3) with a point's derivatives by betas."""
    shapes = moved.shape[2]
    out[:] = 0.0
    for j in carriers:
        if j < 0:
            break
        for b in range(shapes):
            for x in range(3):
                change = share[j] * moved[j, x, b]
                for y in range(3):
                    change += world[j, x, y] * shape_offsets[j, y, b]
                out[b, x] += scale * change


@numba.njit(cache=True, nogil=True)
def _spread(turned, reach, own):
    """Copy one frame's blocks of turns (24, 24, 9), j ≤ i, and Σ w D (24, 3) into ``own`` (75, 75)."""
    own[73, 73] = own[74, 74] = own[72, 72]
    for i in range(24):
        for j in range(i + 1):
            for a in range(3):
                for b in range(3):
                    value = turned[j, i, 3 * a + b]
                    own[24 * a + j, 24 * b + i] = value
                    own[24 * b + i, 24 * a + j] = value
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            # e_a × v has −v_c along b and v_b along c.
            own[24 * a + i, 72 + b] = own[72 + b, 24 * a + i] = -reach[i, c]
            own[24 * a + i, 72 + c] = own[72 + c, 24 * a + i] = reach[i, b]
