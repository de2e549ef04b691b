# SPDX-License-Identifier: Apache-2.0
"""Factor of the room's straight edges, which have three perpendicular directions, for rotations and lenses of
cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, PRINCIPAL, RADIAL, TURN, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Standard deviations in degrees: of one edge, and of a direction, because walls and furniture are square to about this:
# a real room's edges differed from a motion-capture system's calibration by as much, camera for camera.
EDGE_DEG, SQUARE_DEG = 0.6, 0.4
# Some edges run along no wall.
_FREEDOM = 2.0
# Each doubles the digits: eight end at rounding wherever a lens has a ray.
_NEWTON_STEPS = 8
_OF_CAMERA = [*range(TURN.start, TURN.stop), LOG_FOCAL, RADIAL, *range(PRINCIPAL.start, PRINCIPAL.stop)]


@dataclass(frozen=True)
class RoomEdges(Factor):
    """Angles of edges to their direction: columns of a camera's rotation and lens, and of the group "room", a rotation.

    Attributes:
        view: cameras.
        ends_px: ends of each edge, distorted pixels.
        direction: in the world, before the room is rotated.
        aspect: height of a pixel's focal length over its width.
        sigma_rad: (M,).
    """

    view: Integer[np.ndarray, " M"]
    ends_px: Num[np.ndarray, "M 2 2"]
    direction: Num[np.ndarray, "M 3"]
    aspect: Num[np.ndarray, " M"]
    sigma_rad: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 10"], unknowns: Unknowns) -> Num[np.ndarray, "M 1"]:
        turn, log_focal, radial, principal, room = at[:, :3], at[:, 3], at[:, 4], at[:, 5:7], at[:, 7:]
        bent = (self.ends_px - principal[:, None]) / np.exp(log_focal)[:, None, None]
        bent = bent / np.stack([np.ones_like(self.aspect), self.aspect], axis=1)[:, None]
        distorted = np.sqrt((bent**2).sum(2) + 1e-18)
        radius, k1 = distorted, radial[:, None]
        for _ in range(_NEWTON_STEPS):
            radius = radius - (radius * (1 + k1 * radius**2) - distorted) / (1 + 3 * k1 * radius**2)
        straight = bent * (radius / distorted)[..., None]
        rays = np.concatenate([straight, np.ones_like(straight[..., :1])], axis=2)
        normal = np.cross(rays[:, 0], rays[:, 1])
        normal = normal / np.sqrt((normal**2).sum(1, keepdims=True))
        seen = (unknowns.rotations[self.view] @ (self.direction + np.cross(room, self.direction))[..., None])[..., 0]
        return ((normal * (seen + np.cross(turn, seen))).sum(1) / self.sigma_rad)[:, None]


def room_edges(
    unknowns: Unknowns,
    view: Integer[np.ndarray, " M"],
    ends_px: Num[np.ndarray, "M 4"],
    axis: Integer[np.ndarray, " M"],
    world_from_room: Num[np.ndarray, "3 3"],
    aspect: Num[np.ndarray, " V"],
) -> RoomEdges:
    """The factor of edges along the room's directions ``axis``; all edges of a direction in a camera share its
    error."""
    own = unknowns.columns("cameras", view, _OF_CAMERA, PER_CAMERA)
    room = np.repeat(unknowns.columns("room", 0, range(3), 3), len(view), axis=0)
    repeats = np.bincount(view * 3 + axis)[view * 3 + axis]
    sigma_rad = np.radians(np.sqrt(EDGE_DEG**2 + repeats * SQUARE_DEG**2))
    columns = np.concatenate([own, room], axis=1)
    directions = world_from_room.T[axis]
    return RoomEdges(columns, _FREEDOM, view, ends_px.reshape(-1, 2, 2), directions, aspect[view], sigma_rad)
