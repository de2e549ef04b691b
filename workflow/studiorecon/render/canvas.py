# SPDX-License-Identifier: Apache-2.0
"""Draws a composite picture after picture: the room is put into blocks once, only the people, and the room if they shade it, anew.

Everything but colour (classes of truth, mattes, normals) is blended beside it or with the lists of the same pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.render.composite import TRUTH_LEVELS, Composite
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.blocks import BlockedGaussians, aligned, fill_blocks, padded_count
from studiorecon.splatting.conventions import BLOCK_FLOATS, LANES
from studiorecon.splatting.device import rasteriser
from studiorecon.splatting.rendering import Rendering

_FLOATS_PER_GAUSSIAN = BLOCK_FLOATS // LANES


@dataclass(frozen=True)
class Layers:
    """One picture, taken apart.

    Attributes:
        rendering: premultiplied colours over nothing, alpha, expected depth and world normals.
        shares: (H, W, 3) share of every pixel that is measured, inferred, invented.
        mattes: (H, W, 1 + people + things) share of every pixel that is the room, then each person and thing; they add up to alpha.
    """

    rendering: Rendering
    shares: np.ndarray
    mattes: np.ndarray


class Canvas:
    """Pictures of a composite; the same bytes as rasterising all its Gaussians together, in a fraction of the time."""

    def __init__(self, scene: Composite, near_m: float, device: str = "cpu") -> None:
        self._scene, self._rasteriser = scene, rasteriser(device, near_m=near_m)
        room, people = scene.background, scene.people_at(0.0)[0]
        self._first_person = padded_count(room.count)
        at = self._first_person * _FLOATS_PER_GAUSSIAN
        parameters = aligned(at + (padded_count(people.count) * _FLOATS_PER_GAUSSIAN if people.count else 0))
        _fill(room, parameters[:at])
        self._room, self._people, self._drawn = parameters[:at], parameters[at:], room
        count = self._first_person + people.count
        self._blocked = BlockedGaussians(parameters, count, max(room.sh_degree, people.sh_degree))
        # One column per class; the free places between room and people have opacity 0 and stay 0.
        self._classes = np.zeros((count, len(TRUTH_LEVELS)), np.float32)
        self._classes[np.arange(room.count), scene.classes] = 1

    def draw(self, camera: Camera, frame: float, background_rgb: Sequence[float]) -> tuple[Rendering, np.ndarray]:
        """The rendering at a (fractional) frame, and each class's share of every pixel (H, W, 3)."""
        classes = self._enter(frame)
        rendering = self._rasteriser.forward(self._blocked, camera, background_rgb, values=classes)
        return rendering, rendering.values

    def layers(self, camera: Camera, frame: float) -> Layers:
        """The picture at a (fractional) frame, taken apart for compositing."""
        classes = self._enter(frame)
        rendering = self._rasteriser.forward(self._blocked, camera, sides=("normals",), values=np.hstack([classes, self._membership()]))
        drawn = rendering.values
        return Layers(rendering, drawn[..., : classes.shape[1]], drawn[..., classes.shape[1] :])

    def _enter(self, frame: float) -> np.ndarray:
        """Puts the people of a frame, as many Gaussians as ever, and their shade into the blocks; (N, 3) the classes of all as columns."""
        room = self._scene.room_at(frame)
        if room is not self._drawn:
            _fill(room, self._room)
            self._drawn = room
        people, classes = self._scene.people_at(frame)
        if people.count:
            _fill(people, self._people)
        self._classes[self._first_person :] = 0
        self._classes[self._first_person + np.arange(people.count), classes] = 1
        return self._classes

    def _membership(self) -> np.ndarray:
        """(N, 1 + people + things) whose each Gaussian is: the room's, then each person's and thing's."""
        sizes = [self._first_person, *(len(moving.provenance) for moving in self._scene.moving)]
        return np.eye(len(sizes), dtype=np.float32)[np.repeat(np.arange(len(sizes)), sizes)]


def _fill(gaussians: Gaussians, parameters: np.ndarray) -> None:
    arrays = (gaussians.means_m, gaussians.quaternions, gaussians.log_scales, gaussians.logit_opacities, gaussians.sh)
    fill_blocks(*arrays, np.arange(gaussians.count), parameters)
