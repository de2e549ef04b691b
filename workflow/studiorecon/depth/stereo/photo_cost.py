# SPDX-License-Identifier: Apache-2.0
"""Cost of all photos' pixels for a room with primitives in it, and its change by one more primitive.

A pixel's surface is seen by other cameras or hidden from them; those that see it must show the same colours (windowed
correlation over the pixels of one surface). So a primitive gains by its faces that match and by wrong matches behind it
that it hides, and loses by every right match that it hides. Parts that no other camera sees gain nothing by matching.
Regions that differ from the wall behind may extend matched ones, or form an object on the floor that is seen without
occlusion (``self_dissimilarity``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.stereo.kernels import FIRST, draw_primitive, explain_all, invert_visibility
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.stereo.self_dissimilarity import foreground_log_odds
from studiorecon.depth.stereo.trial_kernels import trial_gains
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Another camera confirms a surface below this cost. At it, a tenth of a made room's pixels are more than 5 % off
# (2 % at 0.3, a quarter at 0.8).
MAX_CONFIRMED_COST = 0.5
# Pixels that show a real object cost less than before by a tenth at least in rooms whose tables match worst; by
# nothing, on ten thousand pixels, in a real room whose floor is lower than assumed.
_MIN_BETTER = 0.05


@dataclass(frozen=True)
class Surface:
    """Any surface in one picture: depth (0 = none), its cost by photos, and where another camera compares it."""

    depth_m: Float[np.ndarray, "H W"]
    cost: Float[np.ndarray, "H W"]
    compared: Bool[np.ndarray, "H W"]

    @property
    def confirmed(self) -> Bool[np.ndarray, "H W"]:
        """Pixels that another camera confirms."""
        return self.compared & (self.cost < MAX_CONFIRMED_COST)


@dataclass
class PhotoCostVolume:
    """All views as explained by the current primitives; arrays are (V, H, W), padded to the largest picture.

    Attributes:
        lens: focal lengths and principal point, pixels. pose: camera_from_world. centre: (V, 3)
            metres.
        rgb, known: the photos. depth: z-depth of the explaining surface, metres. surface: its number.
        pair: cost of the surface in another camera, -1 where they cannot be compared.
        at, z: (V, V, H, W) flat pixel in the other camera, and depth there.
        begin, dependents: (V, H W + 1) and (V, V H W): the pixels whose cost depends on each pixel
            (``kernels.invert_visibility``).
        cost: cost of every pixel; 0 where the photo is not known.
        view_count: number of other cameras that see its surface.
        half, mean_weight: half a window in pixels, weight of a difference of means.
        floor_m: height of the floor.
        empty_room: depth and surface of the room box alone.
        foreground_log_odds: ``self_dissimilarity.foreground_log_odds`` of the room box alone.
        primitives: those added so far.
    """

    lens: Float[np.ndarray, "V 4"]
    pose: Float[np.ndarray, "V 3 4"]
    centre: Float[np.ndarray, "V 3"]
    rgb: Float[np.ndarray, "V H W 3"]
    known: Bool[np.ndarray, "V H W"]
    depth: Float[np.ndarray, "V H W"]
    surface: Integer[np.ndarray, "V H W"]
    pair: Float[np.ndarray, "V V H W"]
    at: Integer[np.ndarray, "V V H W"]
    z: Float[np.ndarray, "V V H W"]
    begin: Integer[np.ndarray, "V S"]
    dependents: Integer[np.ndarray, "V T"]
    cost: Float[np.ndarray, "V H W"]
    view_count: Integer[np.ndarray, "V H W"]
    half: int
    mean_weight: float
    floor_m: float
    empty_room: tuple[Float[np.ndarray, "V H W"], Integer[np.ndarray, "V H W"]]
    foreground_log_odds: Float[np.ndarray, "V H W"]
    primitives: Float[np.ndarray, "K 7"]

    @staticmethod
    def of_empty_room(
        pictures: Sequence[Picture], room_box: RoomBox, window: int, mean_weight: float, looks: bool = True
    ) -> PhotoCostVolume:
        """The empty room: every pixel on the room box. Without ``looks`` the foreground log-odds are 0."""
        count = len(pictures)
        height, width = np.max([p.camera.hw for p in pictures], axis=0)
        shape = (count, height, width)
        rgb, known = np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
        depth_m, surface = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
        for v, picture in enumerate(pictures):
            rows, columns = picture.camera.hw
            length_m, face = room_box.intersect(*picture.camera.rays())
            rgb[v, :rows, :columns], known[v, :rows, :columns] = picture.rgb, picture.known & (face >= 0)
            depth_m[v, :rows, :columns], surface[v, :rows, :columns] = length_m, face
        lens = np.array([[*p.camera.focal_px, *p.camera.principal_px] for p in pictures])
        pose, centre = (
            np.stack([p.camera.camera_from_world[:3] for p in pictures]),
            np.stack([p.camera.centre_m for p in pictures]),
        )
        pair, at, z = (np.zeros((count, *shape), kind) for kind in (np.float32, np.int32, np.float32))
        cost, view_count, odds = (np.zeros(shape, kind) for kind in (np.float32, np.uint8, np.float32))
        empty_room = depth_m.copy(), surface.copy()
        room = PhotoCostVolume(
            lens,
            pose,
            centre,
            rgb,
            known,
            depth_m,
            surface,
            pair,
            at,
            z,
            np.zeros((count, 1), np.int64),
            np.zeros((count, 0), np.int32),
            cost,
            view_count,
            window // 2,
            mean_weight,
            float(room_box.low_m[2]),
            empty_room,
            odds,
            np.zeros((0, 7)),
        )
        room.replace_all(room.primitives)
        if looks:
            for own, unlike in zip(room.foreground_log_odds, foreground_log_odds(pictures, room_box)):
                own[: unlike.shape[0], : unlike.shape[1]] = unlike
        return room

    def nearest(self, view: int, hw: tuple[int, int]) -> tuple[Surface, Integer[np.ndarray, "h w"]]:
        """The surfaces that one view of ``hw`` pixels sees, and their numbers."""
        depth_m, cost, view_count, number = (
            a[view, : hw[0], : hw[1]].copy() for a in (self.depth, self.cost, self.view_count, self.surface)
        )
        return Surface(depth_m, cost, view_count > 0), number

    def of_depth(self, view: int, depth_m: Float[np.ndarray, "h w"]) -> Surface:
        """Any depth map of one view, compared by the others where their own surfaces do not hide it."""
        rows, columns = depth_m.shape
        depth = self.depth.copy()
        depth[view] = 0
        depth[view, :rows, :columns] = depth_m
        known = self.known & (depth > 0)
        pair, at, z, cost, view_count = (
            np.zeros_like(a) for a in (self.pair, self.at, self.z, self.cost, self.view_count)
        )
        surface, how = np.zeros_like(self.surface), (self.half, self.mean_weight)
        explain_all(
            self.lens, self.pose, self.centre, self.rgb, known, depth, surface, pair, at, z, cost, view_count, *how
        )
        return Surface(depth_m, cost[view, :rows, :columns], view_count[view, :rows, :columns] > 0)

    def gains(self, primitives: Float[np.ndarray, "N 7"], looks: bool = True) -> Float[np.ndarray, " N"]:
        """Decrease of all pixels' cost with each of the primitives added alone; without ``looks`` by agreement only."""
        return self._gains_and_costs(primitives, looks)[:, 0]

    def is_contradicted(self, primitive: Float[np.ndarray, " 7"]) -> bool:
        """Whether the pixels that show a primitive match no better than before, so that it only hides wrong matches.

        A wall or floor in the wrong place matches nothing, and everything that hides it explains the photos better.
        """
        _, better, was = self._gains_and_costs(np.asarray(primitive)[None], looks=False)[0]
        return bool(better < _MIN_BETTER * was)

    def _gains_and_costs(self, primitives: Float[np.ndarray, "N 7"], looks: bool) -> Float[np.ndarray, "N 3"]:
        """Gains, their part on pixels that show the primitives, and those pixels' cost before."""
        odds = self.foreground_log_odds if looks else np.zeros_like(self.foreground_log_odds)
        explained = (
            self.depth,
            self.surface,
            self.pair,
            self.at,
            self.z,
            self.begin,
            self.dependents,
            self.cost,
            odds,
        )
        tried = np.ascontiguousarray(primitives, np.float64)
        return trial_gains(self._photos, explained, self.half, self.mean_weight, self.floor_m, tried)

    @property
    def _photos(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return self.lens, self.pose, self.centre, self.rgb, self.known

    def replace_all(self, primitives: Float[np.ndarray, "K 7"]) -> None:
        """Explain the room with these primitives and no other."""
        self.primitives = np.ascontiguousarray(primitives, np.float64).reshape(-1, 7)
        self.depth[:], self.surface[:] = self.empty_room
        for k, primitive in enumerate(self.primitives):
            draw_primitive(
                self.lens, self.pose, self.centre, self.known, self.depth, self.surface, primitive, FIRST + 10 * k
            )
        explain_all(
            *self._photos,
            self.depth,
            self.surface,
            self.pair,
            self.at,
            self.z,
            self.cost,
            self.view_count,
            self.half,
            self.mean_weight,
        )
        self.begin, self.dependents = invert_visibility(self.known, self.depth, self.pair, self.at, self.z)

    def add(self, primitive: Float[np.ndarray, " 7"]) -> None:
        """Add one primitive."""
        self.replace_all(np.concatenate([self.primitives, np.asarray(primitive, np.float64)[None]]))
