# SPDX-License-Identifier: Apache-2.0
"""Shadows of people and objects on the room: dims its Gaussians that face up by the light that bodies hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.capsules import Occluder, build_occluder
from studiorecon.geometry import rotations
from studiorecon.geometry.floor import FLOOR_M
from studiorecon.render.room_light import Light, LitPoints
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.splatting.conventions import BLOCK_FLOATS, KERNEL, LANES, SH
from studiorecon.splatting.rigid_object import RigidObject

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# The floor in any orientation of its Gaussians; above it, up to low furniture, those that face up.
_FURNITURE_M = 1.0
_MIN_FACING = 0.05
# Moments at which the plates' own shade is evaluated, and how far colours of one surface differ between them, as a
# share.
_MOMENTS, _SAME = 24, 0.06


@dataclass(frozen=True)
class Shading:
    """Shadows of a scene's people and objects.

    Attributes:
        lit: the Gaussians that can be shaded, under the estimated light.
        at, facing: their indices in the room, ascending, and how far each faces up, 0..1.
        plate_light: share of its light that each had in the plates.
        casters: people with their capsules: those that a shot shows, including stand-ins.
    """

    lit: LitPoints
    at: Integer[np.ndarray, " M"]
    facing: Float[np.ndarray, " M"]
    plate_light: Float[np.ndarray, " M"]
    casters: Sequence[tuple[Avatar, Occluder]]
    things: Sequence[RigidObject] = ()

    def factor(self, frame: float) -> Float[np.ndarray, " M"]:
        """Float32 factors on the plates' colours of the Gaussians ``at`` at a frame; see ``dim_gaussians``."""
        left = self.lit.remaining_light(_bodies(self.casters, self.things, frame)) / self.plate_light
        return (1 - self.facing * (1 - left)).astype(np.float32)


def build_shading(
    light: Light,
    room: Gaussians,
    people: Sequence[Avatar],
    filmed: Sequence[Avatar],
    things: Sequence[RigidObject] = (),
) -> Shading | None:
    """The shadows of ``people`` and ``things`` on the room; None if the light was not accepted or nothing casts one.

    ``filmed`` are the people of the footage: where they, or objects, shade the floor most of the time, a clean plate
    contains that shade, and the room with it. It is computed by the plate's own rule and divided out.
    """
    if not light.accepted or not (people or things):
        return None
    facing = upward_share(room, light.floor_m)
    at = np.flatnonzero(facing > _MIN_FACING)
    casters = [(person, build_occluder(person.model, person.betas)) for person in filmed]
    last = filmed[0].frames - 1 if filmed else len(things[0].centres_m) - 1 if things else 0
    moments = spread_indices(last + 1, _MOMENTS)
    lit = LitPoints(light, room.means_m[at])
    plate_light = robust_mode(np.stack([lit.remaining_light(_bodies(casters, things, float(m))) for m in moments]))
    return Shading(
        lit,
        at,
        facing[at],
        plate_light,
        [(person, build_occluder(person.model, person.betas)) for person in people],
        things,
    )


def robust_mode(left: Float[np.ndarray, "T M"]) -> Float[np.ndarray, " M"]:
    """Mean of the values that most moments of ``left`` agree on, as for a plate's colours; ties go to the brighter."""
    votes = np.stack([(np.abs(left - own) <= _SAME).sum(axis=0) for own in left])
    best = (votes + 1e-3 * left).argmax(axis=0)
    agree = np.abs(left - np.take_along_axis(left, best[None], axis=0)) <= _SAME
    return (left * agree).sum(axis=0) / agree.sum(axis=0)


def _bodies(
    casters: Sequence[tuple[Avatar, Occluder]], things: Sequence[RigidObject], frame: float
) -> list[np.ndarray]:
    there = [(person, capsules) for person, capsules in casters if person.is_present(frame)]
    posed = [capsules.posed(person.world_from_rest(frame)) for person, capsules in there]
    return [*posed, *(thing.capsule(frame) for thing in things)]


def upward_share(room: Gaussians, floor_m: float) -> Float[np.ndarray, " N"]:
    """1 on the floor, on low furniture the squared vertical part of the shortest axis, else 0.

    Shadows were measured on the floor: surfaces with another direction get other light, and stay unchanged.
    """
    shortest = np.asarray(room.log_scales).argmin(axis=1)
    turned = rotations.from_quaternion(room.quaternions.astype(np.float64))
    up = np.take_along_axis(turned[:, 2], shortest[:, None], axis=1)[:, 0] ** 2
    height = room.means_m[:, 2] - floor_m
    return np.where(height < FLOOR_M, 1.0, np.where(height < _FURNITURE_M, up, 0.0)).astype(np.float32)


@numba.njit(nogil=True, **KERNEL)
def dim_gaussians(sh, at, factor, before, parameters):
    """Writes harmonics (N, K, 3) of colours multiplied by ``factor`` into the blocks of the Gaussians ``at``.

    The factor applies to all directions of view. A colour is 0.5 plus its harmonics, so the half is multiplied as well.
    Gaussians whose factor is as ``before`` are skipped.
    """
    for m in range(len(at)):
        if factor[m] == before[m]:
            continue
        base = (at[m] // LANES) * BLOCK_FLOATS + at[m] % LANES
        for band in range(sh.shape[1]):
            for channel in range(3):
                darker = sh[at[m], band, channel] * factor[m]
                if band == 0:
                    darker += (factor[m] - np.float32(1)) * np.float32(0.5 / SH_C0)
                parameters[base + (SH + 3 * band + channel) * LANES] = darker
