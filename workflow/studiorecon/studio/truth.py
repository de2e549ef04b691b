# SPDX-License-Identifier: Apache-2.0
"""Exact truth of one camera, by one ray through every pixel's centre of the ideal pinhole: depth, masks, motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.video import write_lossless
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_npz
from studiorecon.studio.description import TruthOptions
from studiorecon.studio.film import centre_m, project
from studiorecon.studio.meshes import Mesh
from studiorecon.studio.rig import ray_directions
from studiorecon.studio.tracing import Tracer

if TYPE_CHECKING:
    from jaxtyping import Bool


class TruthFrames:
    """Collects the truth of one camera frame by frame.

    Attributes:
        room_depth_m: float32 z-depth of the empty room.
        masks: uint8: 0 room, k + 1 person k, 255 props.
        depths: uint16 millimetres, when configured.
        flows: float16 motion to the next frame in pixels, NaN behind the camera, when configured.
    """

    def __init__(self, lens: Lens, solids: list[Mesh], options: TruthOptions) -> None:
        self.lens = replace(lens, distortion=np.zeros_like(lens.distortion))
        self.options = options
        self.first_moving = len(solids)
        self._rays = ray_directions(self.lens, 1)[0]
        self._shape = (lens.wh[1], lens.wh[0])
        self.room_depth_m = Tracer(solids).cast(centre_m(lens), self._rays).distance.reshape(self._shape)
        self.masks: list[np.ndarray] = []
        self.depths: list[np.ndarray] = []
        self.flows: list[np.ndarray] = []

    def add(
        self,
        tracer: Tracer,
        moving: list[Mesh],
        touched: Bool[np.ndarray, " N"],
        values: list[int],
        following: list[Mesh] | None,
    ) -> None:
        """Trace one frame at the pixels ``touched``; ``following`` are the ``moving`` solids one frame later."""
        touched = np.flatnonzero(touched)
        hits = tracer.cast(centre_m(self.lens), self._rays[touched])
        seen = hits.solid >= self.first_moving
        covered, hits = touched[seen], hits.take(seen)
        which = hits.solid - self.first_moving
        mask = np.zeros(self._shape, dtype=np.uint8)
        mask.ravel()[covered] = np.asarray([*values, 0], dtype=np.uint8)[which]
        self.masks.append(mask)
        if self.options.depth_frames:
            depth = self.room_depth_m.ravel().astype(np.float64)
            depth[covered] = hits.distance
            self.depths.append(np.rint(depth * 1000).astype(np.uint16).reshape(self._shape))
        if self.options.flow and following is not None:
            flow = np.zeros((mask.size, 2))
            weights = np.column_stack([1 - hits.barycentric.sum(axis=1), hits.barycentric])
            for index, (now, then) in enumerate(zip(moving, following)):
                here = which == index
                corners = now.faces[hits.face[here]]
                before, after = (np.einsum("nk,nkx->nx", weights[here], s.vertices_m[corners]) for s in (now, then))
                flow[covered[here]] = project(self.lens, after)[0] - project(self.lens, before)[0]
            self.flows.append(flow.reshape(*self._shape, 2).astype(np.float16))

    def write(self, folder: Path, fps: float) -> None:
        """Write ``masks/``, and ``depth_frames/`` and ``flow/`` when configured."""
        name = self.lens.name
        write_lossless(folder / "masks" / f"{name}.mkv", self.masks, fps)
        if self.depths:
            write_lossless(folder / "depth_frames" / f"{name}.mkv", self.depths, fps)
        if self.flows:
            write_npz(folder / "flow" / f"{name}.npz", {"flow": np.stack(self.flows)})
