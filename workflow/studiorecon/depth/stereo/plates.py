# SPDX-License-Identifier: Apache-2.0
"""The plates prepared for stereo: at its working size, with equal exposure; the floor, and the yaw of the walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.stereo.matching import UNKNOWN, correlate, plane_depth, plane_homography, plane_inverse_depth
from studiorecon.depth.sweep_settings import Matching
from studiorecon.footage.stills import read_plate, shrink_plate
from studiorecon.images.channels import channel_sum
from studiorecon.images.exposure import compare_colours, solve_gains
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import require_one_each

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Correlation above which a floor pixel counts as floor in both views, as measured on synthetic rooms.
_SAME_SURFACE = 0.6
_FLOOR_SEARCH_M = 0.12
_FLOOR_STEP_M = 0.03
_MIN_PIXELS = 60
_SAME_DEPTH = 0.02
# Variance (summed over channels) of a window above sensor noise: 8 grey levels of 255 in one channel.
_MIN_VARIANCE = 1e-3


@dataclass(frozen=True)
class Picture:
    """One training camera's plate: its camera at this size, (H, W, 3) float32 RGB and (H, W) bool ``known``."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    known: Bool[np.ndarray, "H W"]

    def depth(self, plane: Float[np.ndarray, " 4"], how: Matching) -> Float[np.ndarray, "H W"]:
        """Z-depth of a plane in this picture; 0 out of range."""
        return plane_depth(self.camera, plane, how.near_m, how.far_m)

    def plane_depths_of_pixels(self, planes: Float[np.ndarray, "H W 4"]) -> Float[np.ndarray, "H W"]:
        """Z-depth of a plane of its own for every pixel; 0 where the ray does not meet it."""
        origin, rays = self.camera.rays()
        along = (planes[..., :3] * rays).sum(axis=-1)
        ahead = planes[..., 3] - planes[..., :3] @ origin
        depth_m = ahead / np.where(np.abs(along) < 1e-9, np.inf, along)
        return np.maximum(depth_m, 0.0)

    def textured(self, window: int) -> Bool[np.ndarray, "H W"]:
        """Whether the window around a pixel is not flat. A flat one matches every plane, so it votes for none."""
        mean, square = (cv2.blur(image, (window, window)) for image in (self.rgb, self.rgb * self.rgb))
        return channel_sum(square - mean * mean) > _MIN_VARIANCE

    def score(self, other: Picture, plane: Float[np.ndarray, " 4"], how: Matching) -> Float[np.ndarray, "H W"]:
        """Agreement with another picture through a plane: correlation - mean_weight · difference of means, ≤ 1.

        ``UNKNOWN`` where the plane is out of range, outside the other picture, or either picture is not ``known``.
        """
        score, weights = np.full(self.camera.hw, UNKNOWN, np.float32), plane_inverse_depth(self.camera, plane)
        if weights is not None:
            through = plane_homography(self.camera, other.camera, weights), weights
            pair, window = (self.rgb, self.known, other.rgb, other.known), (how.window // 2, how.mean_weight)
            correlate(*pair, *through, *window, how.near_m, how.far_m, score)
        return score


def best_score(
    pictures: Sequence[Picture], index: int, plane: Float[np.ndarray, " 4"], how: Matching
) -> Float[np.ndarray, "H W"]:
    """Float32 agreement of one picture with the other that agrees best; ``UNKNOWN`` where none is comparable.

    Best, not mean: most surfaces are hidden from most cameras, and one that truly sees the surface is enough.
    """
    best = np.full(pictures[index].known.shape, UNKNOWN, np.float32)
    for j, other in enumerate(pictures):
        if j != index:
            best = np.maximum(best, pictures[index].score(other, plane, how))
    return best


def read_pictures(cameras: Sequence[Camera], plates: Sequence[Path], width: int) -> list[Picture]:
    """The plates at most ``width`` pixels wide; raises UserError when a plate does not have its camera's size."""
    require_one_each(cameras, plates=plates)
    pictures = []
    for camera, path in zip(cameras, plates):
        rgb, measured = read_plate(path, camera.wh)
        scale = min(1.0, width / camera.wh[0])
        wh = (max(round(camera.wh[0] * scale), 8), max(round(camera.wh[1] * scale), 8))
        pictures.append(Picture(camera.resized(wh), *shrink_plate(rgb, measured, wh)))
    return pictures


def floor_and_gains(pictures: Sequence[Picture], how: Matching) -> tuple[float, Float[np.ndarray, "V 3"], int]:
    """Height of the floor near z = 0, exposure gains, and the number of camera pairs that shared floor.

    The floor is the one surface whose position is known beforehand. Gains are estimated before any depth, because
    unequal exposure ruins the matching costs (44 % instead of 86 % of pixels within 5 % at ±12 %).
    """
    how = replace(how, window=how.window + 2, mean_weight=0.0)
    candidates = np.arange(-_FLOOR_SEARCH_M, _FLOOR_SEARCH_M + 1e-9, _FLOOR_STEP_M)
    pairs = [(i, j) for i in range(len(pictures)) for j in range(len(pictures)) if i != j]

    def scores(height_m: float) -> list[np.ndarray]:
        plane = np.array([0.0, 0.0, 1.0, height_m])
        return [pictures[i].score(pictures[j], plane, how) for i, j in pairs]

    support = [
        sum(float(np.clip(s[s > UNKNOWN] - 0.3, 0, None).sum()) for s in scores(height)) for height in candidates
    ]
    floor_m = float(candidates[int(np.argmax(support))]) if max(support, default=0.0) > 0 else 0.0
    overlaps = []
    for (i, j), score in zip(pairs, scores(floor_m)):
        agree = score > _SAME_SURFACE
        if agree.sum() < _MIN_PIXELS:
            continue
        depth_m = pictures[i].depth(np.array([0.0, 0.0, 1.0, floor_m]), how)
        points = pictures[i].camera.unproject(pictures[i].camera.pixel_centres(), depth_m)[agree]
        colours, inside = sample(pictures[j].rgb, pictures[j].camera.project(points)[0][None])
        overlap = compare_colours(i, j, pictures[i].rgb[agree][inside[0]], colours[0][inside[0]], _MIN_PIXELS)
        if overlap is not None:
            overlaps.append(overlap)
    return floor_m, solve_gains(len(pictures), overlaps), len(overlaps)


def surface_gains(
    pictures: Sequence[Picture], depths_m: Sequence[Float[np.ndarray, "H W"]], window: int
) -> tuple[Float[np.ndarray, "V 3"], int]:
    """Remaining gains between the pictures on every surface that two of them see, and how many pairs saw one.

    Once depth is agreed, walls and furniture compare as well as the floor. A pixel counts when both depth maps put it
    at the same place within 2 %.
    """
    overlaps = []
    for i, (picture, depth_m) in enumerate(zip(pictures, depths_m)):
        known = picture.known & (depth_m > 0)
        if not known.any():
            continue
        points = picture.camera.unproject(
            picture.camera.pixel_centres(), np.where(known, depth_m, 1.0).astype(np.float64)
        )[known]
        for j, (other, other_depth_m) in enumerate(zip(pictures, depths_m)):
            if i == j:
                continue
            pixels, z = other.camera.project(points)
            seen, inside = sample(other_depth_m, pixels[None], "nearest")
            same = inside[0] & (np.abs(seen[0] - z) < _SAME_DEPTH * np.where(z > 0, z, np.nan))
            colours = sample(cv2.blur(other.rgb, (window, window)), pixels[None])[0][0]
            mine = cv2.blur(picture.rgb, (window, window))[known]
            overlap = compare_colours(i, j, mine[same], colours[same], _MIN_PIXELS)
            if overlap is not None:
                overlaps.append(overlap)
    return solve_gains(len(pictures), overlaps), len(overlaps)


def equalise_exposure(pictures: Sequence[Picture], gains: Float[np.ndarray, "V 3"]) -> list[Picture]:
    """The pictures with their exposure gains divided out."""
    return [replace(p, rgb=np.clip(p.rgb / gain, 0, 1).astype(np.float32)) for p, gain in zip(pictures, gains)]
