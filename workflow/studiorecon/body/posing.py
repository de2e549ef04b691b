# SPDX-License-Identifier: Apache-2.0
"""Linear blend skinning of Gaussians: canonical means, orientations and SH into a pose, and gradients back out of it.

The mean follows the blended matrix exactly; orientation and view dependence follow its polar rotation, because a blend of
rotations is not one (numerics L05, U44). The polar factor of a collapsed blend (a half-half twist of 180°) does not exist;
there the bone with the largest weight decides (numerics L04).
"""

from __future__ import annotations

import numba
import numpy as np

# Real SH constants of degree 2 in the order and with the signs of the 3DGS file format.
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
MAX_SH_DEGREE = 2  # rotating degree 3 would need Wigner matrices; the paper's humans use degree 2
_COLLAPSED = 1e-6  # determinant below which a blend has no usable polar rotation


@numba.njit(cache=True)
def _polar(linear, rotation):
    """Nearest rotation by Newton's iteration (Higham 1986); False when the blend has collapsed or is mirrored."""
    x = linear.copy()
    for _ in range(40):
        c00 = x[1, 1] * x[2, 2] - x[1, 2] * x[2, 1]
        c01 = x[1, 2] * x[2, 0] - x[1, 0] * x[2, 2]
        c02 = x[1, 0] * x[2, 1] - x[1, 1] * x[2, 0]
        determinant = x[0, 0] * c00 + x[0, 1] * c01 + x[0, 2] * c02
        if not determinant > _COLLAPSED:
            return False
        rotation[0, 0], rotation[0, 1], rotation[0, 2] = c00, c01, c02
        rotation[1, 0] = x[2, 1] * x[0, 2] - x[2, 2] * x[0, 1]
        rotation[1, 1] = x[2, 2] * x[0, 0] - x[2, 0] * x[0, 2]
        rotation[1, 2] = x[2, 0] * x[0, 1] - x[2, 1] * x[0, 0]
        rotation[2, 0] = x[0, 1] * x[1, 2] - x[0, 2] * x[1, 1]
        rotation[2, 1] = x[0, 2] * x[1, 0] - x[0, 0] * x[1, 2]
        rotation[2, 2] = x[0, 0] * x[1, 1] - x[0, 1] * x[1, 0]
        change = 0.0
        for r in range(3):
            for c in range(3):
                value = 0.5 * (x[r, c] + rotation[r, c] / determinant)
                change += abs(value - x[r, c])
                x[r, c] = value
        if change < 1e-6:  # convergence is quadratic: the error is then 1e-12
            break
    rotation[:] = x
    return True


@numba.njit(cache=True)
def _quaternion(r, q):
    """Unit quaternion (w, x, y, z) of a rotation, by its largest component (numerics R13)."""
    squares = (1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2],
               1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2])  # fmt: skip
    pivot = 0
    for k in range(1, 4):
        if squares[k] > squares[pivot]:
            pivot = k
    if pivot == 0:
        q[0], q[1], q[2], q[3] = squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    elif pivot == 1:
        q[0], q[1], q[2], q[3] = r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]
    elif pivot == 2:
        q[0], q[1], q[2], q[3] = r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]
    else:
        q[0], q[1], q[2], q[3] = r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= length


