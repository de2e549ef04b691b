# SPDX-License-Identifier: Apache-2.0
"""Quality of a rig: coverage, the error of joints by Cramér and Rao's bound, and the unseen share of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.placement.room import FEET_M, HEAD_M, HIPS_M, WIDTH_M, Room, is_blocked
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Sigma of a detector's point per coordinate, as a share of the person's height in the picture: networks see a crop of
# the person, so their error grows with the person. From BlazePose on four cameras (pose2sim_balancing): median residual
# 1.32 px where the man is 195 px tall, over the median length of a normal deviate (1.18), and over the root of the 5 of
# 8 degrees of freedom that a point fitted to four views leaves.
_DETECTOR_SHARE = 0.0075
_PERSON_M = 1.7
# No detector is better than about half a pixel.
_MIN_PX = 0.5
_NEAR_M = 0.2
# A joint that only two cameras see cannot be checked (their residual proves nothing) and counts as at least this far
# off.
_UNVERIFIED_M = 0.03
# A joint is undetermined beyond this error, and with fewer than two cameras.
_UNKNOWN_M = 0.1
# Cost of a per cent of unseen floor and walls, in metres of the joints' mean error.
_UNSEEN_WORTH_M = 0.0005


@dataclass(frozen=True)
class RigQuality:
    """Quality of a rig: shares of the stage's positions or the room's surface, and root mean square errors, metres.

    Attributes:
        two, three: height ("head", "floor") → share that at least two or three cameras see, without a person.
        two_hidden, three_hidden: the same with one person in the way, mean over their positions.
        error_m, worst_error_m: median and 90 % quantile of the joints' error, with a person in the way; or inf.
        undetermined: share of joints that fewer than two cameras see, or that are off by more than 10 cm.
        unseen: "floor", "walls", "ceiling" and "all" → share that no camera sees while a person is in the middle.
        cost_m: cost of a plan: the joints' mean error, with penalties for undetermined or unverified joints and unseen
            floor and walls.
    """

    two: dict[str, float]
    three: dict[str, float]
    two_hidden: dict[str, float]
    three_hidden: dict[str, float]
    error_m: float
    worst_error_m: float
    undetermined: float
    unseen: dict[str, float]
    cost_m: float


def is_in_picture(cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "V N"]:
    """Whether the point is in the camera's picture, with occlusion ignored."""
    found = []
    for camera in cameras:
        pixels, depth = camera.project(points_m)
        inside = (pixels >= 0).all(axis=-1) & (pixels <= camera.wh).all(axis=-1)
        found.append(inside & (depth > _NEAR_M))
    return np.array(found)


def information(cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "V N 3 3"]:
    """Fisher information of every camera about every point, 1/m², for the detector's noise at that distance."""
    result = np.empty((len(cameras), len(points_m), 3, 3))
    for camera, own in zip(cameras, result):
        rotation = camera.rotation_camera_from_world
        local = (points_m - camera.centre_m) @ rotation.T
        depth = np.where(local[:, 2] > _NEAR_M, local[:, 2], np.inf)[:, None]
        noise = np.hypot(
            _MIN_PX, _DETECTOR_SHARE * np.mean(camera.focal_px) * _PERSON_M / np.where(np.isfinite(depth), depth, 1.0)
        )
        own[:] = 0
        for axis, focal in enumerate(camera.focal_px):
            row = focal / depth * (rotation[axis] - local[:, axis, None] / depth * rotation[2]) / noise
            own += row[:, :, None] * row[:, None, :]
    return result


def errors_m(info: Float[np.ndarray, "V N 3 3"], sees: Bool[np.ndarray, "... V N"]) -> Float[np.ndarray, "... N"]:
    """Least error of any unbiased estimate (Cramér, Rao): the root of the trace of the inverse information.

    ``sees`` is which cameras see the point; inf with fewer than two.
    """
    total = np.einsum("...vn,vnij->...nij", sees.astype(np.float64), info)
    scale = np.trace(total, axis1=-2, axis2=-1)
    # Parallel rays make the matrix singular; this small addition only bounds their error, at kilometres.
    safe = total + (np.where(scale > 0, scale, 1.0) * 1e-12)[..., None, None] * np.eye(3)
    return np.where(sees.sum(axis=-2) >= 2, np.sqrt(np.trace(np.linalg.inv(safe), axis1=-2, axis2=-1)), np.inf)


