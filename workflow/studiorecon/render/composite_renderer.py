# SPDX-License-Identifier: Apache-2.0
"""Draws a composite picture by picture, and updates only the Gaussians that changed since the picture before.

The room is stored in blocks once; afterwards only moving Gaussians and the colours of newly shaded ones are replaced.
Classes of truth, mattes and normals are blended separately or with the lists of the same pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.render.composite import TRUTH_LEVELS, Composite, provenance_classes
from studiorecon.render.shading import dim_gaussians
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import BLOCK_FLOATS, LANES
from studiorecon.splatting.cpu.blocks import BlockedGaussians, aligned_zeros, fill_blocks, padded_count
from studiorecon.splatting.device import rasteriser
from studiorecon.splatting.rendering import Rendering

if TYPE_CHECKING:
    from jaxtyping import Float

_FLOATS_PER_GAUSSIAN = BLOCK_FLOATS // LANES


@dataclass(frozen=True)
class Layers:
    """One picture, split into layers.

    Attributes:
        rendering: premultiplied colours over nothing, alpha, expected depth and world normals.
        shares: share of every pixel that is measured, inferred, invented.
        mattes: share of every pixel that is the room, then each person and object; they add up to alpha.
    """

    rendering: Rendering
    shares: Float[np.ndarray, "H W 3"]
    mattes: Float[np.ndarray, "H W M"]


class CompositeRenderer:
    """Pictures of a composite; the same bytes as rasterising all its Gaussians together, in a fraction of the time."""

    def __init__(self, scene: Composite, near_m: float, device: str = "cpu") -> None:
        self._scene, self._rasteriser = scene, rasteriser(device, near_m=near_m)
        posed = [person.posed(0.0) for person in scene.moving]
        counts = [scene.background.count, *(gaussians.count for gaussians in posed)]
        self._starts = np.cumsum([0, *(padded_count(count) for count in counts)])
        parameters = aligned_zeros(int(self._starts[-1]) * _FLOATS_PER_GAUSSIAN)
        degree = max(gaussians.sh_degree for gaussians in (scene.background, *posed))
        self._blocked = BlockedGaussians(parameters, int(self._starts[-1]), degree)
        self._blocks = [
            parameters[first * _FLOATS_PER_GAUSSIAN : end * _FLOATS_PER_GAUSSIAN]
            for first, end in zip(self._starts, self._starts[1:])
        ]
        self._orders = [np.arange(count) for count in counts]
        # One column per class; unused entries at the end of each part have opacity 0 and stay 0.
        self._classes = np.zeros((int(self._starts[-1]), len(TRUTH_LEVELS)), np.float32)
        self._fill(0, scene.background)
        self._classify(0, scene.classes)
        self._frame = float("nan")
        self._classified: list[bytes] = [b""] * len(posed)
        self._shade = np.ones(0 if scene.shading is None else len(scene.shading.at), np.float32)

    def draw(
        self, camera: Camera, frame: float, background_rgb: Sequence[float]
    ) -> tuple[Rendering, Float[np.ndarray, "H W 3"]]:
        """The rendering at a (fractional) frame, and each class's share of every pixel."""
        self._enter(frame)
        rendering = self._rasteriser.forward(self._blocked, camera, background_rgb, values=self._classes)
        assert rendering.values is not None
        return rendering, rendering.values

    def layers(self, camera: Camera, frame: float) -> Layers:
        """The picture at a (fractional) frame, split into layers for compositing."""
        self._enter(frame)
        values = np.hstack([self._classes, self._membership()])
        drawn = self._rasteriser.forward(self._blocked, camera, normals=True, values=values)
        assert drawn.values is not None
        classes = self._classes.shape[1]
        return Layers(drawn, drawn.values[..., :classes], drawn.values[..., classes:])

    def _enter(self, frame: float) -> None:
        """Updates the blocks to a frame: all moving Gaussians, and those of the room whose shade has changed."""
        if frame == self._frame:
            return
        scene = self._scene
        if scene.shading is not None:
            shade = scene.shading.factor(frame)
            dim_gaussians(scene.background.sh, scene.shading.at, shade, self._shade, self._blocks[0])
            self._shade = shade
        for part, moving in enumerate(scene.moving, start=1):
            self._fill(part, moving.posed(frame))
            classes = provenance_classes(moving, frame)
            if self._classified[part - 1] != classes.tobytes():
                self._classify(part, classes)
                self._classified[part - 1] = classes.tobytes()
        self._frame = frame

    def _fill(self, part: int, gaussians: Gaussians) -> None:
        arrays = (gaussians.means_m, gaussians.quaternions, gaussians.log_scales, gaussians.logit_opacities)
        fill_blocks(*arrays, gaussians.sh, self._orders[part], self._blocks[part])

    def _classify(self, part: int, classes: np.ndarray) -> None:
        first = self._starts[part]
        self._classes[first : self._starts[part + 1]] = 0
        self._classes[first + np.arange(len(classes)), classes] = 1

    def _membership(self) -> np.ndarray:
        """(N, 1 + people + objects) owner of each Gaussian: the room, a person, or an object."""
        sizes = np.diff(self._starts)
        return np.eye(len(sizes), dtype=np.float32)[np.repeat(np.arange(len(sizes)), sizes)]
