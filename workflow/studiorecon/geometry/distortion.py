# SPDX-License-Identifier: Apache-2.0
"""Lens distortion in both directions, with "undefined" as a possible result.

Two models: ``"opencv"`` (k1 k2 p1 p2 k3 [k4 k5 k6]) and ``"fisheye"`` (k1 k2 k3 k4), both on normalised image
coordinates (camera rays at z = 1). Undistortion brackets the radius below the lens's fold and checks its own result by
distorting again (C09, C10). Fixed-point iteration, the usual shortcut, diverges silently for strong lenses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

_COEFFICIENTS = {"opencv": 8, "fisheye": 4}


def distort(
    points: Num[np.ndarray, "... 2"], model: str, coefficients: Num[np.ndarray, " C"]
) -> Num[np.ndarray, "... 2"]:
    """Distorted normalised coordinates of undistorted ones; the fold is not checked, see ``fold_radius``.

    Raises ValueError for another model, too many coefficients or ones that are not finite, or points of another shape.
    """
    points = np.asarray(points, dtype=np.float64)
    require("points", points, (..., 2))
    full = _full(model, coefficients)
    if model == "fisheye":
        radius = np.linalg.norm(points, axis=-1)
        angle = np.arctan(radius)
        s = angle * angle
        grown = angle * (1 + s * (full[0] + s * (full[1] + s * (full[2] + s * full[3]))))
        return points * np.where(radius > 1e-12, grown / np.where(radius > 1e-12, radius, 1.0), 1.0)[..., None]
    k1, k2, p1, p2, k3, k4, k5, k6 = full
    x, y = points[..., 0], points[..., 1]
    s = x * x + y * y
    gain = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    return np.stack(
        [x * gain + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * gain + p1 * (s + 2 * y * y) + 2 * p2 * x * y],
        axis=-1,
    )


def undistort(
    points: Num[np.ndarray, "... 2"], model: str, coefficients: Num[np.ndarray, " C"]
) -> tuple[Num[np.ndarray, "... 2"], Bool[np.ndarray, " ..."]]:
    """Undistorted normalised coordinates, NaN where the lens has no such ray, and where they are valid.

    Valid: distorting the result gives the input to 1e-9, and the result is inside the fold (C09, C10). Newton per
    radius inside a bracket, then in the plane for tangential terms. Raises ValueError as ``distort`` does.
    """
    points = np.asarray(points, dtype=np.float64)
    require("points", points, (..., 2))
    full = _full(model, coefficients)
    if model == "opencv" and not full.any():
        valid = np.isfinite(points).all(-1)
        return np.where(valid[..., None], points, np.nan), valid
    # Loaded here: most steps undistort nothing, and numba takes longer to import than they take to start.
    from studiorecon.geometry import distortion_kernels as kernels

    flat = np.ascontiguousarray(points.reshape(-1, 2))
    answers, valid = np.empty_like(flat), np.empty(len(flat), dtype=bool)
    kernels.undistort(
        flat,
        full,
        model == "fisheye",
        fold_radius(model, coefficients),
        1e-9,
        answers,
        valid,
    )
    return answers.reshape(points.shape), valid.reshape(points.shape[:-1])


def fold_radius(model: str, coefficients: Num[np.ndarray, " C"]) -> float:
    """Radius (fisheye: angle in radians) at which the radial distortion stops growing or has a pole; inf if it never
    does.

    Raises ValueError for another model or coefficients that are not finite.
    """
    full = _full(model, coefficients)
    if model == "fisheye":
        k = full[:4]
        derivative = [9 * k[3], 7 * k[2], 5 * k[1], 3 * k[0], 1.0]
        # A ray at 90 degrees has no pinhole coordinates.
        return float(np.sqrt(min(_smallest_positive_root(derivative), (np.pi / 2 - 1e-6) ** 2)))
    k1, k2, _, _, k3, k4, k5, k6 = full
    numerator, denominator = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    s = np.poly1d([1.0, 0.0])
    slope = (numerator + 2 * s * numerator.deriv()) * denominator - 2 * s * numerator * denominator.deriv()
    return float(np.sqrt(min(_smallest_positive_root(slope.coeffs), _smallest_positive_root(denominator.coeffs))))


def _full(model: str, coefficients: np.ndarray) -> np.ndarray:
    """(8,) all coefficients of the model, missing ones 0."""
    most = _COEFFICIENTS.get(model)
    if most is None:
        raise ValueError(f"model must be one of {sorted(_COEFFICIENTS)}, not {model!r}")
    given = np.asarray(coefficients, dtype=np.float64).reshape(-1)
    if len(given) > most or not np.isfinite(given).all():
        raise ValueError(
            f"coefficients of the {model} model must be at most {most} finite numbers, not {given.tolist()}"
        )
    full = np.zeros(8)
    full[: len(given)] = given
    return full


def _smallest_positive_root(polynomial: np.ndarray | list[float]) -> float:
    given = np.asarray(polynomial, dtype=np.float64)
    # A coefficient this small has its root outside of any lens's field, and would overflow the companion matrix.
    trimmed = np.trim_zeros(np.where(np.abs(given) < 1e-13, 0.0, given), "f")
    if len(trimmed) < 2:
        return np.inf
    roots = np.roots(trimmed)
    real = roots[np.abs(roots.imag) < 1e-9 * np.maximum(1.0, np.abs(roots))].real
    positive = real[real > 1e-12]
    return float(positive.min()) if len(positive) else np.inf
