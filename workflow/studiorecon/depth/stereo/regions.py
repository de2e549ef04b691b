# SPDX-License-Identifier: Apache-2.0
"""Regions of a photo that neither the room nor its furniture explains get planes of their own, slanted as they may be.

Regions are superpixels of two sizes; a plane through one is looked for over all depths and directions, by correlation
of the whole region with the other photos where nothing they see hides it. Planes that explain their region clearly
better then compete with what is there for every pixel around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.stereo.labelling import label
from studiorecon.depth.stereo.patches import UNSEEN, best_plane, region_cost
from studiorecon.depth.stereo.photo_inconsistency import LEAST_PIXELS, SIZES, surface_cost, unexplained
from studiorecon.depth.stereo.plates import Picture
from studiorecon.footage.stills import shrink
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# By how much a plane's cost must be lower at least, however little there is to explain.
_LEAST_GAIN = 0.15
# Cost below which another camera's own surface is believed.
_FIRM = 0.25
# The coarse search is done at this width, where 1.5 % of the depth are about two pixels in a camera 90° away.
_SEARCH_WIDTH, _DEPTH_STEP = 160, 0.015
# Elevation of a normal in degrees, and how many all around.
_ELEVATIONS = ((0.0, 24), (35.0, 12), (-35.0, 12), (65.0, 6), (90.0, 1))
# Least cosine between a normal and the ray.
_STEEPEST = 0.2
_PLANES_PER_REGION = 2
# Cost that pixels pay for a plane of their own, and for one that no other camera can judge.
_EXTRA, _UNJUDGED, _OUTSIDE = 0.15, 0.85, 2.5
# A plane may touch the wall behind it, within the rounding of a pixel.
_BEFORE_WALL = 0.99


@dataclass(frozen=True)
class RegionView:
    """One camera's picture, its surface as depth (H, W), and (H, W) bool ``firm``: the other photos confirm it
    there."""

    picture: Picture
    depth_m: Float[np.ndarray, "H W"]
    firm: Bool[np.ndarray, "H W"]


@dataclass(frozen=True)
class Regions:
    """Planes (K, 4) n·p = o of regions, and per pixel (H, W) the number of its plane counted from 1 (0 = as it was),
    cost, and judged."""

    planes: Float[np.ndarray, "K 4"]
    chosen: Integer[np.ndarray, "H W"]
    cost: Float[np.ndarray, "H W"]
    judged: Bool[np.ndarray, "H W"]


def directions(camera: Camera, room_box: RoomBox) -> Float[np.ndarray, "M 3"]:
    """(M, 3) unit normals in the camera's axes: upright ones all around from the walls' own, leaning ones, and up."""
    normals = []
    for elevation_deg, count in _ELEVATIONS:
        yaw = room_box.yaw_rad + 2 * np.pi * np.arange(count) / count
        level, up = np.cos(np.radians(elevation_deg)), np.sin(np.radians(elevation_deg))
        normals.append(np.stack([level * np.cos(yaw), level * np.sin(yaw), np.full(count, up)], axis=-1))
    return np.concatenate(normals) @ camera.rotation_camera_from_world.T


@dataclass(frozen=True)
class Others:
    """The other cameras as the kernels of ``patches`` take them: photos, surfaces, and where this picture's pixels are
    seen.

    ``seats`` (O, 3) are their centres through this picture's lens: w·seat < 1 where a camera is on this side of a plane
    w.
    """

    photos: tuple[
        Float[np.ndarray, "O H W 3"],
        Bool[np.ndarray, "O H W"],
        Float[np.ndarray, "O H W"],
        Bool[np.ndarray, "O H W"],
        Float[np.ndarray, "O 3 3"],
        Float[np.ndarray, "O 3"],
    ]
    seats: Float[np.ndarray, "O 3"]

    @staticmethod
    def around(picture: Picture, others: Sequence[RegionView]) -> Others:
        """Padded to the largest of them."""
        height, width = np.max([o.picture.camera.hw for o in others], axis=0)
        shape = (len(others), height, width)
        rgb, known = np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
        depth_m, firm = np.zeros(shape, np.float32), np.zeros(shape, bool)
        maps, shifts, seats = [], [], []
        for k, other in enumerate(others):
            rows, columns = other.picture.camera.hw
            rgb[k, :rows, :columns], known[k, :rows, :columns] = other.picture.rgb, other.picture.known
            depth_m[k, :rows, :columns], firm[k, :rows, :columns] = other.depth_m, other.firm
            other_from_this = other.picture.camera.camera_from_world @ picture.camera.world_from_camera
            lens = other.picture.camera.intrinsics
            maps.append(lens @ other_from_this[:3, :3] @ np.linalg.inv(picture.camera.intrinsics))
            shifts.append(lens @ other_from_this[:3, 3])
            seats.append(picture.camera.intrinsics @ np.linalg.inv(other_from_this)[:3, 3])
        return Others((rgb, known, depth_m, firm, np.stack(maps), np.stack(shifts)), np.stack(seats))


def smaller(seen: RegionView, width: int) -> RegionView:
    """The same at most ``width`` pixels wide."""
    camera = seen.picture.camera
    scale = min(1.0, width / camera.wh[0])
    wh = (max(round(camera.wh[0] * scale), 8), max(round(camera.wh[1] * scale), 8))
    rgb, known = shrink(seen.picture.rgb, seen.picture.known, wh)
    depth_m, firm = (
        cv2.resize(a, wh, interpolation=cv2.INTER_NEAREST) for a in (seen.depth_m, seen.firm.astype(np.uint8))
    )
    return RegionView(Picture(camera.resized(wh), np.ascontiguousarray(rgb, np.float32), known), depth_m, firm > 0)


def propose(
    me: RegionView,
    others: Sequence[RegionView],
    room_box: RoomBox,
    regions: Sequence[Bool[np.ndarray, "H W"]],
    mean_weight: float,
    most_share: float,
    near_m: float,
) -> list[tuple[Float[np.ndarray, " 3"], int, float]]:
    """Per plane that explains its region clearly better: w (3,) in this picture, the region's number, and the gain.

    Clearly: its disagreement with the other photos is at most ``most_share`` of what it is as things are.
    """
    small = smaller(me, _SEARCH_WIDTH)
    coarse, fine = (
        Others.around(small.picture, [smaller(o, _SEARCH_WIDTH) for o in others]),
        Others.around(me.picture, others),
    )
    camera, small_camera = me.picture.camera, small.picture.camera
    wall_m, small_wall_m = (room_box.intersect(*c.rays())[0] for c in (camera, small_camera))
    lens = np.array([*small_camera.focal_px, *small_camera.principal_px])
    normals = directions(small_camera, room_box)
    all_judge = np.ones(len(others), bool)
    found = []
    for number, mask in enumerate(regions):
        pixels = _pixels(mask)
        area = cv2.resize(mask.astype(np.float32), small_camera.wh, interpolation=cv2.INTER_AREA) > 0.5
        if area.sum() < LEAST_PIXELS // 2:
            continue
        coarse_pixels = _pixels(area)
        ray = np.append((coarse_pixels.mean(axis=0) + 0.5 - lens[2:]) / lens[:2], 1.0)
        facing = normals[normals @ ray < -_STEEPEST * np.linalg.norm(ray)]
        farthest = float(np.median(small_wall_m[area]))
        if farthest <= near_m or not len(facing):
            continue
        depths = near_m * np.exp(np.arange(0, np.log(farthest / near_m), _DEPTH_STEP))
        bound = 1 / np.maximum(small_wall_m[area], 1e-6)
        planes = best_plane(
            lens,
            facing,
            depths,
            small.picture.rgb,
            coarse_pixels,
            bound,
            *coarse.photos,
            coarse.seats,
            mean_weight,
            _PLANES_PER_REGION,
        )
        inverse = 1 / np.maximum(me.depth_m[mask].astype(np.float64), 1e-6)
        bound = 1 / np.maximum(wall_m[mask], 1e-6)
        now = region_cost(me.picture.rgb, pixels, inverse, bound, *fine.photos, all_judge, mean_weight)
        for w in planes[planes[:, 3] < UNSEEN, :3]:
            # Columns and rows of the small picture are those of this one times the ratio of the sizes.
            w = w * np.array([small_camera.wh[0] / camera.wh[0], small_camera.wh[1] / camera.wh[1], 1.0])
            inverse = (pixels + 0.5) @ w[:2] + w[2]
            cost = region_cost(me.picture.rgb, pixels, inverse, bound, *fine.photos, fine.seats @ w < 0.98, mean_weight)
            if cost <= most_share * now and cost <= now - _LEAST_GAIN:
                found.append((w, number, float(now - cost)))
    return found


def _pixels(mask: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.argwhere(mask)[:, ::-1])


def world_plane(camera: Camera, w: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 4"]:
    """(4,) n·p = o of the plane with inverse depth w·(column, row, 1)."""
    along = camera.intrinsics.T @ w
    length = np.linalg.norm(along)
    return np.append(camera.rotation_camera_from_world.T @ along, 1 - along @ camera.camera_from_world[:3, 3]) / length


def explain_regions(
    pictures: Sequence[Picture],
    index: int,
    depths: Sequence[Float[np.ndarray, "H W"]],
    room_box: RoomBox,
    *,
    window: int,
    mean_weight: float,
    penalty: float,
    near_m: float,
    most_share: float,
    most: int,
) -> Regions:
    """At most ``most`` planes for regions of one picture, given every picture's depth (H, W) so far; none without
    another camera.

    Costs about 1.5 s at 320×176 with four cameras.
    """
    picture = pictures[index]
    hw = picture.camera.hw
    nothing = Regions(np.zeros((0, 4)), np.zeros(hw, np.int32), np.zeros(hw, np.float32), np.zeros(hw, bool))
    if len(pictures) < 2:
        return nothing
    looks = list(zip(pictures, depths))
    costs = [
        surface_cost(p, d, [o for j, o in enumerate(looks) if j != i], window, mean_weight)
        for i, (p, d) in enumerate(looks)
    ]
    seen = [
        RegionView(p, d.astype(np.float32), judged & (cost < _FIRM)) for (p, d), (cost, judged) in zip(looks, costs)
    ]
    others = [s for i, s in enumerate(seen) if i != index]
    cost, judged = costs[index]
    regions = unexplained(picture, cost, window)
    found = sorted(
        propose(seen[index], others, room_box, regions, mean_weight, most_share, near_m), key=lambda f: -f[2]
    )[:most]
    if not found:
        return nothing
    planes, areas = [w for w, *_ in found], [regions[number] for _, number, _ in found]
    volume, sees = _volume(
        picture, [(o.picture, o.depth_m) for o in others], room_box, areas, planes, cost, judged, window, mean_weight
    )
    chosen = label(volume, picture.rgb, penalty)
    chosen_cost, chosen_judged = (np.take_along_axis(a, chosen[..., None], axis=-1)[..., 0] for a in (volume, sees))
    return Regions(np.array([world_plane(picture.camera, w) for w in planes]), chosen, chosen_cost, chosen_judged)


def _volume(
    picture: Picture,
    others: Sequence[tuple[Picture, np.ndarray]],
    room_box: RoomBox,
    areas: Sequence[np.ndarray],
    planes: Sequence[np.ndarray],
    cost: np.ndarray,
    judged: np.ndarray,
    window: int,
    mean_weight: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 1 + K) cost of staying and of every plane w (3,) around its area (H, W), and (H, W, 1 + K) bool judged."""
    height, width = cost.shape
    volume = np.full((height, width, 1 + len(planes)), _OUTSIDE, np.float32)
    sees = np.zeros(volume.shape, bool)
    volume[..., 0], sees[..., 0] = cost, judged
    wall_m = room_box.intersect(*picture.camera.rays())[0]
    margin = max(round(SIZES[0] * width), 4)
    for k, (w, area) in enumerate(zip(planes, areas), start=1):
        rows, columns = np.flatnonzero(area.any(axis=1)), np.flatnonzero(area.any(axis=0))
        top, bottom = max(rows[0] - margin, 0), min(rows[-1] + margin + 1, height)
        left, right = max(columns[0] - margin, 0), min(columns[-1] + margin + 1, width)
        lens = picture.camera.intrinsics.copy()
        lens[:2, 2] -= left, top
        part = np.s_[top:bottom, left:right]
        crop = Picture(
            replace(picture.camera, wh=(right - left, bottom - top), intrinsics=lens),
            picture.rgb[part],
            picture.known[part],
        )
        inverse = picture.camera.pixel_centres()[part] @ w[:2] + w[2]
        inside = inverse * wall_m[part] > _BEFORE_WALL
        depth_m = np.where(inside, 1 / np.where(inside, inverse, 1.0), 0.0)
        price, seen = surface_cost(crop, depth_m, others, window, mean_weight)
        volume[(*part, k)] = np.where(inside, np.where(seen, price, _UNJUDGED) + _EXTRA, _OUTSIDE)
        sees[(*part, k)] = seen & inside
    return volume, sees
