# SPDX-License-Identifier: Apache-2.0
"""Removes floating surfaces: those that another camera sees through and none confirms, and those without a match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.stereo.passes import PlaneLabelling
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Another camera sees through a point when its own surface there is further by this share; it confirms it within the
# second share.
_THROUGH_SHARE, _CONFIRM_SHARE = 0.07, 0.05
# A plane inside the room stays where another camera judges it with at least half of the possible agreement of colours.
MAX_COST = 0.5


def is_looked_through(
    camera: Camera, depth_m: Float[np.ndarray, "H W"], others: Sequence[tuple[Camera, Float[np.ndarray, "h w"]]]
) -> Bool[np.ndarray, "H W"]:
    """Whether another camera sees past a pixel's surface and none confirms it.

    Cameras without evidence (outside their picture, hidden, unknown depth) have no vote.
    """
    points_m = camera.unproject(camera.pixel_centres(), depth_m)
    past, confirmed = np.zeros(depth_m.shape, bool), np.zeros(depth_m.shape, bool)
    for other, surface_m in others:
        pixels, z = other.project(points_m)
        height, width = surface_m.shape
        inside = (depth_m > 0) & (z > 0) & np.isfinite(pixels[..., 0]) & np.isfinite(pixels[..., 1])
        columns, rows = np.floor(np.where(inside[..., None], pixels, -1)).astype(np.int64).transpose(2, 0, 1)
        inside &= (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        seen = np.where(inside, surface_m[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)], 0)
        past |= (seen > 0) & (z < seen * (1 - _THROUGH_SHARE))
        confirmed |= (seen > 0) & (np.abs(z - seen) <= _CONFIRM_SHARE * z)
    return past & ~confirmed


def snap_to_room_box(
    labelled: PlaneLabelling,
    camera: Camera,
    room_box: RoomBox,
    others: Sequence[tuple[Camera, Float[np.ndarray, "h w"]]],
) -> tuple[PlaneLabelling, float]:
    """The labelling with floating surfaces put on the room box, unjudged, and the share of pixels concerned.

    A surface floats if other cameras see through it and none confirms it, or if no other camera judges it or matches it
    well. Only planes inside the room (label ≥ 6) are tested; all others are on the room box already.
    """
    unproven = ~labelled.judged | (labelled.cost > MAX_COST)
    floating = (is_looked_through(camera, labelled.depth_m, others) | unproven) & (labelled.plane >= 6)
    origin, directions = camera.rays()
    length, face = room_box.intersect(origin, directions)
    floating &= face >= 0
    return (
        replace(
            labelled,
            plane=np.where(floating, face, labelled.plane),
            depth_m=np.where(floating, length, labelled.depth_m).astype(labelled.depth_m.dtype),
            judged=labelled.judged & ~floating,
        ),
        float(floating.mean()),
    )
