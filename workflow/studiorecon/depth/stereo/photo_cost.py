# SPDX-License-Identifier: Apache-2.0
"""Cost of all photos' pixels for a room with primitives in it, and its change by one more primitive.

A pixel's surface is seen by other cameras or hidden from them; those that see it must show the same colours (windowed
correlation over the pixels of one surface). So a primitive gains by its faces that match and by wrong matches behind it
that it hides, and loses by every right match that it hides. What it hides gains no more than its faces: where a floor
is in the wrong place, all that hides it would gain. Parts that no other camera sees gain nothing by matching. Regions
that differ from the wall behind may extend matched ones, or form an object on the floor that is seen without occlusion
(``self_dissimilarity``).
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


def _corner(view: int, hw: tuple[int, ...]) -> tuple[int, slice, slice]:
    """Where the pixels of a view are in padded arrays."""
    return view, slice(hw[0]), slice(hw[1])


class PhotoCostVolume:
    """All views as explained by the room box and primitives; arrays are (V, H, W), padded to the largest picture.

    Attributes:
        lens, pose, centre: focal lengths and principal point (pixels), camera_from_world, place (metres).
        rgb, known: the photos.
        depth, surface: z-depth of the explaining surface, metres, and its number.
        pair: (V, V, H, W) cost of the surface in another camera, -1 where they cannot be compared.
        at, z: (V, V, H, W) flat pixel in the other camera, and depth there.
        cost, view_count: of every pixel, 0 where the photo is not known, and the number of other cameras that see its
            surface.
        begin, dependents: the pixels whose cost depends on each pixel (``kernels.invert_visibility``).
        foreground_log_odds: ``self_dissimilarity.foreground_log_odds`` of the room box alone.
        mean_weight, floor_m: weight of a difference of means, and height of the floor.
        primitives: (K, 7), those added so far.
    """

    def __init__(
        self, pictures: Sequence[Picture], room_box: RoomBox, window: int, mean_weight: float, looks: bool = True
    ) -> None:
        """The empty room: every pixel on the room box. Without ``looks`` the foreground log-odds are 0."""
        shape = (len(pictures), *np.max([p.camera.hw for p in pictures], axis=0))
        self.rgb, self.known = np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
        self._box_m, self._face = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
        self.foreground_log_odds, self._how = np.zeros(shape, np.float32), (window // 2, mean_weight)
        self.mean_weight, self.floor_m = mean_weight, float(room_box.low_m[2])
        odds = foreground_log_odds(pictures, room_box) if looks else [0.0] * len(pictures)
        for v, picture in enumerate(pictures):
            own = _corner(v, picture.camera.hw)
            self._box_m[own], self._face[own] = room_box.intersect(*picture.camera.rays())
            self.rgb[own], self.known[own] = picture.rgb, picture.known & (self._face[own] >= 0)
            self.foreground_log_odds[own] = odds[v]
        self.lens = np.array([[*p.camera.focal_px, *p.camera.principal_px] for p in pictures])
        self.pose = np.stack([p.camera.camera_from_world[:3] for p in pictures])
        self.centre = np.stack([p.camera.centre_m for p in pictures])
        self.replace_all(np.zeros((0, 7)))

    def nearest(self, view: int, hw: tuple[int, int]) -> tuple[Surface, Integer[np.ndarray, "h w"]]:
        """The surfaces that one view of ``hw`` pixels sees, and their numbers."""
        depth_m, cost, view_count, number = (
            a[_corner(view, hw)].copy() for a in (self.depth, self.cost, self.view_count, self.surface)
        )
        return Surface(depth_m, cost, view_count > 0), number

    def of_depth(self, view: int, depth_m: Float[np.ndarray, "h w"]) -> Surface:
        """Any depth map of one view, compared by the others where their own surfaces do not hide it."""
        own, depth = _corner(view, depth_m.shape), self.depth.copy()
        depth[view] = 0
        depth[own] = depth_m
        photos = self.lens, self.pose, self.centre, self.rgb, self.known & (depth > 0)
        *_, cost, view_count = explain_all(*photos, depth, np.zeros_like(self.surface), *self._how)
        return Surface(depth_m, cost[own], view_count[own] > 0)

    def gains(self, primitives: Float[np.ndarray, "N 7"], thin: bool = False) -> Float[np.ndarray, " N"]:
        """Decrease of all pixels' cost with each of the primitives added alone; ``thin``: too thin to match."""
        judged = (self.pair, self.at, self.z, self.begin, self.dependents, self.cost)
        explained = (self.depth, self.surface, *judged, self.foreground_log_odds)
        tried = np.ascontiguousarray(primitives, np.float64)
        return trial_gains(self._photos, explained, *self._how, self.floor_m, tried, thin)

    @property
    def _photos(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return self.lens, self.pose, self.centre, self.rgb, self.known

    def replace_all(self, primitives: Float[np.ndarray, "K 7"]) -> None:
        """Explain the room with these primitives and no other."""
        self.primitives = np.ascontiguousarray(primitives, np.float64).reshape(-1, 7)
        self.depth, self.surface = self._box_m.copy(), self._face.copy()
        for k, primitive in enumerate(self.primitives):
            views = self.lens, self.pose, self.centre, self.known
            draw_primitive(*views, self.depth, self.surface, primitive, FIRST + 10 * k)
        found = explain_all(*self._photos, self.depth, self.surface, *self._how)
        self.pair, self.at, self.z, self.cost, self.view_count = found
        self.begin, self.dependents = invert_visibility(self.known, self.depth, self.pair, self.at, self.z)

    def add(self, primitive: Float[np.ndarray, " 7"]) -> None:
        """Add one primitive."""
        self.replace_all(np.concatenate([self.primitives, np.asarray(primitive, np.float64)[None]]))
