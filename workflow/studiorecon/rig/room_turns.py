# SPDX-License-Identifier: Apache-2.0
"""Relative rotations of cameras from the room's straight edges: walls, windows and furniture have three common
directions.

People leave relative rotations uncertain by degrees where they stay in one place, since a detector's error of a joint
is always the same. Edges do not depend on people. With rotations that are right within some degrees, every camera's own
edges determine the rest (vanishing points of a Manhattan world; Coughlan and Yuille 1999). The people's rotations
choose one of the 24 equivalent frames. Edges come from the line segment detector (Grompone von Gioi et al. 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.arrays import require
from studiorecon.geometry.rotations import angle, exp, log
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Shorter edges, as a share of the longer side, do not determine directions.
_MIN_SHARE = 0.02
# Largest error of people's rotations, degrees, and the step of the search within that.
_REACH_DEG, _STEP_DEG = 8.0, 2.0
# Number of room frames to try: 6° apart.
_FRAMES = 3000
_REFINED = 12
# Widths of agreement from coarse to fine, degrees: across cameras, whose rotations are off, and within one camera.
_ACROSS_DEG, _COARSE_DEG, _FINE_DEG = (5.0, 4.0), (1.5, 1.0, 0.6), 0.6
# Sufficient edges: at least this share of their length is along the three directions (chance: 5 %), and along two of
# them at least so much and so many.
_ALONG, _ALONG_EACH, _MIN_EDGES = 0.25, 0.05, 6
# Another rotation of a camera with this share of the support, further away than this, leaves it undetermined.
_RIVAL, _ELSEWHERE_DEG = 0.8, 1.5
# Walls and furniture are square to about this; a real room's edges differed from a motion-capture system's calibration
# by as much, camera for camera.
_SQUARE_DEG = 0.3
_HELD_DEG = 1.0


def straight_edges(
    grey: Num[np.ndarray, "H W"], known: Bool[np.ndarray, "H W"] | None = None
) -> Num[np.ndarray, "N 4"]:
    """Ends x0, y0, x1, y1 of the straight edges of ``grey`` (H, W, uint8) that are long enough for a direction.

    Centres of pixels are at +0.5. With ``known`` only those where it is set. Raises ValueError for another shape.
    """
    size = require("grey", grey, ("H", "W"))
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(np.ascontiguousarray(grey))[0]
    if found is None:
        return np.zeros((0, 4))
    ends = found.reshape(-1, 4).astype(np.float64) + 0.5
    kept = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) >= _MIN_SHARE * max(grey.shape)
    if known is not None:
        require("known", known, ("H", "W"), size)
        # The border of the unknown region makes edges in known pixels next to it.
        sure = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8))
        for share in (0.0, 0.5, 1.0):
            at = (1 - share) * ends[:, :2] + share * ends[:, 2:]
            column, row = np.clip(at.astype(int), 0, np.array(grey.shape[::-1]) - 1).T
            kept &= sure[row, column] > 0
    return ends[kept]


@dataclass(frozen=True)
class RoomTurn:
    """The rotation of one camera.

    Attributes:
        rotation_camera_from_world: (3, 3), in the world of the given rotations.
        rotation_camera_from_room: (3, 3), the room's three directions in the camera.
        sigma_deg: sigma of each of its three numbers.
        along: share of the length of its edges that is along the room's three directions.
    """

    rotation_camera_from_world: Num[np.ndarray, "3 3"]
    rotation_camera_from_room: Num[np.ndarray, "3 3"]
    sigma_deg: float
    along: float


@dataclass(frozen=True)
class _Edges:
    """Edges of one camera as planes through its centre: unit normals, weights that sum to 1, and halves.

    Each edge is in a half of each of two patterns.
    """

    normals: Num[np.ndarray, "N 3"]
    weights: Num[np.ndarray, " N"]
    halves: Bool[np.ndarray, "2 N"]


def room_turns(cameras: Mapping[int, Camera], edges: Mapping[int, Num[np.ndarray, "N 4"]]) -> dict[int, RoomTurn]:
    """view → its rotation, for the views whose ``edges`` (N, 4: ends, pixels) determine it; empty with fewer than two.

    ``cameras``: with rotations relative to one another that are right within 8°. Raises ValueError for other shapes.
    """
    planes = {v: _planes(cameras[v], edges[v]) for v in sorted(edges) if v in cameras and len(edges[v])}
    if len(planes) < 2:
        return {}
    turned = {v: cameras[v].camera_from_world[:3, :3] for v in planes}
    world_from_room = _room(list(planes.values()), [turned[v] for v in planes])
    found = {}
    for v, own in planes.items():
        turn = _turn(own, turned[v] @ world_from_room)
        if turn is not None:
            rotation, sigma_deg, along = turn
            found[v] = RoomTurn(rotation @ world_from_room.T, rotation, sigma_deg, along)
    return found if len(found) >= 2 else {}


def _planes(camera: Camera, ends: np.ndarray) -> _Edges:
    require("edges", ends, ("N", 4), finite=True)
    points = ends.reshape(-1, 2, 2)
    rays = np.concatenate(
        [(points - camera.principal_px) / np.array(camera.focal_px), np.ones((len(ends), 2, 1))], axis=-1
    )
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    normals = np.cross(rays[:, 0], rays[:, 1])
    length = np.linalg.norm(normals, axis=-1)
    nonzero = length > 0
    # Neighbouring edges have correlated errors (both sides of one window frame): halves are fields of a chessboard, and
    # stripes.
    cells = np.floor(points.mean(1) / np.array(camera.wh) * 4).astype(int)
    halves = np.stack([cells.sum(1) % 2 == 0, cells[:, 1] % 2 == 0])
    return _Edges(normals[nonzero] / length[nonzero, None], length[nonzero] / length[nonzero].sum(), halves[:, nonzero])


def edge_support(
    edges: _Edges, camera_from_room: Num[np.ndarray, "... 3 3"], width_deg: float
) -> Num[np.ndarray, " ..."]:
    """Share of the edges' length that is along one of the room's directions, to within about ``width_deg``."""
    # One matrix product per direction, and one array modified in place, because thousands of rotations are tried.
    axes = camera_from_room.reshape(-1, 3, 3)
    off = np.abs(edges.normals @ axes[:, :, 0].T)
    for k in (1, 2):
        np.minimum(off, np.abs(edges.normals @ axes[:, :, k].T), out=off)
    off /= np.radians(width_deg)
    np.square(off, out=off)
    off *= -0.5
    shares: np.ndarray = edges.weights @ np.exp(off, out=off)
    return shares.reshape(camera_from_room.shape[:-2])


def _room(edges: Sequence[_Edges], rotations: Sequence[np.ndarray]) -> np.ndarray:
    """(3, 3) world_from_room with the best support of all cameras' edges, by their given rotations."""
    tried = scipy.spatial.transform.Rotation.random(_FRAMES, np.random.default_rng(0)).as_matrix()
    wide, narrow = _ACROSS_DEG

    def total(frames: np.ndarray, width_deg: float) -> np.ndarray:
        return np.sum([edge_support(e, r @ frames, width_deg) for e, r in zip(edges, rotations)], axis=0)

    best = tried[np.argsort(-total(tried, wide), kind="stable")[:_REFINED]]
    for step_deg in (3.0, 1.5, 0.75):
        around = exp(np.radians(step_deg) * _ball(1.0, 1.0))
        near = (best[:, None] @ around[None]).reshape(-1, 3, 3)
        best = near[np.argsort(-total(near, narrow), kind="stable")[:_REFINED]]
    return best[0]


