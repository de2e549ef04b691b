# SPDX-License-Identifier: Apache-2.0
"""The CPU back end's interface: renders Gaussians from a camera, and their gradients; ``device`` chooses the back end.

Conventions are gsplat's: dilation 0.3 px², pixel centres at +0.5, alpha below 1/255 skipped and cut at 0.999, blending
stops when the transmittance would fall to 1e-4, colour max(0, 0.5 + harmonics).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import (
    BLOCK_FLOATS,
    LANES,
    MEAN,
    MORE,
    PAIRS_MAX,
    QUATERNION,
    RECORD,
    RED,
    SCALE,
    TILE_PX,
)
from studiorecon.splatting.cpu import blocks, tiles
from studiorecon.splatting.cpu.blocks import BlockedGaussians, aligned_zeros
from studiorecon.splatting.cpu.camera_vector import camera_vector
from studiorecon.splatting.cpu.channels import copy_planes, split_into_threes, write_record_fields
from studiorecon.splatting.cpu.forward import LANE_OFFSETS, blend, blend_more
from studiorecon.splatting.cpu.planes import gradients_into_planes, planes_to_images
from studiorecon.splatting.cpu.projection import project
from studiorecon.splatting.rendering import (
    Drawable,
    GaussianGradients,
    Rendering,
    check_values,
    facing_normals,
    split_channels,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Num

__all__ = ["GaussianGradients", "Rasteriser", "Rendering"]


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Run numba with ``count`` threads inside the block, or with all it has when it has fewer."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]  # set by numba at import
    try:
        yield
    finally:
        numba.set_num_threads(before)


class Rasteriser:
    """Forward and backward passes that reuse their buffers; one instance serves one Python thread.

    The same inputs give the same bytes for the same ``threads``, whatever the machine's number of cores.

    Attributes:
        near_m: Gaussians at or before this depth are not drawn.
        threads: shares of the work.
        antialias: whether opacities are compensated for the dilation of small splats (``projection``).
        refused: Gaussians of the last view left out for NaN, infinite or absurd values (1e7 metres or pixels).
        visible_count, pair_count: Gaussians of the last view that can touch a pixel, and its splat–tile pairs.
    """

    planes: Float[np.ndarray, "5 H W"]
    _grid: tuple[int, int]
    _cursor: np.ndarray
    _starts: np.ndarray
    _ends: np.ndarray
    _moments: np.ndarray

    def __init__(self, *, near_m: float, threads: int | None = None, antialias: bool = False) -> None:
        self.near_m, self.antialias = float(near_m), bool(antialias)
        self.threads = numba.get_num_threads() if threads is None else int(threads)
        if self.threads < 1 or not self.near_m > 0:
            raise ValueError(f"threads ({threads}) must be at least 1 and near_m ({near_m}) above 0")
        self.refused = self.visible_count = self.pair_count = 0
        self._blocked: BlockedGaussians | None = None
        self._own_blocks = np.zeros(0, np.float32)
        self._sized_for = (0, (0, 0))
        self._pairs, self._touched = np.zeros(0, np.uint32), np.zeros(0, np.uint16)
        self._ticket = np.zeros(1, np.int64)

    def own_threads(self) -> AbstractContextManager[None]:
        """A context in which numba uses this rasteriser's threads only."""
        return _threads(self.threads)

    def forward(
        self,
        gaussians: Drawable,
        camera: Camera,
        background_rgb: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        normals: bool = False,
        values: Num[np.ndarray, "N C"] | None = None,
    ) -> Rendering:
        """One view as fresh arrays; Gaussians are first put into blocks in their order, blocks are drawn directly.

        ``values`` of the Gaussians are blended like colours, over 0; ``normals`` adds normals. The first three channels
        of these cost 14 to 25 % of a pass, every three more 70 to 80 %. Raises ValueError for another number of values.
        """
        wanted = [] if values is None else [check_values(values, gaussians.count)]
        with self.own_threads():
            blocked = gaussians if isinstance(gaussians, BlockedGaussians) else blocks.block(gaussians)
            if normals:
                rows = blocked.parameters.reshape(-1, BLOCK_FLOATS // LANES, LANES)
                means, quaternions, scales = (
                    rows[:, first : first + size].transpose(0, 2, 1).reshape(-1, size)[: blocked.count]
                    for first, size in ((MEAN, 3), (QUATERNION, 4), (SCALE, 3))
                )
                wanted.append(facing_normals(means, quaternions, scales, camera.centre_m))
            blended = self._draw_with(
                np.hstack(wanted) if wanted else np.zeros((blocked.count, 0)), blocked, camera, background_rgb
            )
            height, width = self.planes.shape[1:]
            rgb, alpha, depth_m = (
                np.empty(shape, np.float32) for shape in ((height, width, 3), (height, width), (height, width))
            )
            planes_to_images(self.planes, rgb, alpha, depth_m)
        return Rendering(
            rgb,
            alpha,
            depth_m,
            *split_channels(blended, 0 if values is None else values.shape[1], normals),
        )

    def _draw_with(
        self,
        values: np.ndarray,
        blocked: BlockedGaussians,
        camera: Camera,
        background_rgb: Sequence[float],
    ) -> np.ndarray:
        """The result of ``draw``, and values (N, C) blended like colours, (H, W, C) float32."""
        threes = split_into_threes(values)
        self.draw(blocked, camera, background_rgb, threes[0] if threes else None)
        image = np.empty((*self.planes.shape[1:], values.shape[1]), np.float32)
        if threes:
            copy_planes(self._more, 0, image)
        if len(threes) > 1:
            splats, planes = self._splats.copy(), np.empty_like(self.planes)
            lists = (self._starts, self._pairs, self._touched, self._ends)
            for index, three in enumerate(threes[1:], start=1):
                write_record_fields(three, self.visible, RED, splats)
                blend(
                    self.threads,
                    *self._grid,
                    splats,
                    *lists,
                    np.zeros(3, np.float32),
                    LANE_OFFSETS,
                    planes,
                    self._ticket,
                )
                copy_planes(planes, 3 * index, image)
        return image

    def backward(
        self,
        grad_rgb: Num[np.ndarray, "H W 3"] | None,
        grad_alpha: Num[np.ndarray, "H W"] | None = None,
        grad_depth: Num[np.ndarray, "H W"] | None = None,
    ) -> GaussianGradients:
        """Gradients of a scalar by the Gaussians of the last ``forward``, from its gradients by rgb, alpha and depth.

        Blocks must not change in between. Pixels whose alpha is below 1e-4 pass no depth gradient. Raises ValueError
        before a ``forward`` and for gradients of another size.
        """
        if self._blocked is None:
            raise ValueError("backward needs a forward pass first")
        hw = self.planes.shape[1:]
        given = [
            np.zeros(0, np.float32) if g is None else np.ascontiguousarray(g, np.float32)
            for g in (grad_rgb, grad_alpha, grad_depth)
        ]
        for name, gradient, shape in zip(("rgb", "alpha", "depth"), given, ((*hw, 3), hw, hw)):
            if gradient.size and gradient.shape != shape:
                raise ValueError(f"grad_{name} has shape {gradient.shape}, expected {shape}")
        with self.own_threads():
            plane_gradients = np.empty_like(self.planes)
            behind = np.zeros((hw[0], 3), np.float32)
            gradients_into_planes(self.planes, *(g.reshape(-1) for g in given), plane_gradients, behind)
            gradients = self.backward_planes(plane_gradients)
            gradients.background_rgb[:] = behind.sum(axis=0, dtype=np.float64)
        return gradients

    def forward_planes(
        self, gaussians: Gaussians, camera: Camera, background_rgb: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> Float[np.ndarray, "5 H W"]:
        """The planes of ``draw`` for Gaussians that change at every call, as posed ones do; overwritten by the next
        call.
        """
        self._own_blocks = blocks.block(gaussians, within=self._own_blocks).parameters
        blocked = BlockedGaussians(self._own_blocks, gaussians.count, gaussians.sh_degree)
        return self.draw(blocked, camera, background_rgb)

    def backward_planes(self, plane_gradients: Float[np.ndarray, "5 H W"]) -> GaussianGradients:
        """``backward`` of gradients as ``gather`` takes them; that by the background's colour stays 0."""
        blocked = self._blocked
        assert blocked is not None, "backward_planes needs a forward pass first"
        n, bands = blocked.count, (blocked.degree + 1) ** 2
        shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, bands, 3), (n,))
        gradients = GaussianGradients(*[*(np.empty(shape, np.float32) for shape in shapes), np.zeros(3, np.float32)])
        self.gather(plane_gradients)
        blocks.take_gradients(
            self.gradient,
            blocked.parameters,
            self.visible,
            self.screen,
            gradients.means_m,
            gradients.quaternions,
            gradients.log_scales,
            gradients.logit_opacities,
            gradients.sh,
            gradients.screen,
        )
        return gradients

    def draw(
        self,
        blocked: BlockedGaussians,
        camera: Camera,
        background_rgb: Sequence[float],
        three: Float[np.ndarray, "N 3"] | None = None,
    ) -> Float[np.ndarray, "5 H W"]:
        """Fill and return ``planes`` for training: red, green, blue, depth sum, transmittance.

        ``three`` are values blended in the same pass. Raises UserError when the lists of tiles cannot hold all splats.
        """
        self._resize(blocked.padded, camera.hw)
        columns, rows = self._grid
        self._blocked, self._camera = blocked, camera_vector(camera, self.near_m, self.antialias)
        splats, visible = self._splats, self.visible
        project(blocked.parameters, self._camera, blocked.degree, splats, self._depth_m, visible, self._refused)
        self.refused = int(self._refused.sum())
        count = tiles.depth_order(self._depth_m.view(np.uint32), visible, *self._sorting)
        self.visible_count = count
        order = self._sorting[0]
        self._cursor[:] = 0
        shared = (count, order, splats, columns, rows, self.threads, self._cursor, self._rectangles)
        tiles.scatter_into_tiles(*shared, self._pairs, False)
        self.pair_count = int(tiles.place_tiles(self._cursor, self.threads, self._starts))
        if self.pair_count > PAIRS_MAX:
            raise UserError(
                f"camera {camera.name}: {count} visible Gaussians cover "
                f"{self.pair_count} tiles, more than {PAIRS_MAX}; "
                "the Gaussians have grown out of bounds: lower their learning rates or their number"
            )
        if self.pair_count > len(self._pairs):
            room = int(1.2 * self.pair_count) + (1 << 14)
            self._pairs, self._touched = np.empty(room, np.uint32), np.empty(room, np.uint16)
        tiles.scatter_into_tiles(*shared, self._pairs, True)
        lists = (self._starts, self._pairs, self._touched, self._ends)
        tables = (
            self.threads,
            columns,
            rows,
            splats,
            *lists,
            np.array(background_rgb, np.float32),
            LANE_OFFSETS,
            self.planes,
        )
        if three is None:
            blend(*tables, self._ticket)
        else:
            write_record_fields(three, visible, MORE, splats)
            self._more = np.empty((3, *self.planes.shape[1:]), np.float32)
            blend_more(*tables, self._more, self._ticket)
        return self.planes

    def gather(self, plane_gradients: Float[np.ndarray, "5 H W"]) -> Float[np.ndarray, " P"]:
        """Fill and return ``gradient`` (blocks; by activated scale and opacity) from gradients of the planes.

        The planes are red, green, blue, depth sum, alpha. Blocks without a visible Gaussian are left unchanged;
        ``visible`` marks the others.
        """
        # Imported here so that rendering never loads or compiles the gradients.
        from studiorecon.splatting.cpu.backward import gather
        from studiorecon.splatting.cpu.projection_gradient import project_gradient

        blocked = self._blocked
        assert blocked is not None, "gather needs a draw first"
        padded = blocked.padded
        if len(self._moments) != self.threads * padded * RECORD:
            self._moments = aligned_zeros(self.threads * padded * RECORD)
            self.gradient, self.screen = aligned_zeros(padded // LANES * BLOCK_FLOATS), aligned_zeros(2 * padded)
        lists = (self._starts, self._pairs, self._touched, self._ends)
        gather(
            self.threads, *self._grid, self._splats, *lists, LANE_OFFSETS, self.planes, plane_gradients, self._moments
        )
        parameters, degree = blocked.parameters, blocked.degree
        project_gradient(
            parameters, self._camera, degree, self._splats, self.visible, self._moments, self.gradient, self.screen
        )
        return self.gradient

    def _resize(self, padded: int, hw: tuple[int, int]) -> None:
        before, hw_before = self._sized_for
        if padded != before:
            self._splats, self._depth_m = aligned_zeros(padded * RECORD), aligned_zeros(padded)
            self.visible, self._refused = np.zeros(padded, np.uint8), np.zeros(padded // LANES, np.uint8)
            self._sorting = tuple(np.zeros(padded, np.uint32) for _ in range(4))
            self._rectangles = np.zeros(4 * padded, np.int16)
            self._moments = np.zeros(0, np.float32)
        if hw != hw_before:
            self._grid = (-(-hw[1] // TILE_PX), -(-hw[0] // TILE_PX))
            count = self._grid[0] * self._grid[1]
            self._cursor, self._starts = np.zeros(self.threads * count, np.uint32), np.zeros(count + 1, np.uint32)
            self._ends = np.zeros(count, np.uint32)
            self.planes = aligned_zeros(5 * hw[0] * hw[1]).reshape(5, *hw)
        self._sized_for = (padded, hw)
