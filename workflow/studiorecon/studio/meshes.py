# SPDX-License-Identifier: Apache-2.0
"""Solids with a surface and paint: triangle meshes in the world and their textures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# (N, 3) points and (N, 3) unit normals in the solid's own frame → (N, 3) linear albedo.
Texture = Callable[[np.ndarray, np.ndarray], np.ndarray]
UvTexture = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Mesh:
    """One painted mesh.

    Attributes:
        vertices_m: world.
        texture: paint, evaluated in the solid's own frame.
        world_from_solid: rigid.
        emission: radiance that it emits (the lamps), 0 otherwise.
        mirror: share of a mirror in its surface (the glossy floor).
        texture_vertices: in the texture's frame, for solids that bend; None = rigid, by ``world_from_solid``.
        vertex_normals: unit normals to interpolate; None = flat faces.
    """

    name: str
    vertices_m: Float[np.ndarray, "V 3"]
    faces: Integer[np.ndarray, "F 3"]
    texture: Texture
    world_from_solid: Float[np.ndarray, "4 4"]
    emission: float = 0.0
    mirror: float = 0.0
    texture_vertices: Float[np.ndarray, "V 3"] | None = None
    vertex_normals: Float[np.ndarray, "V 3"] | None = None


def pose_on_floor(position_m: tuple[float, float, float], yaw_rad: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """World_from_solid of an upright solid at a position."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    world_from_solid = np.eye(4)
    world_from_solid[:3, :3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    world_from_solid[:3, 3] = position_m
    return world_from_solid


def transform_points(
    points: Float[np.ndarray, "... 3"], matrix: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "... 3"]:
    """Points through a rigid transform."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def box_texture(texture: UvTexture, seed: int) -> Texture:
    """A texture in metres wrapped around a box: each face shows it upright, horizontal faces from above."""

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        axis = np.abs(normals).argmax(axis=1)
        u = np.where(axis == 0, points[:, 1], points[:, 0]) + 7.03
        v = np.where(axis == 2, points[:, 1], points[:, 2]) + (axis == 2) * 7.01
        return texture(u, v, seed)

    return paint


def plain_texture(colour: tuple[float, float, float]) -> Texture:
    """One colour everywhere."""

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.asarray(colour, dtype=np.float64), points.shape)

    return paint


def box(name: str, size_m: tuple[float, float, float], where: Float[np.ndarray, "4 4"], texture: Texture) -> Mesh:
    """A box standing on its origin: x and y centred, z from 0 to its height."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)]) * size_m
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return Mesh(name, transform_points(corners, where), faces, texture, where)


def lathe(
    name: str, profile: list[tuple[float, float]], where: Float[np.ndarray, "4 4"], texture: Texture, segments: int = 48
) -> Mesh:
    """A surface of revolution about z through (radius, height) pairs from bottom to top; radius 0 closes an end."""
    angle = np.arange(segments) * (2 * np.pi / segments)
    rings = np.array([[[r * np.cos(a), r * np.sin(a), z] for a in angle] for r, z in profile])
    k = np.arange(segments)
    following = (k + 1) % segments
    faces = []
    for ring in range(len(profile) - 1):
        low, high = ring * segments, (ring + 1) * segments
        faces.append(np.stack([low + k, low + following, high + following], axis=1))
        faces.append(np.stack([low + k, high + following, high + k], axis=1))
    return Mesh(name, transform_points(rings.reshape(-1, 3), where), np.concatenate(faces), texture, where)


def quad(name: str, corners_m: list[list[float]], texture: Texture) -> Mesh:
    """A rectangle given by its four corners in order, in world coordinates."""
    return Mesh(name, np.array(corners_m, dtype=np.float64), np.array([[0, 1, 2], [0, 2, 3]]), texture, np.eye(4))


def sphere(name: str, radius_m: float, centre_m: Float[np.ndarray, " 3"], texture: Texture) -> Mesh:
    """A ball around a point."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 25)
    where = np.eye(4)
    where[:3, 3] = centre_m
    return lathe(name, [(radius_m * np.cos(a), radius_m * np.sin(a)) for a in angles], where, texture)
