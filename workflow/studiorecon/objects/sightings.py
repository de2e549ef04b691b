# SPDX-License-Identifier: Apache-2.0
"""Positions of objects at one moment: regions of all cameras whose rays meet at one distance and with one size.

An object's outline is modelled as that of a sphere of its size: rays through the outline pass its middle at the radius.
That holds for the visible part of an outline, so a hand or a person in front lowers the precision but does not bias the
middle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.objects.residual import ROOM, ResidualRegion
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Largest ratio of one object's radii in two cameras; larger for a region next to a person, who hides a part.
_ONE_SIZE, _ONE_SIZE_HIDDEN = 1.7, 3.5
# Sigma of an outline in pixels, and how many of these count in full; steps of the fit of middle and radius.
_OUTLINE_PX, _HUBER, _STEPS = 0.7, 2.0, 12
# Least number of outline points of a camera that determine a position.
_MIN_POINTS = 6
_NEAR_M = 0.1


@dataclass(frozen=True)
class Sighting:
    """An object at one moment: middle, radius, and region by view; ``free`` counts views without occlusion."""

    centre_m: Float[np.ndarray, " 3"]
    radius_m: float
    regions: Mapping[int, ResidualRegion]

    @property
    def free(self) -> int:
        return sum(region.free for region in self.regions.values())


def find_sightings(
    cameras: Sequence[Camera],
    states: Sequence[Integer[np.ndarray, "H W"]],
    regions: Sequence[Sequence[ResidualRegion]],
    gate_m: float,
    radius_m: tuple[float, float],
) -> list[Sighting]:
    """Objects of one moment that at least two cameras show, best first; at most one of three may see room there.

    ``states`` are every camera's ``residual.pixel_states``; rays of one object pass within ``gate_m``.
    """
    candidates = []
    for first, second in combinations(range(len(cameras)), 2):
        for a in regions[first]:
            for b in regions[second]:
                centre, apart_m = _nearest_point(cameras[first], a, cameras[second], b)
                if centre is not None and apart_m <= gate_m:
                    candidates.append((centre, apart_m, (a, b)))
    found: list[tuple[float, float, Sighting]] = []
    for centre, apart_m, pair in candidates:
        sizes = [_radius_m(cameras[r.view], r, centre) for r in pair]
        size = max(sizes) if not all(r.free for r in pair) else float(np.mean(sizes))
        if not radius_m[0] <= size <= radius_m[1] or not all(_fits(s, size, r) for s, r in zip(sizes, pair)):
            continue
        support = _support(cameras, regions, centre, size, gate_m)
        if any(support.get(r.view) is not r for r in pair):
            continue
        against = sum(
            _contradicts(c, s, centre, size) for v, (c, s) in enumerate(zip(cameras, states)) if v not in support
        )
        if len(support) >= 2 and (against == 0 or (against == 1 and len(support) >= 3)):
            found.append((-len(support) + against, apart_m, Sighting(centre, size, support)))
    chosen: list[Sighting] = []
    for _, _, sighting in sorted(found, key=lambda f: f[:2]):
        if not any(sighting.regions[v] is other.regions.get(v) for other in chosen for v in sighting.regions):
            chosen.append(sighting)
    return chosen


def fit_sphere(
    cameras: Sequence[Camera], sighting: Sighting, radius_m: float | None = None
) -> tuple[Float[np.ndarray, " 3"], float, float]:
    """Middle and radius of the sphere that best fits a sighting's outlines, and their root mean square error in pixels.

    ``radius_m`` fixes the radius. NaN where no two cameras show enough of an outline, or the fit diverges.
    """
    origins, rays, spread_m, weights = [], [], [], []
    for view, region in sorted(sighting.regions.items()):
        if len(region.outline_px) < _MIN_POINTS:
            continue
        camera = cameras[view]
        along = camera.unproject(region.outline_px, np.ones(len(region.outline_px))) - camera.centre_m
        depth_m = float(camera.project(sighting.centre_m)[1])
        count = len(along)
        origins.append(np.broadcast_to(camera.centre_m, (count, 3)))
        rays.append(along / np.linalg.norm(along, axis=1, keepdims=True))
        spread_m.append(np.full(count, _OUTLINE_PX * depth_m / camera.focal_px[0]))
        weights.append(np.full(count, 1 / count))
    nothing = np.full(3, np.nan), float("nan"), float("nan")
    if len(rays) < 2:
        return nothing
    origin, ray, spread, weight = (np.concatenate(part) for part in (origins, rays, spread_m, weights))
    centre, radius = sighting.centre_m.astype(np.float64), sighting.radius_m if radius_m is None else radius_m
    for _ in range(_STEPS):
        away = centre - origin
        across = away - (away * ray).sum(1, keepdims=True) * ray
        distance = np.maximum(np.linalg.norm(across, axis=1), 1e-9)
        error = (distance - radius) / spread
        robust = weight * np.minimum(1.0, _HUBER / np.maximum(np.abs(error), 1e-9))
        slope = np.concatenate(
            [across / distance[:, None], -np.ones((len(ray), 0 if radius_m is not None else 1))], axis=1
        )
        slope /= spread[:, None]
        normal = slope.T @ (robust[:, None] * slope)
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(len(normal)), -slope.T @ (robust * error))
        centre = centre + step[:3]
        radius = radius + float(step[3]) if radius_m is None else radius
    if (
        not np.isfinite(centre).all()
        or radius <= 0
        or np.linalg.norm(centre - sighting.centre_m) > 2 * sighting.radius_m
    ):
        return nothing
    return centre, radius, float(_OUTLINE_PX * np.sqrt((robust * error**2).sum() / robust.sum()))


def _nearest_point(one: Camera, a: ResidualRegion, two: Camera, b: ResidualRegion) -> tuple[np.ndarray | None, float]:
    """Middle of the shortest line between two regions' rays, and its length; None behind a camera, or if parallel."""
    u, v = (c.unproject(r.centre_px, np.ones(())) - c.centre_m for c, r in ((one, a), (two, b)))
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    between, cosine = two.centre_m - one.centre_m, float(u @ v)
    sine2 = 1 - cosine**2
    if sine2 < 1e-3:
        return None, np.inf
    s, t = (u @ between - cosine * (v @ between)) / sine2, (cosine * (u @ between) - v @ between) / sine2
    if min(s, t) < _NEAR_M:
        return None, np.inf
    p, q = one.centre_m + s * u, two.centre_m + t * v
    return (p + q) / 2, float(np.linalg.norm(p - q))


