# SPDX-License-Identifier: Apache-2.0
"""Canonical Gaussians on the body's surface, and their neighbours on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.humans.start_settings import StartSettings
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.discs import DISC_WIDTH, make_discs

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class SurfaceSamples:
    """Points spread over a body mesh in the canonical pose; ``spacing_m`` is the root of the area per point.

    Normals are outward and of unit length, skinning weights are mixed from the face's corners.
    """

    points_m: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N J"]
    spacing_m: float


def sample_surface(
    vertices_m: Float[np.ndarray, "V 3"],
    faces: Integer[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "V J"],
    count: int,
    rng: np.random.Generator,
) -> SurfaceSamples:
    """``count`` points over the mesh, evenly by area: one in every ``count``-th of the area in face order, jittered.

    Successive faces of a body mesh are neighbours, so equal steps along the summed area leave neither clumps nor gaps.
    """
    vertex_normals, crosses = _vertex_normals(vertices_m, faces)
    areas = np.linalg.norm(crosses, axis=1) / 2
    total = np.cumsum(areas)
    at = (np.arange(count) + rng.random(count)) / count * total[-1]
    face = np.minimum(np.searchsorted(total, at), len(faces) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    mix = np.stack([1 - u - v, u, v], axis=1)
    normals = np.einsum("nk,nkc->nc", mix, vertex_normals[faces[face]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    mixed = np.einsum("nk,nkb->nb", mix, np.asarray(weights, np.float64)[faces[face]])
    points = np.einsum("nk,nkc->nc", mix, vertices_m[faces[face]])
    return SurfaceSamples(points, normals, mixed / mixed.sum(axis=1, keepdims=True), float(np.sqrt(total[-1] / count)))


def initial_samples(
    vertices_m: Float[np.ndarray, "V 3"],
    faces: Integer[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "V J"],
    how: StartSettings,
    rng: np.random.Generator,
) -> SurfaceSamples:
    """Start positions of a person's Gaussians, by the settings."""
    if how.placement == "vertices":
        return vertex_samples(vertices_m, faces, weights)
    return sample_surface(vertices_m, faces, weights, how.gaussians, rng)


def vertex_samples(
    vertices_m: Float[np.ndarray, "V 3"], faces: Integer[np.ndarray, "F 3"], weights: Float[np.ndarray, "V J"]
) -> SurfaceSamples:
    """One point at every vertex that a face uses (paper, appendix D), with the model's own weights."""
    used = np.unique(faces)
    normals, crosses = _vertex_normals(vertices_m, faces)
    area = np.linalg.norm(crosses, axis=1).sum() / 2
    own = np.asarray(weights, np.float64)[used]
    return SurfaceSamples(
        vertices_m[used].astype(np.float64),
        normals[used] / np.maximum(np.linalg.norm(normals[used], axis=1, keepdims=True), 1e-12),
        own / own.sum(axis=1, keepdims=True),
        float(np.sqrt(area / len(used))),
    )


def _vertex_normals(vertices_m: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) normals of vertices, as long as twice the area of the faces around them, and (F, 3) those of faces."""
    corners = vertices_m[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices_m)
    np.add.at(normals, faces.reshape(-1), np.repeat(crosses, 3, axis=0))
    return normals, crosses


def gaussians_on(samples: SurfaceSamples, sh_degree: int) -> Gaussians:
    """Grey discs on the samples, facing along their normals."""
    grey = np.full_like(samples.points_m, 0.5)
    return make_discs(samples.points_m, samples.normals, grey, samples.spacing_m * DISC_WIDTH, sh_degree=sh_degree)


def surface_neighbours(samples: SurfaceSamples, count: int) -> Integer[np.ndarray, "N K"]:
    """Indices of the nearest samples whose normals agree, so that a palm is no neighbour of the thigh next to it.

    Samples with fewer agreeing neighbours repeat themselves.
    """
    _, near = scipy.spatial.cKDTree(samples.points_m).query(samples.points_m, k=2 * count + 1)
    near = near[:, 1:]
    agree = np.einsum("nc,nkc->nk", samples.normals, samples.normals[near]) > 0
    order = np.argsort(~agree, axis=1, kind="stable")[:, :count]
    chosen, fits = np.take_along_axis(near, order, axis=1), np.take_along_axis(agree, order, axis=1)
    return np.where(fits, chosen, np.arange(len(near))[:, None])


def mirror_indices(samples: SurfaceSamples, within_m: float) -> Integer[np.ndarray, " N"]:
    """Index of the sample nearest to each sample's mirror image (x is left–right), −1 beyond ``within_m``."""
    distance, index = scipy.spatial.cKDTree(samples.points_m).query(samples.points_m * [-1, 1, 1])
    return np.where(distance <= within_m, index, -1)


def fill_unseen(
    values: Float[np.ndarray, "N C"],
    seen: Bool[np.ndarray, " N"],
    near: Integer[np.ndarray, "N K"],
    twin: Integer[np.ndarray, " N"],
    passes: int = 400,
) -> Float[np.ndarray, "N C"]:
    """``values`` with unseen rows filled: from the body's other side where seen, else from seen neighbours.

    Neighbours are averaged repeatedly over ``near`` (the discrete Laplace equation with seen rows fixed), starting from
    the mean of all seen rows. Rows stay unchanged when nothing was seen.
    """
    if not seen.any() or seen.all():
        return values
    filled = values.astype(np.float64).copy()
    from_twin = ~seen & (twin >= 0) & seen[np.maximum(twin, 0)]
    filled[from_twin] = filled[twin[from_twin]]
    known = seen | from_twin
    filled[~known] = filled[seen].mean(axis=0)
    hidden = np.flatnonzero(~known)
    for _ in range(passes if len(hidden) else 0):
        filled[hidden] = filled[near[hidden]].mean(axis=1)
    # A few passes over the copied rows smooth the seam to seen rows.
    copied = np.flatnonzero(from_twin)
    for _ in range(3 if len(copied) else 0):
        filled[copied] = filled[near[copied]].mean(axis=1)
    return filled.astype(values.dtype)