@numba.njit(cache=True)
def _turn_sh(r, sh, out):
    """Coefficients whose value along r·d is the given one's along d; orthogonal, so the backward pass is r transposed."""
    coefficients = sh.shape[0]
    for channel in range(3):
        out[0, channel] = sh[0, channel]
        if coefficients > 1:  # degree 1 is a vector
            vx, vy, vz = -sh[3, channel], -sh[1, channel], sh[2, channel]
            out[1, channel] = -(r[1, 0] * vx + r[1, 1] * vy + r[1, 2] * vz)
            out[2, channel] = r[2, 0] * vx + r[2, 1] * vy + r[2, 2] * vz
            out[3, channel] = -(r[0, 0] * vx + r[0, 1] * vy + r[0, 2] * vz)
        if coefficients > 4:  # degree 2 is a symmetric matrix without trace
            xy, yz, xz = _C2[0] * sh[4, channel] / 2, _C2[1] * sh[5, channel] / 2, _C2[3] * sh[7, channel] / 2
            zz = 2 * _C2[2] * sh[6, channel]
            xx, yy = -zz / 2 + _C2[4] * sh[8, channel], -zz / 2 - _C2[4] * sh[8, channel]
            t = np.empty((3, 3))
            for k in range(3):
                t[k, 0] = r[k, 0] * xx + r[k, 1] * xy + r[k, 2] * xz
                t[k, 1] = r[k, 0] * xy + r[k, 1] * yy + r[k, 2] * yz
                t[k, 2] = r[k, 0] * xz + r[k, 1] * yz + r[k, 2] * zz
            out[4, channel] = 2 * (t[0, 0] * r[1, 0] + t[0, 1] * r[1, 1] + t[0, 2] * r[1, 2]) / _C2[0]
            out[5, channel] = 2 * (t[1, 0] * r[2, 0] + t[1, 1] * r[2, 1] + t[1, 2] * r[2, 2]) / _C2[1]
            out[6, channel] = (t[2, 0] * r[2, 0] + t[2, 1] * r[2, 1] + t[2, 2] * r[2, 2]) / (2 * _C2[2])
            out[7, channel] = 2 * (t[0, 0] * r[2, 0] + t[0, 1] * r[2, 1] + t[0, 2] * r[2, 2]) / _C2[3]
            new_xx = t[0, 0] * r[0, 0] + t[0, 1] * r[0, 1] + t[0, 2] * r[0, 2]
            new_yy = t[1, 0] * r[1, 0] + t[1, 1] * r[1, 1] + t[1, 2] * r[1, 2]
            out[8, channel] = (new_xx - new_yy) / (2 * _C2[4])


@numba.njit(cache=True)
def blend_transforms(bones, weights, world_from_rest, linear, offset, turn):
    """Fill ``linear`` (N, 3, 3), ``offset`` (N, 3) and polar rotation ``turn`` (N, 3, 3) of every Gaussian."""
    for i in range(bones.shape[0]):
        linear[i] = 0.0
        offset[i] = 0.0
        strongest = 0
        for k in range(bones.shape[1]):
            w = weights[i, k]
            if w > weights[i, strongest]:
                strongest = k
            for r in range(3):
                offset[i, r] += w * world_from_rest[bones[i, k], r, 3]
                for c in range(3):
                    linear[i, r, c] += w * world_from_rest[bones[i, k], r, c]
        if not _polar(linear[i], turn[i]):
            turn[i] = world_from_rest[bones[i, strongest], :3, :3]


@numba.njit(cache=True)
def carry_out(means, quaternions, sh, linear, offset, turn, posed_means, posed_quaternions, posed_sh):
    """Canonical Gaussians into the pose; quaternions keep their length (the renderer normalises)."""
    q = np.empty(4)
    for i in range(means.shape[0]):
        for r in range(3):
            posed_means[i, r] = offset[i, r] + linear[i, r, 0] * means[i, 0] + linear[i, r, 1] * means[i, 1] + linear[i, r, 2] * means[i, 2]
        _quaternion(turn[i], q)
        w, x, y, z = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        posed_quaternions[i, 0] = q[0] * w - q[1] * x - q[2] * y - q[3] * z
        posed_quaternions[i, 1] = q[0] * x + q[1] * w + q[2] * z - q[3] * y
        posed_quaternions[i, 2] = q[0] * y - q[1] * z + q[2] * w + q[3] * x
        posed_quaternions[i, 3] = q[0] * z + q[1] * y - q[2] * x + q[3] * w
        _turn_sh(turn[i], sh[i], posed_sh[i])


@numba.njit(cache=True)
def carry_back(grad_means, grad_quaternions, grad_sh, linear, turn, out_means, out_quaternions, out_sh):
    """Gradients at posed Gaussians to gradients at canonical ones (the skinning weights are held)."""
    q = np.empty(4)
    inverse = np.empty((3, 3))
    for i in range(grad_means.shape[0]):
        for c in range(3):
            out_means[i, c] = linear[i, 0, c] * grad_means[i, 0] + linear[i, 1, c] * grad_means[i, 1] + linear[i, 2, c] * grad_means[i, 2]
        _quaternion(turn[i], q)
        w, x, y, z = grad_quaternions[i, 0], grad_quaternions[i, 1], grad_quaternions[i, 2], grad_quaternions[i, 3]
        out_quaternions[i, 0] = q[0] * w + q[1] * x + q[2] * y + q[3] * z
        out_quaternions[i, 1] = q[0] * x - q[1] * w - q[2] * z + q[3] * y
        out_quaternions[i, 2] = q[0] * y + q[1] * z - q[2] * w - q[3] * x
        out_quaternions[i, 3] = q[0] * z - q[1] * y + q[2] * x - q[3] * w
        for r in range(3):
            for c in range(3):
                inverse[r, c] = turn[i, c, r]
        _turn_sh(inverse, grad_sh[i], out_sh[i])


