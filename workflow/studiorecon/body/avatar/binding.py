# SPDX-License-Identifier: Apache-2.0
"""Ties a person's Gaussians in the rest pose to the body: its shape, its place among them, and their skinning weights.

Gaussians of another method (LHM's, or any ``.ply`` of that kind) come without their skeleton, and knees would bend in
the wrong place on another one. So the body's shape is fitted to the Gaussians first: the rest pose is linear in the
shape, and nearest points alternate with least squares. Then every Gaussian takes the weights of the nearest surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.arrays import require
from studiorecon.body.avatar.posing import MAX_SH_DEGREE
from studiorecon.body.avatar.weight_grid import strongest_weights
from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

_FITTED_ON = 2000
_ROUNDS = 40
# Clothes and hair are about this far from the body; points more than three times as far pull no harder.
_STAND_OFF_M = 0.03
# Shape coordinates are standard normal; offsets of neighbouring points are correlated, so only this many count as
# independent.
_INDEPENDENT_POINTS = 100
# In another pose, hands or feet are further than this from any Gaussian.
_FURTHEST_M = 0.10
_HEIGHTS_M = (0.6, 2.5)


@dataclass(frozen=True)
class Binding:
    """Gaussians tied to the body.

    Attributes:
        gaussians: N Gaussians in the body's own shaped rest pose, metres, SH degree at most 2.
        bones, weights: uint8 joints that carry each; float32 weights, rows sum to 1.
        betas: the body's shape.
        misfit_m: distance within which 95 % of the body's surface has a Gaussian.
    """

    gaussians: Gaussians
    bones: Integer[np.ndarray, "N 4"]
    weights: Float[np.ndarray, "N 4"]
    betas: Num[np.ndarray, " B"]
    misfit_m: float


def bind(given: Gaussians, model: BodyModel, named: str) -> Binding:
    """Tie canonical Gaussians, if finite, to the body; ``named`` is their source in messages.

    Raises UserError when they are not a standing body in the rest pose: arms out to the sides, y up, z forward, metres.
    """
    finite = np.isfinite(
        np.concatenate([given.means_m, given.log_scales, given.quaternions, given.sh[:, 0]], axis=1)
    ).all(axis=1)
    own = given.take(finite & ~np.isnan(given.logit_opacities))
    own = own.with_sh_degree(min(own.sh_degree, MAX_SH_DEGREE))
    solid = own.means_m[own.logit_opacities > 0].astype(np.float64)
    if len(solid) < _FITTED_ON // 10:
        raise UserError(f"{named} has {len(solid)} solid Gaussians, too few for a person; give a canonical human .ply")
    tall = float(np.ptp(np.percentile(solid[:, 1], [0.5, 99.5])))
    if not _HEIGHTS_M[0] <= tall <= _HEIGHTS_M[1]:
        raise UserError(
            f"{named} is {tall:.2f} high along y: not a person in the rest pose in metres "
            "with y up; give a canonical human .ply "
            "(humans/p0.ply of a result, or LHM's)"
        )
    points = solid[np.linspace(0, len(solid) - 1, min(len(solid), _FITTED_ON)).astype(int)]
    betas, shift_m, misfit_m = _fit(points, model)
    turned_m = _fit(points * [-1, 1, -1], model)[2]
    if turned_m < min(misfit_m, _FURTHEST_M):
        raise UserError(f"{named} faces backwards (−z); turn it by half a turn about y")
    if misfit_m > _FURTHEST_M:
        raise UserError(
            f"{named} is not in the rest pose: parts of a body standing with its arms "
            "out to the sides, y up, z forward, are "
            f"{100 * misfit_m:.0f} cm from any of its Gaussians; give a canonical human "
            ".ply (humans/p0.ply of a result, or LHM's)"
        )
    placed = replace(own, means_m=own.means_m - shift_m.astype(np.float32))
    bones, weights = surface_weights(
        placed.means_m, model.rest_vertices(betas)[_outside(model)], model.weights[_outside(model)]
    )
    return Binding(placed, bones, weights, betas, misfit_m)


def surface_weights(
    points_m: Num[np.ndarray, "N 3"], vertices_m: Num[np.ndarray, "V 3"], weights: Num[np.ndarray, "V J"]
) -> tuple[Integer[np.ndarray, "N 4"], Num[np.ndarray, "N 4"]]:
    """Joints and skinning weights of points, from the four nearest vertices by inverse squared distance.

    The square keeps a thigh's skin from following the other thigh (L06). Raises ValueError for other shapes.
    """
    sizes = require("vertices_m", vertices_m, ("V", 3))
    require("weights", weights, ("V", "J"), sizes)
    require("points_m", points_m, ("N", 3))
    distance, index = scipy.spatial.cKDTree(vertices_m).query(np.asarray(points_m, np.float64), k=4)
    share = 1 / np.maximum(distance, 1e-4) ** 2
    mixed = np.einsum("nk,nkj->nj", share / share.sum(axis=1, keepdims=True), weights[index].astype(np.float64))
    return strongest_weights(mixed)


def _outside(model: BodyModel) -> np.ndarray:
    """(V,) bool: vertices that can be seen from outside (not the mouth's)."""
    return np.array([name != "inside" for name in model.region_names])[model.region]


def _fit(points_m: np.ndarray, model: BodyModel) -> tuple[np.ndarray, np.ndarray, float]:
    """Shape, offset of the rest pose to ``points_m``, and the distance within which 95 % of the body has a point."""
    vertices = np.flatnonzero(_outside(model))
    vertices = vertices[np.linspace(0, len(vertices) - 1, min(len(vertices), _FITTED_ON)).astype(int)]
    template, directions = model.template_m[vertices], model.shape_directions[vertices]
    betas = np.zeros(model.shapes)
    shift = np.percentile(points_m, [1, 99], axis=0).mean(axis=0) - np.percentile(template, [1, 99], axis=0).mean(
        axis=0
    )
    tree = scipy.spatial.cKDTree(points_m)
    ridge = np.append(np.ones(model.shapes), np.zeros(3)) * _STAND_OFF_M**2 * len(points_m) / _INDEPENDENT_POINTS
    for _ in range(_ROUNDS):
        body = template + directions @ betas + shift
        to_point, point = tree.query(body)
        to_body, vertex = scipy.spatial.cKDTree(body).query(points_m)
        # Nearest points in both directions: from the body to the Gaussians, and from the Gaussians' extremes to the
        # body.
        rows = np.concatenate([np.arange(len(body)), vertex])
        target = np.concatenate([points_m[point], points_m]) - template[rows]
        distance = np.concatenate([to_point, to_body])
        pull = 1 / np.maximum(distance / (3 * _STAND_OFF_M), 1)
        design = np.concatenate([directions[rows], np.broadcast_to(np.eye(3), (len(rows), 3, 3))], axis=2)
        normal = np.einsum("rxa,r,rxb->ab", design, pull, design, optimize=True) + np.diag(ridge)
        solution = np.linalg.solve(normal, np.einsum("rxa,r,rx->a", design, pull, target, optimize=True))
        moved = np.abs(solution - np.concatenate([betas, shift])).max()
        betas, shift = solution[: model.shapes], solution[model.shapes :]
        if moved < 1e-4:
            break
    return betas, shift, float(np.percentile(tree.query(template + directions @ betas + shift)[0], 95))
