# SPDX-License-Identifier: Apache-2.0
"""Floor, walls and ceiling of the mesh: the fitted room's own rectangles, with colours from the viewpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.deliver.fusion import FusedView
from studiorecon.scene.provenance import INVENTED, MEASURED
from studiorecon.scene.room import FACES, RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# A point of a plane is visible where the rendered depth agrees with its own within this share and these metres.
_AGREE_SHARE, _AGREE_M = 0.02, 0.02


@dataclass(frozen=True)
class Plane:
    """One rectangle of the room as a grid.

    Attributes:
        name: as in ``scene.room.FACES``.
        vertices_m: corners included.
        triangles: counter-clockwise from inside the room.
        rgb: in [0, 1] as displayed.
        provenance: ``MEASURED`` where a viewpoint sees it, else ``INVENTED``, with the nearest visible colour.
    """

    name: str
    vertices_m: Float[np.ndarray, "V 3"]
    triangles: Integer[np.ndarray, "F 3"]
    rgb: Float[np.ndarray, "V 3"]
    provenance: Integer[np.ndarray, " V"]


def mesh_faces(room_box: RoomBox) -> list[int]:
    """Indices of the faces in the mesh: the floor, and faces fitted to the photos; default walls are arbitrary."""
    return [index for index, name in enumerate(FACES) if name == "floor" or room_box.fitted[index]]


def distance_m(room_box: RoomBox, points_m: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    """Distance from points to the nearest face of the mesh; 0 for points beyond one."""
    apart = np.full(len(points_m), np.inf)
    for index in mesh_faces(room_box):
        normal, offset = room_box.faces[index, :3], room_box.faces[index, 3]
        inward = (points_m @ normal - offset) * (-1 if index % 2 else 1)
        apart = np.minimum(apart, np.maximum(inward, 0))
    return apart


def build_planes(room_box: RoomBox, views: Sequence[FusedView], step_m: float, vertices: int) -> list[Plane]:
    """The faces of the mesh as grids of about ``step_m``, coarser where all would have more than ``vertices``."""
    size = room_box.high_m - room_box.low_m
    area = sum(np.prod(np.delete(size, index // 2)) for index in mesh_faces(room_box))
    step_m = max(step_m, float(np.sqrt(area / vertices)))
    made = [_grid(room_box, index, step_m) for index in mesh_faces(room_box)]
    coloured = [_colours(points, views) for points, _ in made]
    found_m = np.concatenate([points[seen] for (points, _), (_, seen) in zip(made, coloured)])
    found_rgb = np.concatenate([rgb[seen] for rgb, seen in coloured])
    result = []
    for index, (points, triangles), (rgb, seen) in zip(mesh_faces(room_box), made, coloured):
        if len(found_m) and not seen.all():
            _, near = scipy.spatial.cKDTree(found_m).query(points[~seen], k=min(8, len(found_m)))
            rgb[~seen] = found_rgb[np.asarray(near).reshape(np.count_nonzero(~seen), -1)].mean(axis=1)
        result.append(Plane(FACES[index], points, triangles, rgb, np.where(seen, MEASURED, INVENTED).astype(np.uint8)))
    return result


def _grid(room_box: RoomBox, index: int, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    axis, far = divmod(index, 2)
    first, second = ((axis + 1) % 3, (axis + 2) % 3)
    counts = [max(1, round(float((room_box.high_m - room_box.low_m)[k]) / step_m)) for k in (first, second)]
    a, b = np.meshgrid(
        *(np.linspace(room_box.low_m[k], room_box.high_m[k], n + 1) for k, n in zip((first, second), counts)),
        indexing="ij",
    )
    local = np.empty((a.size, 3))
    local[:, axis], local[:, first], local[:, second] = (
        (room_box.high_m if far else room_box.low_m)[axis],
        a.ravel(),
        b.ravel(),
    )
    corner = np.arange(a.size).reshape(a.shape)
    p, q, r, s = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    # first × second is the axis itself: counter-clockwise from its positive side, which is inside for the low faces.
    triangles = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    return local @ room_box.axes, triangles[:, ::-1] if far else triangles


def _colours(points_m: np.ndarray, views: Sequence[FusedView]) -> tuple[np.ndarray, np.ndarray]:
    """Mean colour (V, 3) over the views that see a point, near views first, and whether any does (V,)."""
    sums, weights = np.zeros(points_m.shape), np.zeros(len(points_m))
    for view in views:
        pixels, z = view.camera.project(points_m)
        inside = np.all((pixels > 0.5) & (pixels < np.array(view.camera.wh) - 0.5), axis=-1)
        # cv2 counts centres as integers
        columns, rows = (np.where(inside, pixels[:, k] - 0.5, -1).astype(np.float32)[None] for k in (0, 1))
        there = cv2.remap(view.depth_m, columns, rows, cv2.INTER_NEAREST)[0]
        agrees = inside & (there > 0) & (np.abs(there - z) < _AGREE_SHARE * z + _AGREE_M)
        weight = np.where(agrees, 1 / np.where(agrees, z, 1) ** 2, 0)
        sums += cv2.remap(view.rgb, columns, rows, cv2.INTER_LINEAR)[0] * weight[:, None]
        weights += weight
    return sums / np.maximum(weights, 1e-300)[:, None], weights > 0
