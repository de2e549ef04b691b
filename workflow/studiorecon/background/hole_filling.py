# SPDX-License-Identifier: Apache-2.0
"""Completes the room: floor, walls and ceiling where no training camera sees them.

Six per cent of black pixels cost more decibels than anything else in a background. So the unseen part of a wall
continues its seen part and is marked invented. The painted room gives discs for unseen surfaces, and colours for unseen
pixels of synthesized views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.images.texture_fill import Scale, fill_by_texture
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import Face

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# A face point counts as seen when the depth map agrees within this share of the distance plus this many metres.
_AGREE_SHARE, _AGREE_M = 0.03, 0.03
# Next to an object this much nearer (share, metres) the plate's colours are mixed; such pixels do not paint walls.
_NEARER_SHARE, _NEARER_M = 0.9, 0.05
# With a smaller seen share a wall counts as unseen: a strip at its edge does not determine the rest.
_MIN_SEEN = 0.02
# Width over which light is even, size of a copied patch, and least shift between repeats of a pattern.
_LIGHT_M, _PATCH_M, _SHIFT_M = 0.35, 0.27, 0.12
# Unseen faces are painted on a grid coarser by this factor, and blurred by this many nodes: they have no detail.
_COARSE, _BLUR_NODES = 2, 4.0
# At this distance from its seen part a wall fades to the walls' mean colour at that height: copied further, one object
# in front of the wall would repeat along all of it. Sigma of heights.
_COPIED_M, _HEIGHT_M = 2.0, 0.3


def node_step(faces: Sequence[Face], step_m: float, limit: int) -> float:
    """``step_m``, or a coarser step with which all faces have about ``limit`` nodes: default walls may be far away."""
    area = sum(float(np.linalg.norm(np.cross(f.along_u, f.along_v))) for f in faces)
    return max(step_m, float(np.sqrt(area / limit)))


@dataclass(frozen=True)
class PaintedFace:
    """An atlas of one face: nodes, and float64 colours averaged over the cameras where ``seen``, otherwise painted."""

    face: Face
    points_m: Float[np.ndarray, "R C 3"]
    rgb: Float[np.ndarray, "R C 3"]
    seen: Bool[np.ndarray, "R C"]

    @property
    def step_m(self) -> float:
        """Distance between nodes, along the edge where it is longer."""
        rows, columns = self.seen.shape
        return max(
            float(np.linalg.norm(edge)) / count
            for edge, count in ((self.face.along_u, columns), (self.face.along_v, rows))
        )


def paint(
    faces: Sequence[Face],
    cameras: Sequence[Camera],
    plates: Sequence[Float[np.ndarray, "H W 3"]],
    known: Sequence[Bool[np.ndarray, "H W"]],
    depths_m: Sequence[Float[np.ndarray, "H W"]],
    step_m: float,
) -> list[PaintedFace]:
    """The atlas of every face: photographed where a camera sees it, continued next to that, otherwise borrowed.

    A wall without seen parts borrows from other walls, at the same height. ``known``: where a plate is measured.
    """
    looked = [(face, face.nodes(step_m)) for face in faces]
    gathered = [_gather(face, nodes, cameras, plates, known, depths_m) for face, nodes in looked]
    all_points = np.concatenate([nodes[seen] for (_, nodes), (_, seen) in zip(looked, gathered)])
    all_rgb = np.concatenate([rgb[seen] for rgb, seen in gathered])
    nearest = scipy.spatial.cKDTree(all_points) if len(all_points) else None
    walls = _Walls.of(looked, gathered)
    patch = 2 * round(_PATCH_M / step_m / 2) + 1
    scale = Scale(_LIGHT_M / step_m, max(patch, 3), max(round(_SHIFT_M / step_m), 2))
    painted = []
    for (face, nodes), (rgb, seen) in zip(looked, gathered):
        if seen.mean() >= _MIN_SEEN:
            rgb = fill_by_texture(rgb, seen, scale, np.random.default_rng(0))
            if walls is not None and _upright(face):
                # OpenCV's exact distances differ in the last bit from run to run.
                apart_m = step_m * scipy.ndimage.distance_transform_edt(~seen)
                copied = np.exp(-((apart_m / _COPIED_M) ** 2))[..., None]
                rgb = copied * rgb + (1 - copied) * walls.at(nodes)
            painted.append(PaintedFace(face, nodes, rgb, seen))
            continue
        nodes = face.nodes(step_m * _COARSE)
        if walls is not None and _upright(face):
            rgb = walls.at(nodes)
        elif nearest is None:
            rgb = np.full(nodes.shape, 0.5)
        else:
            borrowed = all_rgb[nearest.query(nodes.reshape(-1, 3))[1]].reshape(nodes.shape)
            rgb = cv2.GaussianBlur(borrowed, (0, 0), _BLUR_NODES, borderType=cv2.BORDER_REPLICATE)
        painted.append(PaintedFace(face, nodes, rgb, np.zeros(nodes.shape[:2], bool)))
    return painted


@dataclass(frozen=True)
class _Walls:
    """The walls' mean colours (B, 3) at heights ``heights_m`` (B,)."""

    heights_m: np.ndarray
    rgb: np.ndarray

    @classmethod
    def of(
        cls, looked: Sequence[tuple[Face, np.ndarray]], gathered: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> _Walls | None:
        """The mean colours of the seen nodes of all walls; None where none is seen."""
        upright = [(nodes[seen], rgb[seen]) for (f, nodes), (rgb, seen) in zip(looked, gathered) if _upright(f)]
        height_m = np.concatenate([points[:, 2] for points, _ in upright]) if upright else np.zeros(0)
        if not len(height_m):
            return None
        colours = np.concatenate([rgb for _, rgb in upright])
        heights_m = np.arange(height_m.min(), height_m.max() + _HEIGHT_M, _HEIGHT_M / 2)
        bins = np.rint((height_m - heights_m[0]) / (_HEIGHT_M / 2)).astype(int)
        counts = np.bincount(bins, minlength=len(heights_m))
        sums = np.stack([np.bincount(bins, colours[:, k], len(heights_m)) for k in range(3)], axis=1)
        near = np.exp(-0.5 * ((heights_m[:, None] - heights_m) / _HEIGHT_M) ** 2)
        return cls(heights_m, (near @ sums) / (near @ counts)[:, None])

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """(..., 3) colours of points (..., 3)."""
        return np.stack([np.interp(nodes[..., 2], self.heights_m, self.rgb[:, k]) for k in range(3)], axis=-1)


def _upright(face: Face) -> bool:
    return bool(abs(face.normal[2]) < 0.5)


def draw_faces(camera: Camera, painted: Sequence[PaintedFace]) -> Float[np.ndarray, "H W 3"]:
    """The painted, empty room from a camera; black where no face is in view."""
    rays = camera.unproject(camera.pixel_centres(), np.ones(camera.hw)) - camera.centre_m
    nearest, rgb = np.full(camera.hw, np.inf), np.zeros((*camera.hw, 3))
    for own in painted:
        face, shape = own.face, own.seen.shape
        with np.errstate(divide="ignore", invalid="ignore"):
            far = ((face.corner_m - camera.centre_m) @ face.normal) / (rays @ face.normal)
            cells = face.cells(camera.centre_m + rays * far[..., None], shape)
            on_face = np.all(np.abs(cells - (np.array(shape) - 1) / 2) <= np.array(shape) / 2, axis=-1)
        there = on_face & (far > 0) & (far < nearest)
        rows, columns = np.where(there, np.moveaxis(cells, -1, 0), 0).astype(np.float32)
        colours = cv2.remap(own.rgb, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        nearest, rgb = np.where(there, far, nearest), np.where(there[..., None], colours, rgb)
    return rgb


def _gather(
    face: Face,
    nodes: np.ndarray,
    cameras: Sequence[Camera],
    plates: Sequence[np.ndarray],
    known: Sequence[np.ndarray],
    depths_m: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Mean colour (R, C, 3) and ``seen`` (R, C) of a face's nodes; near frontal views weigh most."""
    sums, weights = np.zeros(nodes.shape), np.zeros(nodes.shape[:2])
    for camera, plate, measured, depth_m in zip(cameras, plates, known, depths_m):
        pixels, z = camera.project(nodes)
        inside = np.all((pixels > 1) & (pixels < np.array(camera.wh) - 1), axis=-1)
        # cv2 counts centres as integers
        columns, rows = (np.where(inside, pixels[..., k] - 0.5, -1).astype(np.float32) for k in (0, 1))
        there = cv2.remap(np.where(measured, depth_m, 0).astype(np.float32), columns, rows, cv2.INTER_NEAREST)
        floor_of = cv2.erode(depth_m.astype(np.float32), np.ones((3, 3), np.uint8))
        beside = cv2.remap(floor_of, columns, rows, cv2.INTER_NEAREST)
        agrees = (
            inside & (np.abs(there - z) < _AGREE_SHARE * z + _AGREE_M) & (beside > there * _NEARER_SHARE - _NEARER_M)
        )
        colours = cv2.remap(plate.astype(np.float32), columns, rows, cv2.INTER_LINEAR)
        frontal = np.abs((nodes - camera.centre_m) @ face.normal)
        weight = np.where(agrees, frontal / np.maximum(z, 0.1) ** 3, 0)
        sums += colours * weight[..., None]
        weights += weight
    seen = weights > 0
    return sums / np.maximum(weights, 1e-300)[..., None], seen
