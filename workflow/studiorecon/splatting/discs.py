# SPDX-License-Identifier: Apache-2.0
"""Flat Gaussians: discs on a surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.gaussians import Gaussians, sh_from_rgb

if TYPE_CHECKING:
    from jaxtyping import Float, Num


DISC_WIDTH = 0.6
"""A disc's standard deviation as a share of the spacing of discs: neighbours just overlap."""


def make_discs(
    points_m: Num[np.ndarray, "N 3"],
    normals: Num[np.ndarray, "N 3"],
    rgb: Num[np.ndarray, "N 3"],
    width_m: Num[np.ndarray, " N"] | float,
    flatness: float = 0.33,
    opacity: float = 0.9,
    sh_degree: int = 0,
) -> Gaussians:
    """Discs at points facing ± ``normals``; ``width_m`` is the standard deviation along the surface.

    ``flatness`` is the share of it across.
    """
    count = len(points_m)
    width = np.maximum(np.broadcast_to(np.asarray(width_m, np.float64), (count,)), 1e-4)
    log_scales = np.log(width)[:, None] + np.log([1.0, 1.0, flatness])
    sh = np.zeros((count, (sh_degree + 1) ** 2, 3))
    sh[:, 0] = sh_from_rgb(rgb)
    logits = np.full(count, np.log(opacity / (1 - opacity)))
    return Gaussians(np.asarray(points_m), quaternions_facing(normals), log_scales, logits, sh)


def quaternions_facing(normals: Num[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """Unit quaternions (w, x, y, z) that turn the z axis to ± (N, 3) normals; a zero normal gives the identity."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    n = np.where(length > 0, normals / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    n = np.where(n[:, 2:] < 0, -n, n)  # a disc has no front, and the turn to the upper half is never degenerate
    q = np.stack([1 + n[:, 2], -n[:, 1], n[:, 0], np.zeros(len(n))], axis=1)
    return q / np.linalg.norm(q, axis=1, keepdims=True)
