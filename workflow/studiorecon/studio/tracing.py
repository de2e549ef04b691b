# SPDX-License-Identifier: Apache-2.0
"""Rays against painted meshes (Intel's Embree, through embreex), and the light at their hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from studiorecon.studio.meshes import Mesh
from studiorecon.studio.room import HALF_X_M, HALF_Y_M, HEIGHT_M, LAMP_BELOW_CEILING_M, LAMP_SHARES, LAMPS_M

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Shaped

POINTS_PER_LAMP = 16
_SKIN_M = 2e-3  # shadow rays start this far off the surface, so that it does not shade itself


@dataclass(frozen=True)
class Hits:
    """Hits of N rays, in the ray caster's single precision.

    Attributes:
        distance: in lengths of the ray's direction; inf for no hit.
        solid: index into the traced solids; -1 for no hit.
        face: triangle within the solid.
        barycentric: weights of the triangle's second and third vertex.
        normal: unit geometric normal, as the mesh has it.
    """

    distance: Float[np.ndarray, " N"]
    solid: Integer[np.ndarray, " N"]
    face: Integer[np.ndarray, " N"]
    barycentric: Float[np.ndarray, "N 2"]
    normal: Float[np.ndarray, "N 3"]

    @property
    def is_hit(self) -> Bool[np.ndarray, " N"]:
        """Rays that hit a solid."""
        return self.solid >= 0

    def take(self, rays: Shaped[np.ndarray, " M"]) -> Hits:
        """The hits of some rays, by index or mask."""
        return Hits(self.distance[rays], self.solid[rays], self.face[rays], self.barycentric[rays], self.normal[rays])


class Tracer:
    """Solids in a ray-casting structure that is built once; one thread casts, because cameras run in parallel."""

    def __init__(self, solids: Sequence[Mesh]) -> None:
        self._scene = EmbreeScene(robust=True)
        for solid in solids:
            vertices = np.ascontiguousarray(solid.vertices_m, dtype=np.float32)
            TriangleMesh(self._scene, vertices, np.ascontiguousarray(solid.faces, dtype=np.int32))

    def cast(self, origins_m: Float[np.ndarray, "... 3"], directions: Float[np.ndarray, "N 3"]) -> Hits:
        """First hits of rays from or (3,) origins along directions of any length."""
        answer = self._scene.run(*_rays(origins_m, directions), output=True)
        met = answer["geomID"] >= 0
        normal = np.where(met[:, None], answer["Ng"], 0)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(np.float32).tiny)
        return Hits(
            distance=np.where(met, answer["tfar"], np.float32(np.inf)),
            solid=answer["geomID"].astype(np.int64),
            face=np.where(met, answer["primID"], 0).astype(np.int64),
            barycentric=np.where(met[:, None], np.column_stack([answer["u"], answer["v"]]), 0),
            normal=normal,
        )

    def blocked(
        self, origins_m: Float[np.ndarray, "... 3"], targets_m: Float[np.ndarray, "... 3"]
    ) -> Bool[np.ndarray, " N"]:
        """Whether a solid is between the points and their targets."""
        # Shadow rays end at this share of their way, so that the target does not block itself.
        return self._scene.run(*_rays(origins_m, targets_m - origins_m), 0.999, query="OCCLUDED") >= 0


def lamp_points(subset: int, subsets: int) -> Float[np.ndarray, "M 4"]:
    """Points on the lamps and their strength, for one of ``subsets`` rays of a pixel: together they cover both lamps.

    A low-discrepancy sequence (the plastic number's) makes a pixel's penumbra smooth.
    """
    per_lamp = max(2, POINTS_PER_LAMP // subsets)
    k = np.arange(subset * per_lamp, (subset + 1) * per_lamp)
    u, v = (0.5 + k * 0.7548776662466927) % 1 * 2 - 1, (0.5 + k * 0.5698402909980532) % 1 * 2 - 1
    # Just below the luminous face, so that the lamp does not block its own light.
    height = np.full(per_lamp, HEIGHT_M - LAMP_BELOW_CEILING_M - 0.004)
    lamps = [
        np.stack([cx + hx * u, cy + hy * v, height, np.full(per_lamp, share)], axis=1)
        for (cx, cy, hx, hy), share in zip(LAMPS_M, LAMP_SHARES)
    ]
    return np.concatenate(lamps)


def lamp_light(
    points_m: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    lamps: Float[np.ndarray, "M 4"],
    tracer: Tracer,
) -> Float[np.ndarray, " N"]:
    """Irradiance from the lamp points, shadows included: their mean of both cosines over distance squared."""
    gains = np.stack([lamp_gain(points_m, normals, lamp[:3]) * lamp[3] for lamp in lamps.astype(points_m.dtype)])
    lamp, point = np.nonzero(gains)
    starts = points_m + normals * points_m.dtype.type(_SKIN_M)
    gains[lamp, point] *= ~tracer.blocked(starts[point], lamps[lamp, :3])
    return gains.mean(axis=0)


def lamp_gain(
    points_m: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], lamp_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " N"]:
    """Irradiance that one lamp point would give without obstacles; 0 on the side that faces away."""
    towards = lamp_m - points_m
    squared = np.einsum("ij,ij->i", towards, towards)
    cosines = np.einsum("ij,ij->i", towards, normals) * towards[:, 2]
    return 2 * 9.4 * np.maximum(cosines, 0) / (squared * (squared + 0.3))


def ambient_light(points_m: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    """Light reflected by the room: brighter on upward surfaces, darker in edges and corners (closed form, no rays)."""
    light = 0.24 * (1 + 0.22 * normals[:, 2])
    for axis, half in ((0, HALF_X_M), (1, HALF_Y_M)):
        gap = np.minimum(half - points_m[:, axis], half + points_m[:, axis])
        light = light * (1 - 0.32 * np.exp(-np.maximum(gap, 0) / 0.28) * (1 - np.abs(normals[:, axis])))
    for gap in (points_m[:, 2], HEIGHT_M - points_m[:, 2]):
        light = light * (1 - 0.32 * np.exp(-np.maximum(gap, 0) / 0.28) * (1 - np.abs(normals[:, 2])))
    return light


def _rays(origins_m: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Two arrays of one length: embreex reads as many directions as there are origins without a check.
    directions = np.ascontiguousarray(directions, dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(np.asarray(origins_m, dtype=np.float32), directions.shape)), directions


@dataclass(frozen=True)
class TracedSurface:
    """Surfaces at the rays' hits: points, unit normals towards the ray's side, albedo, emission and mirror."""

    points_m: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    albedo: Float[np.ndarray, "N 3"]
    emission: Float[np.ndarray, " N"]
    mirror: Float[np.ndarray, " N"]


def hit_surfaces(
    solids: Sequence[Mesh], hits: Hits, origins_m: Float[np.ndarray, "... 3"], directions: Float[np.ndarray, "N 3"]
) -> TracedSurface:
    """Surfaces at the hits, all of which must have hit a solid; evaluated solid by solid."""
    points = origins_m + directions * hits.distance[:, None]
    normals = hits.normal.astype(points.dtype)
    albedo = np.zeros_like(points)
    emission, mirror = np.zeros(len(points), points.dtype), np.zeros(len(points), points.dtype)
    for index in np.unique(hits.solid):
        here = np.flatnonzero(hits.solid == index)
        solid = solids[index]
        corners = solid.faces[hits.face[here]]
        weights = np.column_stack([1 - hits.barycentric[here].sum(axis=1), hits.barycentric[here]])
        if solid.vertex_normals is not None:
            normals[here] = np.einsum("nk,nkx->nx", weights, solid.vertex_normals[corners])
        rotation = solid.world_from_solid[:3, :3].astype(points.dtype)
        if solid.texture_vertices is not None:
            local = np.einsum("nk,nkx->nx", weights, solid.texture_vertices[corners])
        else:
            local = (points[here] - solid.world_from_solid[:3, 3].astype(points.dtype)) @ rotation
        albedo[here] = solid.texture(local, normals[here] @ rotation)
        emission[here], mirror[here] = solid.emission, solid.mirror
    # Thin walls are seen from one side only, but a mesh's winding may be the other.
    normals = np.where((np.einsum("ij,ij->i", hits.normal, directions) > 0)[:, None], -normals, normals)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return TracedSurface(points, normals, albedo, emission, mirror)


def radiance(
    solids: Sequence[Mesh],
    tracer: Tracer,
    hits: Hits,
    origins_m: Float[np.ndarray, "... 3"],
    directions: Float[np.ndarray, "N 3"],
    lamps: Float[np.ndarray, "M 4"],
    bounces: int = 1,
) -> Float[np.ndarray, "N 3"]:
    """Light along the rays: diffuse under the lamps and the room's reflected light, plus one mirror bounce."""
    surface = hit_surfaces(solids, hits, origins_m, directions)
    light = lamp_light(surface.points_m, surface.normals, lamps, tracer) + ambient_light(
        surface.points_m, surface.normals
    )
    colour = surface.albedo * (light + surface.emission)[:, None]
    glossy = np.flatnonzero(surface.mirror > 0)
    if bounces and len(glossy):
        normals, incoming = surface.normals[glossy], directions[glossy]
        across = np.einsum("ij,ij->i", incoming, normals)
        outgoing = incoming - 2 * across[:, None] * normals
        starts = surface.points_m[glossy] + normals * _SKIN_M
        mirrored = tracer.cast(starts, outgoing)
        seen = np.flatnonzero(mirrored.is_hit)
        reflection = np.zeros((len(glossy), 3))
        reflection[seen] = radiance(
            solids, tracer, mirrored.take(seen), starts[seen], outgoing[seen], lamps, bounces - 1
        )
        # Schlick's approximation: a varnish reflects little straight down and much at a grazing angle.
        cosine = np.abs(across) / np.linalg.norm(incoming, axis=1)
        share = np.minimum(surface.mirror[glossy] * (0.25 + 0.75 * (1 - cosine) ** 5), 1.0)[:, None]
        colour[glossy] = colour[glossy] * (1 - share) + reflection * share
    return colour