def _ball(reach: float, step: float) -> np.ndarray:
    """(M, 3) points of a grid, none further than ``reach`` along an axis."""
    along = np.arange(-reach, reach + step / 2, step)
    return np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)


def _turn(edges: _Edges, start: np.ndarray) -> tuple[np.ndarray, float, float] | None:
    """(camera_from_room, sigma in degrees, share along it) nearest ``start``; None where the edges do not determine
    it."""
    offsets = _ball(_REACH_DEG, _STEP_DEG)
    near = exp(np.radians(offsets[np.linalg.norm(offsets, axis=1) <= _REACH_DEG])) @ start
    first = near[np.argsort(-edge_support(edges, near, _COARSE_DEG[0]), kind="stable")[:_REFINED]]
    refined = np.stack([_refine_rotation(edges, r) for r in first])
    shares = edge_support(edges, refined, _FINE_DEG)
    best = refined[int(np.argmax(shares))]
    elsewhere = np.degrees(angle(refined, best[None])) > _ELSEWHERE_DEG
    if (
        shares.max() < _ALONG
        or (shares[elsewhere] > _RIVAL * shares.max()).any()
        or not _has_two_directions(edges, best)
    ):
        return None
    if np.degrees(angle(best, start)) > 1.5 * _REACH_DEG:
        return None
    parts = [
        _refine_rotation(_Edges(edges.normals[h], edges.weights[h], edges.halves[:, h]), best, held=True)
        for half in edges.halves
        for h in (half, ~half)
        if h.sum() >= _MIN_EDGES
    ]
    apart = np.degrees(log(np.stack(parts) @ best.T)) if parts else np.full((1, 3), _HELD_DEG)
    return best, float(np.hypot(np.sqrt((apart**2).mean()), _SQUARE_DEG)), float(shares.max())


def _has_two_directions(edges: _Edges, camera_from_room: np.ndarray) -> bool:
    """Whether enough edges are along two of the room's directions: one alone does not determine the rotation about
    it."""
    off = np.abs(edges.normals @ camera_from_room)
    which, near = off.argmin(1), off.min(1) < 2 * np.radians(_FINE_DEG)
    along = [near & (which == k) for k in range(3)]
    return sum(a.sum() >= _MIN_EDGES and edges.weights[a].sum() >= _ALONG_EACH for a in along) >= 2


def _refine_rotation(edges: _Edges, camera_from_room: np.ndarray, held: bool = False) -> np.ndarray:
    """The rotation with the best agreement of the edges, by Gauss-Newton from ``camera_from_room``.

    ``held``: with a prior of about 1° there, for parts of the edges that may not determine all of it.
    """
    found = camera_from_room
    for width_deg in _COARSE_DEG:
        for _ in range(6):
            off = edges.normals @ found
            k = np.abs(off).argmin(1)
            residual = off[np.arange(len(k)), k]
            weight = edges.weights * np.exp(-0.5 * (residual / np.radians(width_deg)) ** 2)
            of_turn = np.cross(found.T[k], edges.normals)
            normal = (of_turn * weight[:, None]).T @ of_turn
            side = (of_turn * weight[:, None]).T @ residual
            if held:
                pull = weight.sum() * (_FINE_DEG / _HELD_DEG) ** 2 / max(len(k), 1)
                normal = normal + pull * np.eye(3)
                side = side + pull * log(found @ camera_from_room.T)
            found = exp(-np.linalg.solve(normal + 1e-9 * np.eye(3), side)) @ found
    return found