def _radius_m(camera: Camera, region: ResidualRegion, centre_m: np.ndarray) -> float:
    return float(np.sqrt(region.area_px / np.pi) * camera.project(centre_m)[1] / camera.focal_px[0])


def _fits(size_m: float, expected_m: float, region: ResidualRegion) -> bool:
    low = _ONE_SIZE if region.free else _ONE_SIZE_HIDDEN
    return expected_m / low <= size_m <= expected_m * _ONE_SIZE


def _support(
    cameras: Sequence[Camera],
    regions: Sequence[Sequence[ResidualRegion]],
    centre_m: np.ndarray,
    size_m: float,
    gate_m: float,
) -> dict[int, ResidualRegion]:
    """The region by view that shows an object at a position; views without one are missing."""
    support = {}
    for view, (camera, own) in enumerate(zip(cameras, regions)):
        pixel, depth_m = camera.project(centre_m)
        if depth_m <= _NEAR_M:
            continue
        near = []
        for region in own:
            off_m = float(np.linalg.norm(region.centre_px - pixel) * depth_m / camera.focal_px[0])
            reach_m = gate_m if region.free else max(gate_m, size_m)
            if off_m <= reach_m and _fits(_radius_m(camera, region, centre_m), size_m, region):
                near.append((off_m, region))
        if near:
            support[view] = min(near, key=lambda n: n[0])[1]
    return support


def _contradicts(camera: Camera, state: np.ndarray, centre_m: np.ndarray, size_m: float) -> bool:
    """Whether a camera sees the room at an object's position: in most of the square inside its disc."""
    pixel, depth_m = camera.project(centre_m)
    if depth_m <= _NEAR_M:
        return False
    half = 0.6 * size_m * camera.focal_px[0] / depth_m
    low, high = np.floor(pixel - half).astype(int), np.ceil(pixel + half).astype(int)
    if (low < 0).any() or (high > camera.wh).any():
        return False
    return bool((state[low[1] : high[1], low[0] : high[0]] == ROOM).mean() > 0.5)
