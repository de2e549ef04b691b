# SPDX-License-Identifier: Apache-2.0
"""Rotations as (..., 3, 3) float64 matrices: to and from axis-angle and quaternions, interpolated, averaged.

Stable at 0 and at π without thresholds that lose digits: exp by half-angle sincs, log by quaternions with the largest
pivot. Every function raises ValueError that names the argument when its last axes differ from those stated. Where
rotations are independent, NaN affects only its own; where one decomposition handles them all, values that are not
finite are refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Within this of half a turn, rounding decides the sign of the axis; slerp then uses a reference direction instead.
_HALF_TURN_RAD = 1e-6


def cross_matrix(vectors: Num[np.ndarray, "... 3"]) -> Num[np.ndarray, "... 3 3"]:
    """Matrices [v]× with [v]× u = v × u of ``vectors``. Raises ValueError for another last axis."""
    require("vectors", vectors, (..., 3))
    v = np.asarray(vectors, dtype=np.float64)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    cross = np.zeros((*v.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2] = -z, y
    cross[..., 1, 0], cross[..., 1, 2] = z, -x
    cross[..., 2, 0], cross[..., 2, 1] = -y, x
    return cross


def exp(axis_angle_rad: Num[np.ndarray, "... 3"]) -> Num[np.ndarray, "... 3 3"]:
    """Rotations of axis-angles. Raises ValueError for another last axis.

    I + sin θ/θ [w]× + 2 sin²(θ/2)/θ² [w]×²; ``np.sinc`` is exact at 0, and the half angle keeps the digits that (1 −
    cos θ)/θ² loses (R09, R10).
    """
    w = np.asarray(axis_angle_rad, dtype=np.float64)
    require("axis_angle_rad", w, (..., 3))
    turns = np.sqrt(np.einsum("...i,...i", w, w))[..., None, None] / np.pi
    cross = cross_matrix(w)
    return np.eye(3) + np.sinc(turns) * cross + 0.5 * np.sinc(0.5 * turns) ** 2 * (cross @ cross)


def log(rotations: Num[np.ndarray, "... 3 3"]) -> Num[np.ndarray, "... 3"]:
    """Axis-angles, angle in [0, π], to 1e-8 rad also at 0 and π (R11, R12). Raises ValueError for other last axes."""
    q = to_quaternion(rotations)
    sine = np.sqrt(np.einsum("...i,...i", q[..., 1:], q[..., 1:]))
    # θ / sin(θ/2) tends to 2 at 0; the denominator is replaced before dividing, not after (double where).
    small = sine < 1e-12
    factor = np.where(small, 2.0, 2.0 * np.arctan2(sine, q[..., 0]) / np.where(small, 1.0, sine))
    return factor[..., None] * q[..., 1:]


def turn_to_z(up: Num[np.ndarray, " 3"]) -> Num[np.ndarray, "3 3"]:
    """Shortest rotation that takes the unit vector ``up`` to z; half a turn about x for -z."""
    if up[2] < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = cross_matrix(np.cross(up, [0.0, 0.0, 1.0]))
    found: Num[np.ndarray, "3 3"] = np.eye(3) + cross + cross @ cross / (1 + up[2])
    return found


def angle(a: Num[np.ndarray, "... 3 3"], b: Num[np.ndarray, "... 3 3"]) -> Num[np.ndarray, " ..."]:
    """Angle in radians between rotations a and b, in [0, π], without arccos. Raises ValueError for other last axes."""
    require("a", a, (..., 3, 3))
    require("b", b, (..., 3, 3))
    relative = np.swapaxes(np.asarray(a, dtype=np.float64), -1, -2) @ np.asarray(b, dtype=np.float64)
    return np.linalg.norm(log(relative), axis=-1)


def to_quaternion(rotations: Num[np.ndarray, "... 3 3"]) -> Num[np.ndarray, "... 4"]:
    """Unit quaternions w, x, y, z with w ≥ 0, by the largest pivot (R13). Raises ValueError for other last axes."""
    q = largest_quaternion_row(rotations).reshape(-1, 4)
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    q[q[:, 0] < 0] *= -1
    return q.reshape(*np.shape(rotations)[:-2], 4)


def largest_quaternion_row(rotations: Num[np.ndarray, "... 3 3"]) -> Num[np.ndarray, "... 4"]:
    """Quaternions w, x, y, z of either sign, of length 2 to 4. Raises ValueError for other last axes."""
    r = np.asarray(rotations, dtype=np.float64)
    require("rotations", r, (..., 3, 3))
    m = np.moveaxis(r.reshape(-1, 9), -1, 0)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = m
    # Row k is 4 q_k q: each row is proportional to the quaternion, and the one with the largest diagonal is the safest.
    rows = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx],
            [xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz],
            [yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz],
        ]
    )
    pivot = np.argmax(rows[range(4), range(4)], axis=0)
    return rows[pivot, :, np.arange(len(pivot))].reshape(*r.shape[:-2], 4)


def from_quaternion(quaternions: Num[np.ndarray, "... 4"]) -> Num[np.ndarray, "... 3 3"]:
    """Rotations of quaternions w, x, y, z of any length; a length below 1e-12 gives the identity (R14).

    Raises ValueError for another last axis.
    """
    q = np.asarray(quaternions, dtype=np.float64)
    require("quaternions", q, (..., 4))
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(length < 1e-12, np.array([1.0, 0, 0, 0]), q / np.where(length < 1e-12, 1.0, length))
    w, x, y, z = np.moveaxis(q, -1, 0)
    entries = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return np.stack(entries, axis=-1).reshape(*q.shape[:-1], 3, 3)


def project_to_so3(matrices: Num[np.ndarray, "... 3 3"]) -> Num[np.ndarray, "... 3 3"]:
    """Nearest rotations in the Frobenius norm; the sign fix keeps the determinant at +1 (R18, R19, C01).

    Raises ValueError for other last axes and for values that are not finite, with which the decomposition would fail.
    """
    matrices = np.asarray(matrices, dtype=np.float64)
    require("matrices", matrices, (..., 3, 3), finite=True)
    u, _, vt = np.linalg.svd(matrices)
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    return u @ vt


def slerp(
    a: Num[np.ndarray, "... 3 3"],
    b: Num[np.ndarray, "... 3 3"],
    share: Num[np.ndarray, " ..."] | float,
    up: Num[np.ndarray, " 3"] | None = None,
) -> Num[np.ndarray, "... 3 3"]:
    """The rotation at ``share`` of the shortest way from a to b, both world_from_… rotations.

    Half a turn is counter-clockwise about ``up`` (the world's z when None), whatever the rounding (R01-R06);
    ``half_turn`` detects it. Raises ValueError for other last axes.
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    require("a", a, (..., 3, 3))
    require("b", b, (..., 3, 3))
    turn = log(b @ np.swapaxes(a, -1, -2))
    up = np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up, dtype=np.float64)
    ambiguous = np.linalg.norm(turn, axis=-1, keepdims=True) > np.pi - _HALF_TURN_RAD
    # A half turn about a horizontal axis is undecided by up; x, then y, break that tie.
    key = turn @ up
    key = np.where(np.abs(key) < 1e-5, np.where(np.abs(turn[..., 0]) < 1e-5, turn[..., 1], turn[..., 0]), key)
    turn = np.where(ambiguous & (key[..., None] < 0), -turn, turn)
    return exp(np.asarray(share, dtype=np.float64)[..., None] * turn) @ a


