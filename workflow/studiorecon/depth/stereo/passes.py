# SPDX-License-Identifier: Apache-2.0
"""The second pass: few planes, judged by cameras that see past the others' surfaces; else the room box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.depth.stereo.labelling import label_planes
from studiorecon.depth.stereo.matching import UNKNOWN, plane_homography, plane_inverse_depth
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.sweep_settings import Matching
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Another surface hides a point when it is nearer by this share of the depth plus this many metres.
_HIDING_SHARE, _HIDING_M = 0.04, 0.05
_AGREEING_M = 0.03
# Weight of a camera whose own depth disagrees but does not hide the point.
_DISAGREEING_WEIGHT = 0.5
# A second, larger window stabilises weak texture; it loses by this much when both fit.
_LARGER_WINDOW, _LARGER_LOSS = 6, 0.05
OUTSIDE = 2.5
"""Cost of a surface that a pixel's ray does not meet."""
_OUTSIDE_MARGIN_M = 0.05


@dataclass(frozen=True)
class PassSettings(Matching):
    """Costs of the second pass: its window, a change of plane, planes without a judging camera, furniture over walls.

    The gap between the two defaults puts pixels seen by one view on walls.
    """

    refine_window: int = 5
    refine_penalty: float = 0.8
    room_box_default: float = 0.3
    other_default: float = 0.85
    other_extra: float = 0.15


@dataclass(frozen=True)
class PlaneLabelling:
    """The labelling of one picture: plane index, depth, cost, and whether another camera judged it."""

    plane: Integer[np.ndarray, "H W"]
    depth_m: Float[np.ndarray, "H W"]
    cost: Float[np.ndarray, "H W"]
    judged: Bool[np.ndarray, "H W"]


def plane_depths(
    picture: Picture, planes: Float[np.ndarray, "L 4"], room_box: RoomBox, settings: PassSettings
) -> Float[np.ndarray, "L H W"]:
    """Float32 depth of every plane in a picture; 0 where it is out of range or outside the shell."""
    depths = np.zeros((len(planes), *picture.camera.hw), np.float32)
    pixels = picture.camera.pixel_centres()
    for k, plane in enumerate(planes):
        depth_m = picture.depth(plane, settings.near_m, settings.far_m)
        # The room box may be beyond far_m: a default wall of an open place still bounds the world.
        if k < 6:
            depth_m = picture.depth(plane, settings.near_m, np.inf)
        inside = room_box.contains(picture.camera.unproject(pixels, depth_m), _OUTSIDE_MARGIN_M)
        depths[k] = np.where(inside, depth_m, 0)
    return depths


def plane_scores(
    picture: Picture,
    other: Picture,
    planes: Float[np.ndarray, "L 4"],
    depths: Float[np.ndarray, "L H W"],
    settings: PassSettings,
) -> Float[np.ndarray, "L H W"]:
    """Float32 agreement of a picture with another through every plane that ``depths`` allows."""
    scores = np.full(depths.shape, UNKNOWN, np.float32)
    for k, plane in enumerate(planes):
        if not depths[k].any():
            continue
        reach = np.inf if k < 6 else settings.far_m
        small = picture.score(other, plane, settings.refine_window, settings.mean_weight, settings.near_m, reach)
        large = picture.score(
            other, plane, settings.refine_window + _LARGER_WINDOW, settings.mean_weight, settings.near_m, reach
        )
        scores[k] = np.where(small > UNKNOWN, np.maximum(small, large - _LARGER_LOSS), UNKNOWN)
    return scores


@dataclass(frozen=True)
class PlaneCosts:
    """Every plane at every pixel of one picture: depth, cost, and whether another camera judged it."""

    depths_m: Float[np.ndarray, "L H W"]
    cost: Float[np.ndarray, "H W L"]
    judged: Bool[np.ndarray, "H W L"]