@numba.njit(cache=True)
def bone_wrenches(means, grad_means, bones, weights, world_from_rest, force, torque):
    """Sum over Gaussians of the posed-mean gradient carried by each bone: ``force`` (24, 3), ``torque`` (24, 3) about the origin.

    A small turn ω of a joint at p moves every point x of its subtree by ω × (x − p), so the loss changes by
    ω · (Σ torque − p × Σ force) over the bones of the subtree.
    """
    force[:] = 0.0
    torque[:] = 0.0
    x = np.empty(3)
    for i in range(means.shape[0]):
        g0, g1, g2 = grad_means[i, 0], grad_means[i, 1], grad_means[i, 2]
        if g0 == 0.0 and g1 == 0.0 and g2 == 0.0:
            continue
        for k in range(bones.shape[1]):
            w = weights[i, k]
            if w == 0.0:
                continue
            b = bones[i, k]
            for r in range(3):
                x[r] = (
                    world_from_rest[b, r, 0] * means[i, 0]
                    + world_from_rest[b, r, 1] * means[i, 1]
                    + world_from_rest[b, r, 2] * means[i, 2]
                    + world_from_rest[b, r, 3]
                )
            force[b, 0] += w * g0
            force[b, 1] += w * g1
            force[b, 2] += w * g2
            torque[b, 0] += w * (x[1] * g2 - x[2] * g1)
            torque[b, 1] += w * (x[2] * g0 - x[0] * g2)
            torque[b, 2] += w * (x[0] * g1 - x[1] * g0)


class Posing:
    """Buffers for posing the same N Gaussians many times.

    Attributes:
        bones: (N, K) uint8 joints that carry each Gaussian.
        weights: (N, K) float32, non-negative, each row sums to 1.
    """

    def __init__(self, bones: np.ndarray, weights: np.ndarray) -> None:
        count = len(bones)
        self.bones = np.ascontiguousarray(bones, np.uint8)
        self.weights = np.ascontiguousarray(weights, np.float32)
        self.linear, self.turn = np.empty((count, 3, 3)), np.empty((count, 3, 3))
        self.offset = np.empty((count, 3))

    def thinnest(self) -> np.ndarray:
        """(N,) what the last pose left of each Gaussian's surroundings along their thinnest axis; below 0.5 the skin has collapsed.

        1 under rigid motion, 0.71 / 0.26 / 0 in the middle of a twist by 90 / 150 / 180° (numerics L04). A blend's determinant
        falls with its square, so whoever inverts a blend must ask here first.
        """
        return np.linalg.svd(self.linear, compute_uv=False)[:, -1]

    def out(self, means_m: np.ndarray, quaternions: np.ndarray, sh: np.ndarray, world_from_rest: np.ndarray) -> tuple[np.ndarray, ...]:
        """Posed means (N, 3), quaternions (N, 4) and SH (N, K, 3), float32, for bone transforms (24, 4, 4)."""
        blend_transforms(self.bones, self.weights, np.ascontiguousarray(world_from_rest, np.float64), self.linear, self.offset, self.turn)
        posed = np.empty_like(means_m), np.empty_like(quaternions), np.empty_like(sh)
        carry_out(means_m, quaternions, sh, self.linear, self.offset, self.turn, *posed)
        return posed

    def back(self, grad_means: np.ndarray, grad_quaternions: np.ndarray, grad_sh: np.ndarray) -> tuple[np.ndarray, ...]:
        """Gradients at the canonical Gaussians, for the pose of the last ``out``."""
        canonical = np.empty_like(grad_means), np.empty_like(grad_quaternions), np.empty_like(grad_sh)
        carry_back(grad_means, grad_quaternions, grad_sh, self.linear, self.turn, *canonical)
        return canonical

    def wrenches(self, means_m: np.ndarray, grad_means: np.ndarray, world_from_rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force and torque (24, 3) on every bone; see ``bone_wrenches``."""
        force, torque = np.empty((len(world_from_rest), 3)), np.empty((len(world_from_rest), 3))
        bone_wrenches(means_m, grad_means, self.bones, self.weights, np.ascontiguousarray(world_from_rest, np.float64), force, torque)
        return force, torque
