# SPDX-License-Identifier: Apache-2.0
"""Whose pixels are whose: one person's silhouette in one camera, from everybody's hulls and the foreground (``hull``,
``foreground``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.people.silhouettes.foreground import BACKGROUND, FOREGROUND, UNKNOWN
from studiorecon.people.silhouettes.hull import HullPart
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# How far apart the edges of a hole in a silhouette may lie, as a share of the longer side.
_HOLE_SHARE = 0.03
# A pixel that two people's hulls cover shows the one whose middle it is nearer to by so much, metres; else nobody
# knows.
_NEARER_M = 0.1
# Foreground beside the hull belongs to an arm when it lies at least this high above the floor and is no longer than
# this, metres.
_LIMB_M, _ARM_M = 0.35, 0.9


def silhouettes(
    people: Sequence[HullPart],
    places_m: Sequence[Float[np.ndarray, " 2"]],
    view: int,
    camera: Camera,
    label: Integer[np.ndarray, "H W"],
    voxel_m: float,
) -> list[Integer[np.ndarray, "H W"]]:
    """(H, W) uint8 labels of camera number ``view`` for everybody, who stand at ``places_m`` (2,): foreground where the
    person is.

    Foreground beside the person is background; what is unknown stays so. A hole that only this camera sees in a part
    becomes unknown: it may be a shirt of the wall's colour. So does what may be somebody else: where two people's hulls
    cover a pixel, it is foreground only for whom it lies nearer to by ``_NEARER_M``. Several people's silhouettes leave
    ghosts in the hull, arms of nobody that end beside them.
    """
    reaches = [_reach_m(part, place, camera, voxel_m) for part, place in zip(people, places_m)]
    limbs = _limbs(people, reaches, places_m, camera, label)
    size = 2 * round(_HOLE_SHARE * max(label.shape)) + 1
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    out = []
    for k, (part, reach, (limb, doubtful)) in enumerate(zip(people, reaches, limbs)):
        own = (label == FOREGROUND) & np.isfinite(reach)
        closed = cv2.morphologyEx(own.astype(np.uint8), cv2.MORPH_CLOSE, around) > 0
        denied = part.denied[:, view]
        hole = (
            (label == BACKGROUND)
            & closed
            & np.isfinite(_drawn(part.cells_m[denied], np.zeros(int(denied.sum())), camera, voxel_m))
        )
        others = np.min([r for j, r in enumerate(reaches) if j != k] or [np.full(label.shape, np.inf)], axis=0)
        shared = own & (others < reach + _NEARER_M)
        own |= limb
        unknown = (label == UNKNOWN) | hole | shared | doubtful
        out.append(np.where(unknown, np.uint8(UNKNOWN), np.where(own, np.uint8(FOREGROUND), np.uint8(BACKGROUND))))
    return out


def _limbs(
    people: Sequence[HullPart],
    reaches: Sequence[np.ndarray],
    places_m: Sequence[np.ndarray],
    camera: Camera,
    label: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For everybody (H, W) bool each: foreground beside all hulls that is a limb of this person, and that may be one.

    An arm that one camera does not tell from the wall is carved from the hull, and would be missing in every
    silhouette. What hangs together with one silhouette only, no lower than ``_LIMB_M`` above the floor there (shadows
    lie lower) and no longer than an arm, is a limb; what touches several may be one.
    """
    owns = [(label == FOREGROUND) & np.isfinite(reach) for reach in reaches]
    rest = (label == FOREGROUND) & ~np.any(owns or [np.zeros(label.shape, bool)], axis=0)
    count, regions, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8), connectivity=8)
    touched = []
    for own in owns:
        beside = cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        touched.append(np.bincount(regions[beside & rest], minlength=count) > 0)
    out = []
    for k, (part, place) in enumerate(zip(people, places_m)):
        low = float(part.cells_m[:, 2].min())
        (foot, shoulder), (depth_m, _) = camera.project(
            np.array([[*place, low + _LIMB_M], [*place, low + _LIMB_M + _ARM_M]])
        )
        longest = float(np.linalg.norm(shoulder - foot)) if depth_m > 0.1 else 0.0
        lowest = stats[:, cv2.CC_STAT_TOP] + stats[:, cv2.CC_STAT_HEIGHT]
        size = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
        mine = touched[k] & (np.arange(count) > 0) & (size <= longest)
        others = np.any([t for j, t in enumerate(touched) if j != k] or [np.zeros(count, bool)], axis=0)
        sure = mine & ~others & (lowest <= foot[1])
        out.append((sure[regions], (mine & ~sure)[regions]))
    return out


def _reach_m(part: HullPart, place_m: np.ndarray, camera: Camera, voxel_m: float) -> np.ndarray:
    """(H, W) how far beside ``place_m`` (2,) the nearest of the part's cells is that a pixel shows, metres; inf where
    it shows none."""
    return _drawn(part.cells_m, np.linalg.norm(part.cells_m[:, :2] - place_m, axis=1), camera, voxel_m)


def _drawn(cells_m: np.ndarray, values: np.ndarray, camera: Camera, voxel_m: float) -> np.ndarray:
    """(H, W) float32 least of ``values`` (N,) of the cells that cover a pixel; inf where none does."""
    drawn: np.ndarray = np.full(camera.hw, np.inf, np.float32)
    pixels, depth_m = camera.project(cells_m)
    ahead = depth_m > 0.1
    if ahead.any():
        columns, rows = np.floor(pixels[ahead]).astype(int).T
        inside = (columns >= 0) & (rows >= 0) & (columns < camera.wh[0]) & (rows < camera.wh[1])
        np.minimum.at(drawn, (rows[inside], columns[inside]), values[ahead][inside].astype(np.float32))
        # A cell's diagonal at its distance, and a little: the hull was carved at the cells' centres.
        radius = int(np.ceil(0.9 * voxel_m * camera.focal_px[0] / float(np.median(depth_m[ahead])))) + 1
        drawn = cv2.erode(drawn, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
    return drawn
