# SPDX-License-Identifier: Apache-2.0
"""The body as two dozen capsules, one per joint, to compute the light it blocks from the floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel

if TYPE_CHECKING:
    from jaxtyping import Num

# A joint that moves fewer vertices than this counts as part of its neighbours.
_MIN_VERTICES = 6


@dataclass(frozen=True)
class Occluder:
    """Capsules in the shaped rest pose: the joint that moves each, the ends of their axes, and radii."""

    joint: Num[np.ndarray, " C"]
    ends_m: Num[np.ndarray, "C 2 3"]
    radius_m: Num[np.ndarray, " C"]

    def posed(self, world_from_rest: Num[np.ndarray, "J 4 4"]) -> Num[np.ndarray, "C 7"]:
        """Capsules in the world, two ends and a radius, from joint transforms; none if a transform is not finite.

        Raises ValueError for another shape.
        """
        if world_from_rest.shape not in ((24, 4, 4), (54, 4, 4)):
            raise ValueError(f"joint transforms have shape {world_from_rest.shape}, expected (24, 4, 4) or (54, 4, 4)")
        if not np.isfinite(world_from_rest).all():
            return np.zeros((0, 7))
        own = world_from_rest[self.joint]
        ends = np.einsum("cxy,cky->ckx", own[:, :3, :3], self.ends_m) + own[:, None, :3, 3]
        return np.concatenate([ends.reshape(-1, 6), self.radius_m[:, None]], axis=1)


def build_occluder(model: BodyModel, betas: Num[np.ndarray, " B"]) -> Occluder:
    """A capsule for each joint, along the longest direction of the vertices that the joint moves most.

    The radius is their mean distance from the axis, and the axis ends one radius before they do.
    """
    vertices, strongest = model.rest_vertices(betas), model.weights.argmax(axis=1)
    joints, ends, radii = [], [], []
    for joint in range(model.weights.shape[1]):
        own = vertices[strongest == joint]
        if len(own) < _MIN_VERTICES:
            continue
        # The middle of the box, not of the vertices: these are dense in hands and faces.
        axis = np.linalg.eigh(np.cov(own.T))[1][:, 2]
        along = (own - own[0]) @ axis
        across = own - own[0] - along[:, None] * axis
        centre = own[0] + (across.min(axis=0) + across.max(axis=0)) / 2
        radius = float(np.linalg.norm(across + own[0] - centre, axis=1).mean())
        low, high = along.min() + radius, along.max() - radius
        low, high = (low, high) if high > low else ((low + high) / 2,) * 2
        joints.append(joint)
        radii.append(radius)
        ends.append([centre + low * axis, centre + high * axis])
    return Occluder(np.array(joints), np.array(ends), np.array(radii))
