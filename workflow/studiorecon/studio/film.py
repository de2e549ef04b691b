# SPDX-License-Identifier: Apache-2.0
"""One camera's pictures: the static room once, then per frame only the pixels that moving solids touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.distortion import distort
from studiorecon.scene.camera import Lens
from studiorecon.studio.description import Effects
from studiorecon.studio.meshes import Mesh
from studiorecon.studio.rig import ray_directions
from studiorecon.studio.room import HEIGHT_M, LAMPS_M
from studiorecon.studio.tracing import Tracer, lamp_points, radiance

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_NEAR_M = 0.05
_CONTACT_REACH_M = 0.10


@dataclass
class Backdrop:
    """The empty room through one lens, ray by ray: S rays per pixel, N = H·W pixels.

    Attributes:
        lens, solids: the lens; the room.
        rays: world directions, one metre of z-depth long.
        depth_m, colour: z-depth and radiance of the room.
        solid, mean: index of the visible solid; radiance of the pixels.
        lamps: one set of lamp points per ray of a pixel.
    """

    lens: Lens
    solids: list[Mesh]
    rays: Float[np.ndarray, "S N 3"]
    depth_m: Float[np.ndarray, "S N"]
    colour: Float[np.ndarray, "S N 3"]
    solid: Integer[np.ndarray, "S N"]
    mean: Float[np.ndarray, "N 3"]
    lamps: list[Float[np.ndarray, "M 4"]]

    @property
    def centre_m(self) -> Float[np.ndarray, " 3"]:
        return centre_m(self.lens)

    def picture(self) -> Float[np.ndarray, "H W 3"]:
        """Radiance of the empty room."""
        return self.mean.reshape(self.lens.wh[1], self.lens.wh[0], 3)


def trace_backdrop(lens: Lens, solids: list[Mesh], supersampling: int) -> Backdrop:
    """The empty room, traced through a lens."""
    rays = ray_directions(lens, supersampling).astype(np.float32)
    tracer = Tracer(solids)
    lamps = [lamp_points(s, len(rays)) for s in range(len(rays))]
    depth, colour, seen = (
        np.zeros(rays.shape[:2]),
        np.zeros(rays.shape, dtype=np.float32),
        np.zeros(rays.shape[:2], dtype=np.int16),
    )
    for s, subset in enumerate(rays):
        hits = tracer.cast(centre_m(lens), subset)
        if not hits.is_hit.all():
            raise ValueError(f"camera {lens.name} faces out of the room")
        depth[s], seen[s] = hits.distance, hits.solid
        origins = np.broadcast_to(centre_m(lens).astype(np.float32), subset.shape)
        colour[s] = radiance(solids, tracer, hits, origins, subset, lamps[s])
    return Backdrop(lens, solids, rays, depth, colour, seen, colour.mean(axis=0, dtype=np.float64), lamps)


def render_frame(
    scene: Backdrop,
    tracer: Tracer,
    moving: list[Mesh],
    touched: Bool[np.ndarray, " N"],
    soles_m: Float[np.ndarray, "P 4 3"],
    effects: Effects,
) -> Float[np.ndarray, "H W 3"]:
    """Radiance of one frame with the ``moving`` solids in the room at ``touched_pixels``.

    ``tracer`` holds room and moving solids, the room first.
    """
    height, width = scene.lens.wh[1], scene.lens.wh[0]
    picture = scene.mean.copy()
    shaded = _shadow_pixels(scene, moving) if effects.moving_shadows else np.zeros(height * width, dtype=bool)
    if effects.glossy_floor and moving:
        reflected = [_mirror_solid(solid) for solid in moving]
        shaded |= touched_pixels(scene.lens, reflected) & (scene.solid == 0).any(axis=0)
    darkened = _contact_pixels(scene, soles_m) if effects.contact_shading else np.zeros(height * width, dtype=bool)
    changed = np.flatnonzero(touched | shaded | darkened)
    if len(changed) == 0:
        return picture.reshape(height, width, 3)
    solids = scene.solids + moving
    direct, again = touched[changed], shaded[changed]
    retrace = np.flatnonzero(direct | again)
    origin = scene.centre_m.astype(np.float32)
    shade = (
        contact_shade(_floor_points(scene, changed), soles_m, effects.contact_shading)
        if effects.contact_shading
        else None
    )
    total = np.zeros((len(changed), 3))
    for s, every_ray in enumerate(scene.rays):
        colour, solid_seen = scene.colour[s, changed], scene.solid[s, changed].astype(np.int64)
        rays = every_ray[changed[retrace]]
        hits = tracer.cast(origin, rays)
        is_moving = hits.solid >= len(scene.solids)
        # The room keeps its stored colour wherever no moving solid is visible or casts a shadow: the same bits from
        # frame to frame. Half the lamp points suffice for moving solids; the room must be lit by the same ones as in
        # its stored colour.
        for part, lamps in (
            (is_moving, scene.lamps[s][::2]),
            (hits.is_hit & ~is_moving & again[retrace], scene.lamps[s]),
        ):
            chosen = np.flatnonzero(part)
            if len(chosen):
                origins = np.broadcast_to(origin, (len(chosen), 3))
                colour[retrace[chosen]] = radiance(solids, tracer, hits.take(chosen), origins, rays[chosen], lamps)
                solid_seen[retrace[chosen]] = hits.solid[chosen]
        if shade is not None:
            colour = colour * np.where(solid_seen == 0, shade, 1.0)[:, None]
        total += colour
    picture[changed] = total / len(scene.rays)
    return picture.reshape(height, width, 3)


def touched_pixels(lens: Lens, moving: Sequence[Mesh]) -> Bool[np.ndarray, " N"]:
    """All pixels that the solids can cover, and a few around them.

    Vertices are marked and grown by the longest edge in pixels: no point of a triangle is farther from a vertex.
    """
    import cv2

    width, height = lens.wh
    touched = np.zeros((height, width), dtype=np.uint8)
    for solid in moving:
        pixels, depth = project(lens, solid.vertices_m)
        front = depth > _NEAR_M
        if not front.any():
            continue
        a, b, c = (pixels[solid.faces[:, k]] for k in range(3))
        squared = np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))])
        squared = squared[front[solid.faces].all(axis=1)]
        reach = int(np.ceil(min(np.sqrt(squared.max(initial=1.0)), 64.0))) + 1
        marked = np.zeros((height + 2 * reach, width + 2 * reach), dtype=np.uint8)
        columns, rows = (np.floor(pixels[front]).astype(np.int64) + reach).T
        inside = (columns >= 0) & (columns < marked.shape[1]) & (rows >= 0) & (rows < marked.shape[0])
        marked[rows[inside], columns[inside]] = 1
        grown: np.ndarray = cv2.dilate(marked, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        touched |= grown[reach : reach + height, reach : reach + width]
    return touched.ravel() > 0


def project(
    lens: Lens, points_m: Float[np.ndarray, "... 3"]
) -> tuple[Float[np.ndarray, "... 2"], Float[np.ndarray, " ..."]]:
    """Pixels of world points through a lens with distortion, and their z-depth; far off-screen behind the camera."""
    in_camera = points_m @ lens.camera_from_world[:3, :3].T + lens.camera_from_world[:3, 3]
    depth = in_camera[..., 2]
    normalised = in_camera[..., :2] / np.where(depth > _NEAR_M, depth, 1.0)[..., None]
    if lens.distortion.any():
        normalised = distort(normalised, lens.model, lens.distortion)
    pixels = normalised * np.diag(lens.intrinsics)[:2] + lens.intrinsics[:2, 2]
    return np.where((depth > _NEAR_M)[..., None], np.clip(pixels, -1e6, 1e6), -1e6), depth


def centre_m(lens: Lens) -> Float[np.ndarray, " 3"]:
    """Position of the lens."""
    return -lens.camera_from_world[:3, :3].T @ lens.camera_from_world[:3, 3]


def contact_shade(
    points_m: Float[np.ndarray, "N 3"], soles_m: Float[np.ndarray, "P 4 3"], strength: float
) -> Float[np.ndarray, " N"]:
    """Factor by which the floor darkens near soles: soft within a hand's width, gone when the foot is lifted."""
    shade = np.ones(len(points_m))
    for sole in soles_m.reshape(-1, 3):
        away = np.sum((points_m[:, :2] - sole[:2]) ** 2, axis=1) / _CONTACT_REACH_M**2
        shade *= 1 - 0.75 * strength * np.exp(-away - max(float(sole[2]), 0.0) / 0.07)
    return shade


