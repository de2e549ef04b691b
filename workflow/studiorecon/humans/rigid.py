# SPDX-License-Identifier: Apache-2.0
"""The shape and colours of a thing that was followed: discs on the hull of its outlines over all frames, trained on crops around it.

All pictures are taken as seen from the thing: its translation is taken out of the cameras, so that one still set of Gaussians is trained
on all frames. It is taken not to turn; where it does, its colours and its hull are the mean of what was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from studiorecon.humans.following import Track
from studiorecon.humans.loose import LOOSE, ROOM, UNKNOWN, Region, outline_of
from studiorecon.images.video import to_float
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.discs import discs
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.splatting.perceptual import PerceptualSettings
from studiorecon.splatting.rasterise import Rasteriser
from studiorecon.splatting.schedule import TrainingSettings
from studiorecon.splatting.targets import Target
from studiorecon.splatting.training import train

# Looks that are trained on, spread over the track; every so-many-th is kept apart to judge.
_LOOKS, _JUDGED = 160, 8
# A place lies outside when more than this share of the looks shows the room there: outlines are a pixel off, and a middle a little.
_OUTSIDE = 0.25
# Shares of the outlines' points between whose distances from the middle the surface lies: the rest are errors.
_BETWEEN = (0.1, 0.9)
# How far from the middle the surface may lie, in radii, and in how many steps it is looked for.
_REACH, _STEPS = (0.3, 2.2), 64
# A disc's deviation over the spacing, its thickness over its width, its opacity at the start.
_WIDTH, _FLATNESS, _OPACITY = 0.6, 0.3, 0.9
# Cosine between the surface's normal and the way to the camera from which colours are taken.
_FACING = 0.35
# Areas of a thing's regions differ from its sphere's by at most this factor.
_ONE_AREA = 1.6
_NEAR_M = 0.05


@dataclass(frozen=True)
class ShapeSettings:
    """How a thing is made: ``gaussians`` on its surface, ``iterations`` of training of one crop each."""

    gaussians: int
    iterations: int


@dataclass(frozen=True)
class Look:
    """A crop in which nobody covers the thing: the camera as seen from the thing's middle, ``rgb`` and ``state`` as in ``Region``."""

    camera: Camera
    rgb: np.ndarray
    state: np.ndarray


def looks_at(track: Track, cameras: Sequence[Camera]) -> list[Look]:
    """The uncovered looks at a thing, at most 160 of them spread over its frames."""
    found = []
    for frame, sighting in track.seen:
        if not track.valid[frame]:
            continue
        for view, region in sorted(sighting.regions.items()):
            if region.free and _whole(region, track, frame, cameras[view]):
                camera = _from_the_thing(cameras[view], track.centres_m[frame], region.corner, region.state.shape)
                found.append(Look(camera, region.rgb, region.state))
    return [found[i] for i in np.unique(np.linspace(0, len(found) - 1, min(_LOOKS, len(found))).astype(int))]


def hull(looks: Sequence[Look], radius_m: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) points of a star-shaped hull around the middle, metres, and (N, 3) the unit directions they lie in.

    In each direction the surface is where the share of looks that show the room there passes a quarter, but as far away as outlines are:
    what few cameras cannot carve away, the corners of the cones that they leave, is no part of the thing; what looks like a shadow is.
    """
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    height = 1 - (2 * np.arange(count) + 1) / count
    level = np.sqrt(1 - height**2)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), height], axis=1)
    steps_m = radius_m * np.linspace(*_REACH, _STEPS)
    points = directions[:, None] * steps_m[None, :, None]
    outside = np.zeros(points.shape[:2])
    for look in looks:
        pixels, _ = look.camera.project(points)
        outside += _sampled(look.state, pixels, ROOM) == ROOM
    inside = np.logical_and.accumulate(outside / max(len(looks), 1) <= _OUTSIDE, axis=1)
    last = np.maximum(inside.sum(axis=1) - 1, 0)
    reached = np.concatenate([_reached_m(look) for look in looks])
    nearest_m, farthest_m = np.quantile(reached, _BETWEEN) if len(reached) else (radius_m, radius_m)
    return directions * np.clip(steps_m[last], nearest_m, farthest_m)[:, None], directions


def coloured(points_m: np.ndarray, normals: np.ndarray, looks: Sequence[Look]) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) mean colours of points from the looks that face them, and (N,) bool which any look does; the others get the mean colour."""
    sums, weights = np.zeros((len(points_m), 3)), np.zeros(len(points_m))
    for look in looks:
        away = look.camera.centre_m - points_m
        facing = (normals * away).sum(1) / np.linalg.norm(away, axis=1)
        pixels, _ = look.camera.project(points_m)
        core = cv2.erode((look.state == LOOSE).astype(np.uint8), np.ones((3, 3), np.uint8))
        shows = (facing > _FACING) & (_sampled(core, pixels[None], 0)[0] > 0)
        column, row = np.floor(pixels[shows]).astype(int).T
        sums[shows] += facing[shows, None] * to_float(look.rgb)[row, column]
        weights[shows] += facing[shows]
    seen = weights > 0
    mean = sums[seen].sum(0) / weights[seen].sum() if seen.any() else np.full(3, 0.5)
    return np.where(seen[:, None], sums / np.maximum(weights, 1e-9)[:, None], mean), seen