class RigEvaluator:
    """Evaluates rigs for one room; values that do not depend on the cameras are computed once."""

    def __init__(self, room: Room) -> None:
        self.room = room
        self.heights = {"floor": FEET_M, "hips": HIPS_M, "head": HEAD_M}
        self.points_m = np.concatenate([room.at_height(height) for height in self.heights.values()])
        self.surfaces_m = room.surfaces_m()
        self.all_surfaces_m = np.concatenate(list(self.surfaces_m.values()))
        self.bystanders_m = room.bystanders_m()
        # A point inside the occluding person is not occluded by them.
        apart = np.linalg.norm(self.points_m[None, :, :2] - self.bystanders_m[:, None], axis=-1)
        self.possible = apart > WIDTH_M

    def sees(
        self, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"], person_m: Float[np.ndarray, " 2"] | None
    ) -> Bool[np.ndarray, "V N"]:
        """Visible points, with a person at ``person_m``, or without one."""
        found = is_in_picture(cameras, points_m)
        if person_m is None:
            return found
        eyes = np.array([camera.centre_m for camera in cameras])
        return found & ~is_blocked(eyes, points_m, person_m, self.room.low_m[2])

    def figures(self, cameras: Sequence[Camera]) -> RigQuality:
        """The quality of the room's cameras."""
        free = self.sees(cameras, self.points_m, None).sum(axis=0)
        hidden = np.array([self.sees(cameras, self.points_m, place) for place in self.bystanders_m])
        counts = hidden.sum(axis=1)
        errors = errors_m(information(cameras, self.points_m), hidden)
        each = len(self.points_m) // len(self.heights)
        where = {name: slice(k * each, (k + 1) * each) for k, name in enumerate(self.heights)}
        shown = ("head", "floor")

        def share(least: int, name: str) -> float:
            return float((counts[:, where[name]] >= least)[self.possible[:, where[name]]].mean())

        known = errors[self.possible]
        lost = known > _UNKNOWN_M
        counted = np.where(counts[self.possible] == 2, np.hypot(known, _UNVERIFIED_M), known)
        middle_m, worst_m = (float(np.quantile(known, q, method="nearest")) for q in (0.5, 0.9))
        unseen = self._unseen(cameras)
        return RigQuality(
            {name: float((free[where[name]] >= 2).mean()) for name in shown},
            {name: float((free[where[name]] >= 3).mean()) for name in shown},
            {name: share(2, name) for name in shown},
            {name: share(3, name) for name in shown},
            middle_m,
            worst_m,
            float(lost.mean()),
            unseen,
            float(np.minimum(counted, _UNKNOWN_M).mean()) + 100 * _UNSEEN_WORTH_M * unseen["floor and walls"],
        )

    def cost_m(self, cameras: Sequence[Camera]) -> float:
        """The cost by which plans are compared."""
        return self.figures(cameras).cost_m

    def joint_errors_m(self, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """Error of a joint at every point, without a person in the way."""
        return errors_m(information(cameras, points_m), self.sees(cameras, points_m, None))

    def _unseen(self, cameras: Sequence[Camera]) -> dict[str, float]:
        missed = ~self.sees(cameras, self.all_surfaces_m, self.room.middle_m).any(axis=0)
        cuts = np.cumsum([len(points) for points in self.surfaces_m.values()])[:-1]
        parts = dict(zip(self.surfaces_m, np.split(missed, cuts)))
        width, depth, height = self.room.size_m
        area = {"floor": width * depth, "walls": 2 * (width + depth) * height, "ceiling": width * depth}
        found = {name: float(part.mean()) for name, part in parts.items()}
        for name, of in (("floor and walls", ("floor", "walls")), ("all", tuple(area))):
            found[name] = float(sum(area[part] * found[part] for part in of) / sum(area[part] for part in of))
        return found