def _contact_pixels(scene: Backdrop, soles_m: np.ndarray) -> np.ndarray:
    """(N,) bool: pixels of the floor within three contact reaches of a sole, by the box around that disc's picture."""
    width, height = scene.lens.wh
    angle = np.arange(24) * (2 * np.pi / 24)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * (3.0 * _CONTACT_REACH_M / np.cos(np.pi / 24))
    near = np.zeros((height, width), dtype=bool)
    for sole in soles_m.reshape(-1, 3):
        pixels, depth = project(scene.lens, rim + np.append(sole[:2], 0.0))
        if (depth > _NEAR_M).all():
            (left, top), (right, bottom) = (
                np.floor(pixels.min(axis=0)).astype(int),
                np.ceil(pixels.max(axis=0)).astype(int),
            )
            near[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return near.ravel() & (scene.solid == 0).any(axis=0)


def _floor_points(scene: Backdrop, pixels: np.ndarray) -> np.ndarray:
    """(M, 3) points where the first ray of some pixels meets the floor's plane; a point far away where it does not."""
    rays = scene.rays[0, pixels]
    downward = np.minimum(rays[:, 2], -1e-6)
    return scene.centre_m + rays * (-scene.centre_m[2] / downward)[:, None]


def _shadow_pixels(scene: Backdrop, moving: list[Mesh]) -> np.ndarray:
    """(N,) bool: pixels whose way to a lamp may pass a moving solid, by upright bounding cylinders."""
    points = scene.centre_m + scene.rays[0].astype(np.float64) * scene.depth_m[0][:, None]
    found = np.zeros(len(points), dtype=bool)
    for solid in moving:
        low, high = solid.vertices_m.min(axis=0), solid.vertices_m.max(axis=0)
        axis, radius = (low[:2] + high[:2]) / 2, np.linalg.norm(high[:2] - low[:2]) / 2
        for cx, cy, hx, hy in LAMPS_M:
            climb = np.clip((high[2] - points[:, 2]) / np.maximum(HEIGHT_M - points[:, 2], 0.05), 0, 1)
            along = np.array([cx, cy]) - points[:, :2]
            nearest = np.einsum("ij,ij->i", axis - points[:, :2], along) / np.maximum(
                np.einsum("ij,ij->i", along, along), 1e-9
            )
            nearest = np.clip(nearest, 0, climb)
            gap = np.linalg.norm(points[:, :2] + nearest[:, None] * along - axis, axis=1)
            # One pixel's rays see different points: a margin of a hand's width covers their spread.
            found |= (climb > 0) & (gap < radius + climb * np.hypot(hx, hy) + 0.08)
    return found


def _mirror_solid(solid: Mesh) -> Mesh:
    return Mesh(solid.name, solid.vertices_m * [1, 1, -1], solid.faces, solid.texture, solid.world_from_solid)
