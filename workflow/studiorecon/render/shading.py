# SPDX-License-Identifier: Apache-2.0
"""The room in the shadow of people and things: its Gaussians that face up, dimmed by what posed bodies and capsules keep from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.body.avatar import Avatar
from studiorecon.body.occluders import Occluder, occluder
from studiorecon.geometry import rotations
from studiorecon.scene.floor import FLOOR_M
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.scene.light import Light
from studiorecon.scene.objects import RigidObject

# The floor, whichever way its Gaussians are turned; above it up to low furniture what faces up.
_FURNITURE_M = 1.0
_LEAST_FACING = 0.05
# Moments at which the plates' own shade is looked at, and how far colours of one surface differ there, as a share.
_MOMENTS, _SAME = 24, 0.06


@dataclass(frozen=True)
class Shading:
    """Who shades what.

    Attributes:
        light: the estimated light.
        room: all Gaussians of the room, as the plates show them.
        at: (M,) those that can be shaded; ``facing`` (M,) how far each faces up, 0..1.
        usual: (M,) share of its light that each had in the plates.
        casters: people with their capsules: whoever a shot shows, stand-ins for themselves.
        things: loose things.
    """

    light: Light
    room: Gaussians
    at: np.ndarray
    facing: np.ndarray
    usual: np.ndarray
    casters: Sequence[tuple[Avatar, Occluder]]
    things: Sequence[RigidObject] = ()

    def room_at(self, frame: float) -> Gaussians:
        """The room as people and things at a (fractional) frame shade it."""
        left = self.light.factor(self.room.means_m[self.at], _bodies(self.casters, self.things, frame)) / self.usual
        return dimmed(self.room, self.at, 1 - self.facing * (1 - left))


def shading(
    light: Light, room: Gaussians, people: Sequence[Avatar], filmed: Sequence[Avatar], things: Sequence[RigidObject] = ()
) -> Shading | None:
    """How ``people`` and ``things`` shade the room; None when the light was not kept or nothing is there.

    ``filmed`` are the people of the footage: where they, or things, shade the floor most of the time, a clean plate shows that shade, and
    the room with it. What a plate would show is therefore found by its own rule and divided by.
    """
    if not light.kept or not (people or things):
        return None
    facing = facing_up(room, light.floor_m)
    at = np.flatnonzero(facing > _LEAST_FACING)
    casters = [(person, occluder(person.model, person.betas)) for person in filmed]
    last = filmed[0].frames - 1 if filmed else len(things[0].centres_m) - 1 if things else 0
    moments = np.unique(np.linspace(0, last, _MOMENTS).round())
    usual = most_agreed(np.stack([light.factor(room.means_m[at], _bodies(casters, things, float(m))) for m in moments]))
    return Shading(light, room, at, facing[at], usual, [(person, occluder(person.model, person.betas)) for person in people], things)


def most_agreed(left: np.ndarray) -> np.ndarray:
    """(M,) mean of the values that most moments of ``left`` (T, M) agree on, as a plate's colours are found; ties go to the brighter."""
    votes = np.stack([(np.abs(left - own) <= _SAME).sum(axis=0) for own in left])
    best = (votes + 1e-3 * left).argmax(axis=0)
    agree = np.abs(left - np.take_along_axis(left, best[None], axis=0)) <= _SAME
    return (left * agree).sum(axis=0) / agree.sum(axis=0)


def _bodies(casters: Sequence[tuple[Avatar, Occluder]], things: Sequence[RigidObject], frame: float) -> list[np.ndarray]:
    posed = []
    for person, capsules in casters:
        pose, trans = person.pose_at(frame)
        posed.append(capsules.posed(person.model.joint_transforms(pose[None], person.betas, trans[None])[0]))
    return [*posed, *(thing.capsule(frame) for thing in things)]


def facing_up(room: Gaussians, floor_m: float) -> np.ndarray:
    """(N,) float32: 1 on the floor, on low furniture the squared vertical part of the shortest axis, else 0.

    Shadows were measured on the floor: what does not face up as it does gets its light from elsewhere, and is left alone.
    """
    shortest = np.asarray(room.log_scales).argmin(axis=1)
    turned = rotations.from_quaternion(room.quaternions.astype(np.float64))
    up = np.take_along_axis(turned[:, 2], shortest[:, None], axis=1)[:, 0] ** 2
    height = room.means_m[:, 2] - floor_m
    return np.where(height < FLOOR_M, 1.0, np.where(height < _FURNITURE_M, up, 0.0)).astype(np.float32)


def dimmed(room: Gaussians, at: np.ndarray, factor: np.ndarray) -> Gaussians:
    """The room with the colours of the Gaussians ``at`` (M,) multiplied by ``factor`` (M,), from every side.

    A colour is 0.5 plus its harmonics, so the half is multiplied as well.
    """
    sh = room.sh.copy()
    sh[at] *= factor[:, None, None]
    sh[at, 0] += ((factor - 1) * (0.5 / SH_C0))[:, None]
    return Gaussians(room.means_m, room.quaternions, room.log_scales, room.logit_opacities, sh)
