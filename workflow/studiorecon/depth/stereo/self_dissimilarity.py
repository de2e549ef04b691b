# SPDX-License-Identifier: Apache-2.0
"""Regions of a photo that differ from the wall or floor behind them, as if nothing were in the room.

Walls and floors repeat themselves: a patch of wallpaper has similar ones further along. A pillar projected on the wall
behind it has not. So every patch of a face is compared with distant patches on the same face, from all cameras; a
poster differs from its wall too, but it does not reach the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import Face, RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float

# Size of the cells of a face, and half the side of a patch in cells.
_CELL_M, _HALF = 0.06, 2
# Nearer patches of a floor, or of a wall in either direction along it, may show the same object.
_ELSEWHERE_M = 0.6
# Number of principal components that describe a patch, and of patches to compare with; the fifth nearest counts.
_COMPONENTS, _OTHERS, _NEAREST = 12, 1500, 4
_AT_ONCE = 4096
# With fewer patches the appearance of a face is unknown.
_MIN_PIECES = 200
# A patch is different if it is this much further from others than half of all patches are; camera noise.
_USUAL, _NOISE = 1.5, 0.01


def foreground_log_odds(pictures: Sequence[Picture], room_box: RoomBox) -> list[Float[np.ndarray, "H W"]]:
    """Float32 in [-1, 1] of every picture: 1 where it differs from the rest of the face behind it, -1 where it does
    not.

    0 where that is undecided; faces are those of the room box. 2 s for four pictures 160 pixels wide.
    """
    where = [room_box.intersect(*p.camera.rays()) for p in pictures]
    odds = [np.zeros(p.camera.hw, np.float32) for p in pictures]
    for index, face in enumerate(room_box.rectangles):
        nodes = face.nodes(_CELL_M)
        pieces = [_pieces(picture, on == index, nodes) for picture, (_, on) in zip(pictures, where)]
        if sum(len(at) for at, _ in pieces) < _MIN_PIECES:
            continue
        apart = _patch_dissimilarity(
            np.concatenate([p for _, p in pieces]), np.concatenate([at for at, _ in pieces]), index < 4
        )
        usual = _USUAL * float(np.median(apart)) + _NOISE
        for own, picture, (at, _), (depth_m, on), values in zip(
            odds, pictures, pieces, where, np.split(apart, np.cumsum([len(at) for at, _ in pieces])[:-1])
        ):
            laid, unknown = np.zeros(nodes.shape[:2], np.float32), np.ones(nodes.shape[:2], bool)
            laid[tuple(at.T)], unknown[tuple(at.T)] = np.clip(values / usual - 1, -1, 1), False
            if face.name == "floor":
                # A patch differs as soon as its rim touches an object, which would make objects seem nearer.
                laid[unknown] = 1
                laid = np.asarray(cv2.erode(laid, np.ones((3, 3))), np.float32)
            laid[unknown] = 0
            own[on == index] = _project_face(laid, face, picture, depth_m)[on == index]
    return odds


def _pieces(picture: Picture, on_face: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) cells of a face that a picture shows completely, and (N, P) the colours of the patches around them."""
    pixels, z = picture.camera.project(nodes)
    # cv2 counts centres as integers
    columns, rows = (np.where(z > 0, pixels[..., k] - 0.5, -2).astype(np.float32) for k in (0, 1))
    usable = (picture.known & on_face).astype(np.float32)
    seen = cv2.remap(usable, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0) > 0.99
    at = np.argwhere(seen)
    if not len(at):
        return at, np.zeros((0, 3 * (2 * _HALF + 1) ** 2), np.float32)
    rgb = cv2.remap(picture.rgb.astype(np.float32), columns, rows, cv2.INTER_LINEAR)
    # Near a rim a patch is continued with its nearest pixels.
    nearest = scipy.ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    wide = np.pad(rgb[tuple(nearest)], ((_HALF, _HALF), (_HALF, _HALF), (0, 0)), mode="edge")
    side = range(2 * _HALF + 1)
    return at, np.concatenate([wide[at[:, 0] + a, at[:, 1] + b] for a in side for b in side], axis=1)


def _patch_dissimilarity(pieces: np.ndarray, at: np.ndarray, upright: bool) -> np.ndarray:
    """(N,) root mean square per cell by which every patch (N, P) differs from the nearest distant one on its face."""
    rng = np.random.default_rng(0)
    pieces = pieces - pieces.mean(axis=0)
    _, directions = np.linalg.eigh(pieces.T @ pieces)
    described = np.ascontiguousarray(pieces @ directions[:, -_COMPONENTS:])
    chosen = rng.permutation(len(pieces))[:_OTHERS]
    # Cells in the smallest type that holds them, because reading them takes most of the time.
    at = at.astype(np.int16 if at.max() < 2**15 else np.int64)
    others, places = described[chosen], at[chosen]
    # Cells nearer than this are neighbours.
    reach = at.dtype.type(np.ceil(_ELSEWHERE_M / _CELL_M))
    squared, theirs = np.empty(len(pieces), np.float32), (others**2).sum(axis=1)
    for first in range(0, len(pieces), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        distance = (described[some] ** 2).sum(axis=1)[:, None] + theirs
        distance -= 2 * described[some] @ others.T
        beside = np.abs(at[some, None, 1] - places[:, 1]) < reach
        if not upright:
            beside &= np.abs(at[some, None, 0] - places[:, 0]) < reach
        np.copyto(distance, np.float32(np.inf), where=beside)
        rank = min(_NEAREST, distance.shape[1] - 1)
        distance.partition(rank, axis=1)
        squared[some] = distance[:, rank]
    finite = squared[np.isfinite(squared)]
    # A face too narrow for distant patches gives no evidence.
    squared = np.where(np.isfinite(squared), squared, np.median(finite) if len(finite) else 0.0)
    return np.sqrt(np.maximum(squared, 0) / (2 * _HALF + 1) ** 2)


def _project_face(laid: np.ndarray, face: Face, picture: Picture, depth_m: np.ndarray) -> np.ndarray:
    """(H, W) the values ``laid`` on a face's cells, as seen by a camera."""
    points_m = picture.camera.unproject(picture.camera.pixel_centres(), depth_m)
    rows, columns = np.moveaxis(face.cells(points_m, laid.shape), -1, 0).astype(np.float32)
    return cv2.remap(laid, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
