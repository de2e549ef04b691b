# SPDX-License-Identifier: Apache-2.0
"""Lens distortion in both directions, with an answer that says where there is none.

Two models: ``"opencv"`` (k1 k2 p1 p2 k3 [k4 k5 k6]) and ``"fisheye"`` (k1 k2 k3 k4), both on normalised image coordinates
(camera rays at z = 1). Undistortion brackets the radius below the lens's fold and checks its own result by distorting again
(numerics C09, C10); fixed-point iteration, the usual shortcut, diverges for strong lenses without saying so.
"""

from __future__ import annotations

import numpy as np

_BISECTIONS = 60
_NEWTON_STEPS = 12
_RESIDUAL = 1e-9


def distort(points: np.ndarray, model: str, coefficients: np.ndarray) -> np.ndarray:
    """Distorted normalised coordinates (..., 2) of undistorted ones (..., 2). Says nothing about the fold: see ``fold_radius``."""
    points = np.asarray(points, dtype=np.float64)
    if model == "fisheye":
        radius = np.linalg.norm(points, axis=-1)
        safe = np.where(radius > 1e-12, radius, 1.0)
        return points * np.where(radius > 1e-12, _radial(np.arctan(radius), model, coefficients) / safe, 1.0)[..., None]
    k1, k2, p1, p2, k3, k4, k5, k6 = _opencv(coefficients)
    x, y = points[..., 0], points[..., 1]
    s = x * x + y * y
    gain = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    return np.stack(
        [x * gain + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * gain + p1 * (s + 2 * y * y) + 2 * p2 * x * y],
        axis=-1,
    )


def undistort(points: np.ndarray, model: str, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undistorted normalised coordinates (..., 2), NaN where the lens has no such ray, and where they are valid (...,).

    Valid means: distorting the answer gives the question to 1e-9, and the answer lies inside the fold (C09, C10).
    """
    points = np.asarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(-1)
    target = np.where(finite[..., None], points, 0.0)
    radius = np.linalg.norm(target, axis=-1)
    limit = fold_radius(model, coefficients)
    inside, reached = _invert_radial(radius, limit, model, coefficients)
    scale = np.where(radius > 1e-12, (np.tan(inside) if model == "fisheye" else inside) / np.where(radius > 1e-12, radius, 1.0), 1.0)
    answer = target * scale[..., None]
    tangential = model == "opencv" and bool(np.any(_opencv(coefficients)[2:4]))
    for _ in range(_NEWTON_STEPS if tangential else 0):
        answer = answer - _newton_step(answer, target, model, coefficients)
    residual = np.abs(distort(answer, model, coefficients) - target).max(-1)
    measured = np.linalg.norm(answer, axis=-1)
    measured = np.arctan(measured) if model == "fisheye" else measured
    valid = finite & reached & (residual < _RESIDUAL * np.maximum(1.0, radius)) & (measured <= limit * (1 + 1e-9))
    return np.where(valid[..., None], answer, np.nan), valid


def fold_radius(model: str, coefficients: np.ndarray) -> float:
    """Radius (fisheye: angle in radians) at which the radial distortion stops growing or has a pole; inf when it never does."""
    if model == "fisheye":
        k = np.zeros(4)
        k[: len(coefficients)] = coefficients
        derivative = [9 * k[3], 7 * k[2], 5 * k[1], 3 * k[0], 1.0]
        # A ray at 90 degrees has no pinhole coordinates.
        return float(np.sqrt(min(_smallest_positive_root(derivative), (np.pi / 2 - 1e-6) ** 2)))
    k1, k2, _, _, k3, k4, k5, k6 = _opencv(coefficients)
    numerator, denominator = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    s = np.poly1d([1.0, 0.0])
    slope = (numerator + 2 * s * numerator.deriv()) * denominator - 2 * s * numerator * denominator.deriv()
    return float(np.sqrt(min(_smallest_positive_root(slope.coeffs), _smallest_positive_root(denominator.coeffs))))


def _opencv(coefficients: np.ndarray) -> np.ndarray:
    full = np.zeros(8)
    full[: len(coefficients)] = coefficients
    return full


def _radial(radius: np.ndarray, model: str, coefficients: np.ndarray) -> np.ndarray:
    """Distorted radius of an undistorted radius (fisheye: of the angle)."""
    s = radius * radius
    if model == "fisheye":
        k = np.zeros(4)
        k[: len(coefficients)] = coefficients
        return radius * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
    k1, k2, _, _, k3, k4, k5, k6 = _opencv(coefficients)
    return radius * (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))


def _invert_radial(target: np.ndarray, limit: float, model: str, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius below ``limit`` whose distortion is ``target``, by bisection, and where the lens reaches it."""
    low = np.zeros_like(target)
    if np.isfinite(limit):
        high = np.full_like(target, limit)
    else:
        high = np.maximum(2 * target, 1.0)
        for _ in range(40):
            short = _radial(high, model, coefficients) < target
            if not short.any():
                break
            high = np.where(short, 2 * high, high)
    # Tangential terms shift the reachable region a little: leave that decision to the residual check.
    reached = _radial(high, model, coefficients) * 1.05 + 1e-12 >= target
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        below = _radial(middle, model, coefficients) < target
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2, reached


def _newton_step(answer: np.ndarray, target: np.ndarray, model: str, coefficients: np.ndarray) -> np.ndarray:
    """One two-dimensional Newton step with a central-difference Jacobian; zero where the Jacobian is singular."""
    h = 1e-6
    columns = []
    for axis in range(2):
        shift = np.zeros(2)
        shift[axis] = h
        columns.append((distort(answer + shift, model, coefficients) - distort(answer - shift, model, coefficients)) / (2 * h))
    (a, c), (b, d) = ((column[..., 0], column[..., 1]) for column in columns)
    determinant = a * d - b * c
    singular = np.abs(determinant) < 1e-12
    safe = np.where(singular, 1.0, determinant)
    residual = distort(answer, model, coefficients) - target
    step = np.stack([d * residual[..., 0] - b * residual[..., 1], a * residual[..., 1] - c * residual[..., 0]], axis=-1)
    return np.where(singular[..., None], 0.0, step / safe[..., None])


def _smallest_positive_root(polynomial: np.ndarray | list[float]) -> float:
    given = np.asarray(polynomial, dtype=np.float64)
    # A coefficient this small has its root further out than any lens sees, and would overflow the companion matrix.
    trimmed = np.trim_zeros(np.where(np.abs(given) < 1e-13, 0.0, given), "f")
    if len(trimmed) < 2:
        return np.inf
    roots = np.roots(trimmed)
    real = roots[np.abs(roots.imag) < 1e-9 * np.maximum(1.0, np.abs(roots))].real
    positive = real[real > 1e-12]
    return float(positive.min()) if len(positive) else np.inf
