# SPDX-License-Identifier: Apache-2.0
"""The contents of the room as one coloured surface, from depth of many viewpoints in a signed distance field (open3d).

Curless and Levoy (SIGGRAPH 1996): every depth map moves the voxels near its surface; the surface is where their mean is
zero, so noise of single maps averages out and parts that no map shows stay open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numba
import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import INVENTED
from studiorecon.splatting.device import DRAWN_FROM_M, rasteriser

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

OPAQUE = 0.9
"""Smallest alpha of a pixel whose depth counts: below it the blended depth is between surfaces."""
_EDGE = 0.04
# Half the thickness, in voxels, of the band around a surface in which a depth map moves voxels.
_BAND_VOXELS = 4.0
# Voxels are stored in cubes of this side, initially as many as a hall's surfaces take; space for more is allocated when
# needed.
_BLOCK, _BLOCKS = 16, 20_000
_MIN_VIEWS = 1.5
_ACROSS_CLUSTER_M = 0.15


@dataclass(frozen=True)
class FusedView:
    """The room from one viewpoint: float32 colours, and depth, 0 where not opaque, invented, or at a depth edge."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    depth_m: Float[np.ndarray, "H W"]


@dataclass(frozen=True)
class FusedSurface:
    """A mesh in the world with one displayed colour in [0, 1] per vertex."""

    vertices_m: Float[np.ndarray, "V 3"]
    triangles: Integer[np.ndarray, "F 3"]
    rgb: Float[np.ndarray, "V 3"]


def render_views(
    background: Gaussians, provenance: Integer[np.ndarray, " N"], cameras: Sequence[Camera]
) -> list[FusedView]:
    """The views of the room's Gaussians from every camera; ``provenance`` is that of each Gaussian."""
    draw = rasteriser("cpu", near_m=DRAWN_FROM_M)
    invented = (provenance == INVENTED).astype(np.float32)[:, None]
    seen = []
    for camera in cameras:
        made = draw.forward(background, camera, values=invented)
        assert made.values is not None
        depth_m = made.depth_m.copy()
        around = np.ones((3, 3), np.uint8)
        edge = cv2.dilate(depth_m, around) - cv2.erode(depth_m, around) > _EDGE * depth_m
        depth_m[(made.alpha < OPAQUE) | (made.values[..., 0] > made.alpha / 2) | edge] = 0
        seen.append(FusedView(camera, np.clip(made.rgb, 0, 1), depth_m))
    return seen


def open3d() -> Any:
    """The library, imported late because it takes seconds; raises UserError with a remedy when it cannot be loaded."""
    # numba's threads must start first: the TBB of open3d is too old for numba, which would warn at its next kernel.
    numba.get_num_threads()
    try:
        import open3d as o3d
    except (ImportError, OSError) as error:
        raise UserError(
            f"deliver/room.glb is made by open3d, which cannot be loaded ({error}); install the extra mesh (uv run "
            "--extra mesh, or pip install 'studiorecon[mesh]'); a server without a desktop also needs apt-get "
            "install libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1; the other files do not need it"
        ) from None
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    return o3d


def fuse(views: Sequence[FusedView], voxel_m: float) -> FusedSurface:
    """The zero level of the signed distance field of all views; empty when they show nothing."""
    o3d = open3d()
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight", "color"),
        attr_dtypes=(core.float32,) * 3,
        attr_channels=((1), (1), (3)),
        voxel_size=voxel_m,
        block_resolution=_BLOCK,
        block_count=_BLOCKS,
        device=core.Device("CPU:0"),
    )
    for view in views:
        farthest = float(view.depth_m.max()) + voxel_m
        # In open3d the first pixel's centre is at 0.
        lens = core.Tensor(view.camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        pose = core.Tensor(np.ascontiguousarray(view.camera.camera_from_world))
        depth, colour = (
            o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(a, np.float32)))
            for a in (view.depth_m[..., None], view.rgb)
        )
        reach = {"depth_scale": 1.0, "depth_max": farthest, "trunc_voxel_multiplier": _BAND_VOXELS}
        if (view.depth_m > 0).any():
            blocks = grid.compute_unique_block_coordinates(depth, lens, pose, **reach)
            grid.integrate(blocks, depth, colour, lens, lens, pose, **reach)
    return _arrays(grid.extract_triangle_mesh(weight_threshold=_MIN_VIEWS).to_legacy())


def remove_vertices(surface: FusedSurface, dropped: Bool[np.ndarray, " V"]) -> FusedSurface:
    """The surface without triangles whose vertices are all ``dropped``, and pieces below 15 cm, in a fixed order."""
    triangles = surface.triangles[~dropped[surface.triangles].all(axis=1)]
    triangles = triangles[_large(surface.vertices_m, triangles)]
    used, back = np.unique(triangles, return_inverse=True)
    # open3d's volume is a hash map without a stable order: sorting makes the same scene give the same bytes.
    order = np.lexsort(surface.vertices_m[used].T)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    triangles = rank[back.reshape(-1, 3)]
    first = triangles.argmin(axis=1)
    triangles = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    triangles = triangles[np.lexsort(triangles.T[::-1])]
    return FusedSurface(surface.vertices_m[used][order], triangles, surface.rgb[used][order])


def decimate(surface: FusedSurface, triangles: int) -> FusedSurface:
    """The surface with at most ``triangles``, by quadric error (Garland and Heckbert 1997), flat parts first."""
    if len(surface.triangles) <= triangles:
        return surface
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(surface.vertices_m), o3d.utility.Vector3iVector(surface.triangles.astype(np.int32))
    )
    mesh.vertex_colors = o3d.utility.Vector3dVector(surface.rgb)
    say(f"the surface is simplified from {len(surface.triangles)} to {triangles} triangles")
    return _arrays(mesh.simplify_quadric_decimation(triangles))


def _arrays(mesh: Any) -> FusedSurface:
    return FusedSurface(
        np.asarray(mesh.vertices).copy(),
        np.asarray(mesh.triangles).astype(np.int64),
        np.asarray(mesh.vertex_colors).copy(),
    )


def _large(vertices_m: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(F,) bool: whether a triangle's connected piece is at least ``_ACROSS_CLUSTER_M`` across."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(triangles):
        return np.zeros(0, bool)
    rows, columns = triangles[:, [0, 1]].reshape(-1), triangles[:, [1, 2]].reshape(-1)
    graph = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(len(vertices_m), len(vertices_m)))
    count, piece = connected_components(graph, directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, vertices_m)
    np.maximum.at(high, piece, vertices_m)
    return (np.linalg.norm(high - low, axis=1) >= _ACROSS_CLUSTER_M)[piece[triangles[:, 0]]]