def half_turn(a: Num[np.ndarray, "... 3 3"], b: Num[np.ndarray, "... 3 3"]) -> Bool[np.ndarray, " ..."]:
    """Whether a and b are so nearly half a turn apart that ``slerp`` chose a way (R05). Raises ValueError as
    ``angle``."""
    return angle(a, b) > np.pi - _HALF_TURN_RAD


def mean(
    rotations: Num[np.ndarray, "... N 3 3"], weights: Num[np.ndarray, "... N"] | None = None
) -> tuple[Num[np.ndarray, "... 3 3"], Bool[np.ndarray, " ..."]]:
    """Mean over the axis of N, and whether it is determined.

    Eigenvector of Σ w q qᵀ: signs of quaternions do not matter (R16). Undetermined where the two largest eigenvalues
    coincide, as for thirds of a turn (R17). Raises ValueError for other last axes and for rotations or weights that are
    not finite.
    """
    require("rotations", rotations, (..., "N", 3, 3), finite=True)
    q = to_quaternion(rotations)
    w = (
        np.ones(q.shape[:-1])
        if weights is None
        else np.broadcast_to(np.asarray(weights, dtype=np.float64), q.shape[:-1])
    )
    require("weights", w, q.shape[:-1], finite=True)
    values, vectors = np.linalg.eigh(np.einsum("...n,...ni,...nj->...ij", w, q, q))
    total = w.sum(-1)
    # Smallest gap between the two largest eigenvalues of Σ w q qᵀ, relative to Σ w, of a determined mean (R17).
    determined = (total > 0) & (values[..., 3] - values[..., 2] > 1e-6 * total)
    return from_quaternion(vectors[..., :, 3]), determined


def kabsch(
    source_m: Num[np.ndarray, "... N 3"], target_m: Num[np.ndarray, "... N 3"], weights: Num[np.ndarray, "... N"]
) -> tuple[Num[np.ndarray, "... 3 3"], Num[np.ndarray, "... 3"], Bool[np.ndarray, " ..."]]:
    """Rotation and translation with target ≈ R source + t, and whether they are determined.

    Weighted least squares over N points; determinant +1 also for planar sets (R19). Undetermined with fewer than three
    points of positive weight or with points on a line. Points of weight 0 may be NaN. Raises ValueError for other
    shapes, and for points of positive weight that are not finite.
    """
    require("source_m", source_m, (..., "N", 3))
    require("target_m", target_m, (..., "N", 3))
    w = np.asarray(weights, dtype=np.float64)
    require("weights", w, (..., np.shape(target_m)[-2]), finite=True)
    source, target = (np.where(w[..., None] > 0, p, 0.0) for p in np.broadcast_arrays(source_m, target_m))
    require("source_m where it has weight", source, (..., "N", 3), finite=True)
    require("target_m where it has weight", target, (..., "N", 3), finite=True)
    total = np.maximum(w.sum(-1), 1e-300)[..., None]
    centre_s, centre_t = (np.einsum("...n,...ni->...i", w, p) / total for p in (source, target))
    covariance = np.einsum(
        "...n,...ni,...nj->...ij", w, target - centre_t[..., None, :], source - centre_s[..., None, :]
    )
    u, s, vt = np.linalg.svd(covariance)
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotation = u @ vt
    determined = ((w > 0).sum(-1) >= 3) & (s[..., 1] > 1e-9 * np.maximum(s[..., 0], 1e-300))
    return rotation, centre_t - np.einsum("...ij,...j->...i", rotation, centre_s), determined
