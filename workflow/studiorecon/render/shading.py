# SPDX-License-Identifier: Apache-2.0
"""The room in people's shadow: its Gaussians that face up, dimmed by what posed bodies keep from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.body.avatar import Avatar
from studiorecon.body.occluders import Occluder, occluder
from studiorecon.geometry import rotations
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.scene.light import Light

# The floor, whichever way its Gaussians are turned; above it up to low furniture what faces up.
_FLOOR_M, _FURNITURE_M = 0.06, 1.0
_LEAST_FACING = 0.05


@dataclass(frozen=True)
class Shading:
    """Who shades what.

    Attributes:
        light: the estimated light.
        room: all Gaussians of the room, in the open.
        at: (M,) those that can be shaded; ``facing`` (M,) how far each faces up, 0..1.
        casters: people with their capsules: whoever a shot shows, stand-ins for themselves.
    """

    light: Light
    room: Gaussians
    at: np.ndarray
    facing: np.ndarray
    casters: Sequence[tuple[Avatar, Occluder]]

    def room_at(self, frame: float) -> Gaussians:
        """The room as people at a (fractional) frame shade it."""
        bodies = []
        for person, capsules in self.casters:
            pose, trans = person.pose_at(frame)
            bodies.append(capsules.posed(person.model.joint_transforms(pose[None], person.betas, trans[None])[0]))
        left = self.light.factor(self.room.means_m[self.at], bodies)
        return dimmed(self.room, self.at, 1 - self.facing * (1 - left))


def shading(light: Light, room: Gaussians, people: Sequence[Avatar]) -> Shading | None:
    """How ``people`` shade the room; None when the light was not kept or nobody is there."""
    if not light.kept or not people:
        return None
    facing = facing_up(room, light.floor_m)
    at = np.flatnonzero(facing > _LEAST_FACING)
    return Shading(light, room, at, facing[at], [(person, occluder(person.model, person.betas)) for person in people])


def facing_up(room: Gaussians, floor_m: float) -> np.ndarray:
    """(N,) float32: 1 on the floor, on low furniture the squared vertical part of the shortest axis, else 0.

    Shadows were measured on the floor: what does not face up as it does gets its light from elsewhere, and is left alone.
    """
    shortest = np.asarray(room.log_scales).argmin(axis=1)
    turned = rotations.from_quaternion(room.quaternions.astype(np.float64))
    up = np.take_along_axis(turned[:, 2], shortest[:, None], axis=1)[:, 0] ** 2
    height = room.means_m[:, 2] - floor_m
    return np.where(height < _FLOOR_M, 1.0, np.where(height < _FURNITURE_M, up, 0.0)).astype(np.float32)


def dimmed(room: Gaussians, at: np.ndarray, factor: np.ndarray) -> Gaussians:
    """The room with the colours of the Gaussians ``at`` (M,) multiplied by ``factor`` (M,), from every side.

    A colour is 0.5 plus its harmonics, so the half is multiplied as well.
    """
    sh = room.sh.copy()
    sh[at] *= factor[:, None, None]
    sh[at, 0] += ((factor - 1) * (0.5 / SH_C0))[:, None]
    return Gaussians(room.means_m, room.quaternions, room.log_scales, room.logit_opacities, sh)