def made(
    looks: Sequence[Look], radius_m: float, settings: ShapeSettings, rng: np.random.Generator, threads: int, label: str
) -> tuple[Gaussians, np.ndarray, float]:
    """Gaussians of a thing around its middle, their provenance (N,), and the PSNR in dB inside it in looks that were not trained on.

    NaN when there are too few looks to keep any apart.
    """
    judged = looks[_JUDGED - 1 :: _JUDGED]
    taught = [look for i, look in enumerate(looks) if i % _JUDGED != _JUDGED - 1]
    points, normals = hull(taught, radius_m, settings.gaussians)
    rgb, seen = coloured(points, normals, taught)
    size_m = np.linalg.norm(points, axis=1)
    width_m = _WIDTH * np.sqrt(4 * np.pi / len(points)) * size_m
    start = discs(points, normals, rgb, width_m, _FLATNESS, _OPACITY, 0)
    targets = [_target(look, i) for i, look in enumerate(taught)]
    schedule = _schedule(settings.iterations, float(2 * width_m.max()))
    trained = train(start, targets, schedule, rng, extent_m=radius_m, threads=threads, label=label)
    provenance = np.where(seen, MEASURED, INFERRED).astype(np.uint8)[trained.source]
    # What no look shows was trained on outlines alone.
    sh = np.where((provenance == MEASURED)[:, None, None], trained.gaussians.sh, start.sh[trained.source])
    gaussians = replace(trained.gaussians, sh=sh)
    return gaussians, provenance, _agreement_db(gaussians, judged, threads)


def _reached_m(look: Look) -> np.ndarray:
    """(K,) how far from the middle the rays through a look's outline pass."""
    points = outline_of(look.state)
    rays = look.camera.unproject(points, np.ones(len(points))) - look.camera.centre_m
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.linalg.norm(np.cross(rays, look.camera.centre_m), axis=1)


def _whole(region: Region, track: Track, frame: int, camera: Camera) -> bool:
    """Whether a region has about the area of the thing: another thing may be before it, or beside it and of one region with it."""
    radius_px = track.radius_m * camera.focal_px[0] / float(camera.project(track.centres_m[frame])[1])
    return 1 / _ONE_AREA < region.area_px / (np.pi * radius_px**2) < _ONE_AREA


def _from_the_thing(camera: Camera, centre_m: np.ndarray, corner: tuple[int, int], hw: tuple[int, int]) -> Camera:
    """A camera's crop with the thing's middle as the world's origin."""
    intrinsics, pose = camera.intrinsics.copy(), camera.camera_from_world.copy()
    intrinsics[:2, 2] -= corner
    pose[:3, 3] += pose[:3, :3] @ centre_m
    return Camera(camera.name, (hw[1], hw[0]), intrinsics, pose)


def _sampled(picture: np.ndarray, pixels: np.ndarray, beyond: int) -> np.ndarray:
    """Values of a picture (H, W) at pixels (N, K, 2), ``beyond`` outside of it and behind the camera."""
    values, inside = sample(picture, pixels, "nearest")
    return np.where(inside, values, beyond)


def _target(look: Look, index: int) -> Target:
    """What training compares with: the thing before black and white by turns, the seam of its outline and what hides it left out."""
    behind = np.float32(index % 2)
    loose, square = (look.state == LOOSE).astype(np.uint8), np.ones((3, 3), np.uint8)
    seam = (cv2.dilate(loose, square) > 0) & (cv2.erode(loose, square, borderType=cv2.BORDER_REPLICATE) == 0)
    rgb = np.where(loose[..., None] > 0, to_float(look.rgb), behind).astype(np.float32)
    weight = (~seam & (look.state != UNKNOWN)).astype(np.float32)
    return Target(look.camera, rgb, weight, background_rgb=(float(behind),) * 3)


def _agreement_db(gaussians: Gaussians, looks: Sequence[Look], threads: int) -> float:
    rasteriser, squares, count = Rasteriser(near_m=_NEAR_M, threads=threads), 0.0, 0
    for look in looks:
        target = _target(look, 0)
        chosen = (target.weight > 0) & (look.state == LOOSE)
        drawn = rasteriser.forward(gaussians, look.camera, target.background_rgb).rgb.clip(0, 1)
        squares += float(np.square(drawn[chosen] - target.rgb[chosen]).sum())
        count += 3 * int(chosen.sum())
    return float(-10 * np.log10(max(squares / count, 1e-10))) if count else float("nan")


def _schedule(iterations: int, largest_m: float) -> TrainingSettings:
    """Training of a small set that starts on its surface: it needs no density control, one degree of harmonics and no warm-up."""
    return TrainingSettings(
        iterations=iterations, l1=1.0, ssim=0.0, density=0.0, depth=0.0, opacity_pull=0.0, position_lr_start=2e-3, position_lr_end=2e-5,
        scale_lr=5e-3, rotation_lr=1e-3, opacity_lr=2e-2, sh_lr=1e-2, sh_rest_lr=0.0, adam_epsilon=1e-6, sh_degree=0, sh_degree_every=0,
        warmup_half_resolution=0.0, near_m=_NEAR_M, largest_scale_m=largest_m, densify="none", cap=0, densify_every=1, densify_from=0,
        densify_until=0, densify_gradient=0.0, densify_scale=0.0, prune_opacity=0.0, opacity_reset_every=0, relocate_growth=0.0,
        relocate_noise=0.0, checkpoint_every_s=0.0, lpips=PerceptualSettings(weight=0.0, every=1, crop_px=0, weights=""),
    )  # fmt: skip
