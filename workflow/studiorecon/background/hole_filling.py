# SPDX-License-Identifier: Apache-2.0
"""Closing the room: discs on the parts of its floor, walls and ceiling that no training camera sees.

Six per cent of black pixels cost more decibels than anything else in a background, so what nobody saw is painted from
what lies beside it on the same wall, and marked invented.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy

from studiorecon.scene.camera import Camera
from studiorecon.scene.room import FACES, RoomBox

# A face point counts as seen when the depth map agrees within this share of the distance plus this many metres.
_AGREE_SHARE, _AGREE_M = 0.03, 0.03
# Beside something this much nearer (share, metres) the plate's colours are mixed; such pixels do not paint walls.
_NEARER_SHARE, _NEARER_M = 0.9, 0.05
_INPAINT_RADIUS_NODES = 5.0
_BLUR_UNSEEN_NODES = 8.0


@dataclass(frozen=True)
class Face:
    """A rectangle of the room's shell.

    Attributes:
        name: "floor", "ceiling" or a wall's.
        corner_m: (3,) one corner; ``along_u``, ``along_v``: (3,) the two edges from it, metres.
    """

    name: str
    corner_m: np.ndarray
    along_u: np.ndarray
    along_v: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        n = np.cross(self.along_u, self.along_v)
        return n / np.linalg.norm(n)

    def nodes(self, step_m: float) -> np.ndarray:
        """(R, C, 3) points in the middle of cells of about ``step_m``, rows along v."""
        columns = max(1, round(float(np.linalg.norm(self.along_u)) / step_m))
        rows = max(1, round(float(np.linalg.norm(self.along_v)) / step_m))
        u, v = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        return self.corner_m + u[None, :, None] * self.along_u + v[:, None, None] * self.along_v


def faces_of(shell: RoomBox) -> list[Face]:
    """The six rectangles of a room, in the order of ``scene.room.FACES``."""
    low, high, size = shell.low_m, shell.high_m, shell.high_m - shell.low_m
    edges = shell.axes * size[:, None]
    faces = []
    for index, name in enumerate(FACES):
        axis, far = divmod(index, 2)
        corner = low.copy()
        corner[axis] = high[axis] if far else low[axis]
        u, v = [edges[k] for k in range(3) if k != axis]
        faces.append(Face(name, corner @ shell.axes, u, v))
    return faces


def node_step(faces: Sequence[Face], step_m: float, limit: int) -> float:
    """``step_m``, or the coarser step with which all faces together have about ``limit`` nodes: default walls may stand
    far away."""
    area = sum(float(np.linalg.norm(np.cross(f.along_u, f.along_v))) for f in faces)
    return max(step_m, float(np.sqrt(area / limit)))


@dataclass(frozen=True)
class Painted:
    """An atlas of one face.

    Attributes:
        face: the rectangle.
        points_m: (R, C, 3) nodes.
        rgb: (R, C, 3) float64: averaged over the cameras where ``seen``, painted elsewhere.
        seen: (R, C) bool.
    """

    face: Face
    points_m: np.ndarray
    rgb: np.ndarray
    seen: np.ndarray


def paint(
    faces: Sequence[Face],
    cameras: Sequence[Camera],
    plates: Sequence[np.ndarray],
    known: Sequence[np.ndarray],
    depths_m: Sequence[np.ndarray],
    step_m: float,
) -> list[Painted]:
    """The atlas of every face: photographed where a camera sees it, inpainted beside that, borrowed where nothing of it
    was seen.

    ``plates`` (H, W, 3) float, ``known`` (H, W) bool where a plate is measured, ``depths_m`` (H, W), 0 unknown.
    """
    looked = [(face, face.nodes(step_m)) for face in faces]
    gathered = [_gather(face, nodes, cameras, plates, known, depths_m) for face, nodes in looked]
    all_points = np.concatenate([nodes[seen] for (_, nodes), (_, seen) in zip(looked, gathered)])
    all_rgb = np.concatenate([rgb[seen] for rgb, seen in gathered])
    painted = []
    for (face, nodes), (rgb, seen) in zip(looked, gathered):
        if seen.any():
            # Telea's method works on bytes; what it paints is soft anyway.
            stamp = np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
            filled = cv2.inpaint(stamp, (~seen).astype(np.uint8), _INPAINT_RADIUS_NODES, cv2.INPAINT_TELEA) / 255
            rgb = np.where(seen[..., None], rgb, filled)
        elif len(all_points):
            nearest = scipy.spatial.cKDTree(all_points).query(nodes.reshape(-1, 3))[1]
            rgb = cv2.GaussianBlur(
                all_rgb[nearest].reshape(nodes.shape), (0, 0), _BLUR_UNSEEN_NODES, borderType=cv2.BORDER_REPLICATE
            )
        else:
            rgb = np.full(nodes.shape, 0.5)
        painted.append(Painted(face, nodes, rgb, seen))
    return painted


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