def plane_costs(
    picture: Picture,
    planes: Float[np.ndarray, "L 4"],
    depths: Float[np.ndarray, "L H W"],
    scores: Sequence[Float[np.ndarray, "L H W"]],
    others: Sequence[tuple[Camera, Float[np.ndarray, "h w"]]],
    settings: PassSettings,
) -> PlaneCosts:
    """The costs of one picture from its scores against every other camera, given those cameras and their latest depth.

    The first six planes are the room box: where no camera can judge, they cost ``room_box_default`` and all others
    ``other_default``, which puts pixels seen by one camera on the walls.
    """
    cost = np.empty((*picture.camera.hw, len(planes)), np.float32)
    judged = np.zeros(cost.shape, bool)
    flat = ~picture.textured(settings.refine_window)
    for k, plane in enumerate(planes):
        total = np.zeros(picture.camera.hw, np.float32)
        weight = np.zeros(picture.camera.hw, np.float32)
        weights = plane_inverse_depth(picture.camera, plane)
        if weights is not None and depths[k].any():
            for (camera, depth_m), score in zip(others, scores):
                homography = plane_homography(picture.camera, camera, weights)
                _judge(score[k], homography, depths[k], depth_m, total, weight)
        of_room_box = k < 6
        default = settings.room_box_default if of_room_box else settings.other_default
        value = np.where(weight > 0, total / np.maximum(weight, 1e-6), default)
        # A flat window matches flat windows everywhere: that is worth no more than no judgement.
        value = np.where(flat, np.maximum(value, settings.room_box_default), value) + (
            0.0 if of_room_box else settings.other_extra
        )
        cost[..., k] = np.where(depths[k] > 0, value, OUTSIDE)
        judged[..., k] = weight > 0
    return PlaneCosts(depths, cost, judged)


def choose_surfaces(picture: Picture, costs: PlaneCosts, change_penalty: float) -> PlaneLabelling:
    """The labelling of one picture: the surface of least cost at every pixel, smooth except at the photo's edges."""
    chosen = label_planes(costs.cost, picture.rgb, change_penalty)
    pick = chosen[..., None]
    depth_m = np.take_along_axis(np.moveaxis(costs.depths_m, 0, -1), pick, axis=-1)[..., 0]
    return PlaneLabelling(
        chosen,
        depth_m,
        np.take_along_axis(costs.cost, pick, axis=-1)[..., 0],
        np.take_along_axis(costs.judged, pick, axis=-1)[..., 0],
    )


def label_picture(
    picture: Picture,
    planes: Float[np.ndarray, "L 4"],
    depths: Float[np.ndarray, "L H W"],
    scores: Sequence[Float[np.ndarray, "L H W"]],
    others: Sequence[tuple[Camera, Float[np.ndarray, "h w"]]],
    settings: PassSettings,
) -> PlaneLabelling:
    """The labelling of one picture by ``plane_costs`` alone."""
    return choose_surfaces(
        picture, plane_costs(picture, planes, depths, scores, others, settings), settings.refine_penalty
    )


@njit(cache=True)
def _judge(score, h, depth, other_depth, total, weight):
    """Add one camera's cost of a plane where the plane is not hidden from it."""
    height, width = score.shape
    other_height, other_width = other_depth.shape
    for y in range(height):
        for x in range(width):
            if score[y, x] <= UNKNOWN or depth[y, x] <= 0:
                continue
            u, v = x + 0.5, y + 0.5
            w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
            i = int(np.floor((h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w))
            j = int(np.floor((h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w))
            if i < 0 or j < 0 or i >= other_width or j >= other_height:
                continue
            z = w * depth[y, x]
            seen = other_depth[j, i]
            if seen > 0 and seen < z * (1 - _HIDING_SHARE) - _HIDING_M:
                continue
            agrees = abs(seen - z) < _HIDING_SHARE * z + _AGREEING_M
            share = np.float32(1) if agrees else np.float32(_DISAGREEING_WEIGHT)
            total[y, x] += share * min(max(1 - score[y, x], np.float32(0)), np.float32(1.3))
            weight[y, x] += share
