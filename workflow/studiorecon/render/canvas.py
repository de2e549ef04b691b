# SPDX-License-Identifier: Apache-2.0
"""Draws a composite picture after picture: the room is put into blocks once, only the people are written anew."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.render.composite import Composite, class_colours
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.splatting.blocks import BlockedGaussians, aligned, fill_blocks, padded_count
from studiorecon.splatting.conventions import BLOCK_FLOATS, LANES
from studiorecon.splatting.device import rasteriser
from studiorecon.splatting.rendering import Rendering

_FLOATS_PER_GAUSSIAN = BLOCK_FLOATS // LANES


class Stage:
    """Blocks of the room, with free blocks behind them for people."""

    def __init__(self, room: Gaussians, people: Gaussians) -> None:
        at = padded_count(room.count) * _FLOATS_PER_GAUSSIAN
        length = at + (padded_count(people.count) * _FLOATS_PER_GAUSSIAN if people.count else 0)
        parameters = aligned(length)
        _fill(room, parameters[:at])
        self._people = parameters[at:]
        count = padded_count(room.count) + people.count
        self.blocked = BlockedGaussians(parameters, count, max(room.sh_degree, people.sh_degree))

    def enter(self, people: Gaussians) -> BlockedGaussians:
        """The blocks with these people, as many Gaussians as ever, in them."""
        if people.count:
            _fill(people, self._people)
        return self.blocked


class Canvas:
    """Pictures of a composite; the same bytes as rasterising all its Gaussians together, in a fraction of the time."""

    def __init__(self, scene: Composite, near_m: float, device: str = "cpu") -> None:
        self._scene, self._rasteriser = scene, rasteriser(device, near_m=near_m)
        people, classes = scene.people_at(0.0)
        self._coloured = Stage(scene.background, people)
        self._classed = Stage(class_colours(scene.background, scene.classes), class_colours(people, classes))

    def draw(self, camera: Camera, frame: float, background_rgb: Sequence[float]) -> tuple[Rendering, np.ndarray]:
        """The rendering at a (fractional) frame, and each class's share of every pixel (H, W, 3)."""
        people, classes = self._scene.people_at(frame)
        rendering = self._rasteriser.forward(self._coloured.enter(people), camera, background_rgb)
        shares = self._rasteriser.forward(self._classed.enter(class_colours(people, classes)), camera).rgb
        return rendering, shares


def _fill(gaussians: Gaussians, parameters: np.ndarray) -> None:
    arrays = (gaussians.means_m, gaussians.quaternions, gaussians.log_scales, gaussians.logit_opacities, gaussians.sh)
    fill_blocks(*arrays, np.arange(gaussians.count), parameters)


def together(scene: Composite, frame: float) -> tuple[Gaussians, np.ndarray]:
    """All Gaussians of a composite at a frame, and their classes (N,): the slow truth beside ``Canvas``."""
    people, classes = scene.people_at(frame)
    return concatenate([scene.background, people]), np.concatenate([scene.classes, classes])
