# SPDX-License-Identifier: Apache-2.0
"""The colours of a tracked object: its crops, and the training of its discs (``carving``) on crops from all frames.

All pictures are transformed to the object's frame: its motion is applied to the cameras, so that one still set of
Gaussians is trained on all frames. Without a known rotation (``rotation`` estimates it) the object is assumed not to
rotate; its colours and its shape are then a mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.footage.video import to_float
from studiorecon.images.channels import channel_sum
from studiorecon.images.warp import sample
from studiorecon.objects.object_tracks import ObjectTrack
from studiorecon.objects.residual import LOOSE, UNKNOWN, ResidualRegion, outline_points
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import train_still
from studiorecon.splatting.train.targets import Target

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Number of crops for training, spread over the track; every so-many-th is for validation.
_LOOKS, _JUDGED = 160, 8
# Least cosine between the surface's normal and the direction of a camera that gives it colour.
_FACING = 0.35
# Largest factor between the areas of an object's regions and its sphere's.
_ONE_AREA, _ONE_AREA_OBLONG = 1.6, 6.0
NEAR_M = 0.05
"""Nothing nearer to a camera is drawn: a lens does not focus there."""


@dataclass(frozen=True)
class ShapeSettings:
    """Settings of an object's model: ``gaussians`` on its surface, ``iterations`` of training of one crop each."""

    gaussians: int = 800
    iterations: int = 600


@dataclass(frozen=True)
class ObjectCrop:
    """A crop in which no person occludes the object, and its source.

    Attributes:
        frame, view: moment and index of the camera.
        corner: column and row of the crop's first pixel.
        camera: the crop's camera in the object's frame.
        state: as in ``ResidualRegion``.
    """

    frame: int
    view: int
    corner: tuple[int, int]
    camera: Camera
    rgb: Integer[np.ndarray, "h w 3"]
    state: Integer[np.ndarray, "h w"]


def unoccluded_crops(track: ObjectTrack, cameras: Sequence[Camera]) -> list[ObjectCrop]:
    """The unoccluded crops of an object that moves without turning, at most 160 of them spread over its frames."""
    found = []
    for frame, sighting in track.sightings:
        if not track.valid[frame]:
            continue
        still = np.eye(4)
        still[:3, 3] = track.centres_m[frame]
        for view, region in sorted(sighting.regions.items()):
            if region.free and _whole(region, track, frame, cameras[view]):
                look = ObjectCrop(frame, view, region.corner, cameras[view], region.rgb, region.state)
                found.append(crop_at_pose(look, cameras, still))
    return [found[i] for i in spread_indices(len(found), _LOOKS, below=True)]


def crop_at_pose(look: ObjectCrop, cameras: Sequence[Camera], world_from_thing: Float[np.ndarray, "4 4"]) -> ObjectCrop:
    """A crop with its camera in the object's frame, for the object at pose ``world_from_thing``."""
    camera = cameras[look.view]
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] -= look.corner
    wh = (look.state.shape[1], look.state.shape[0])
    return replace(look, camera=Camera(camera.name, wh, intrinsics, camera.camera_from_world @ world_from_thing))


def validation_split(looks: Sequence[ObjectCrop]) -> list[ObjectCrop]:
    """Every eighth crop: the validation split, which no model is trained on."""
    return list(looks[_JUDGED - 1 :: _JUDGED])


def outline_reach_m(look: ObjectCrop) -> Float[np.ndarray, " K"]:
    """Distances from the middle at which the rays through a crop's outline pass."""
    points = outline_points(look.state)
    rays = look.camera.unproject(points, np.ones(len(points))) - look.camera.centre_m
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.linalg.norm(np.cross(rays, look.camera.centre_m), axis=1)


def mean_colours(
    points_m: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], looks: Sequence[ObjectCrop]
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " N"]]:
    """Mean colours of points from the crops that face them, and whether one does; the others get the mean colour."""
    sums, weights = np.zeros((len(points_m), 3)), np.zeros(len(points_m))
    for look in looks:
        away = look.camera.centre_m - points_m
        facing = (normals * away).sum(1) / np.linalg.norm(away, axis=1)
        pixels, _ = look.camera.project(points_m)
        core = cv2.erode((look.state == LOOSE).astype(np.uint8), np.ones((3, 3), np.uint8))
        shows = (facing > _FACING) & (_sample_nearest(core, pixels[None], 0)[0] > 0)
        column, row = np.floor(pixels[shows]).astype(int).T
        sums[shows] += facing[shows, None] * to_float(look.rgb)[row, column]
        weights[shows] += facing[shows]
    seen = weights > 0
    mean = sums[seen].sum(0) / weights[seen].sum() if seen.any() else np.full(3, 0.5)
    return np.where(seen[:, None], sums / np.maximum(weights, 1e-9)[:, None], mean), seen


def train_object(
    looks: Sequence[ObjectCrop],
    start: tuple[Gaussians, Bool[np.ndarray, " N"]],
    radius_m: float,
    settings: ShapeSettings,
    rng: np.random.Generator,
    threads: int,
    label: str,
) -> tuple[Gaussians, Integer[np.ndarray, " N"]]:
    """Gaussians of an object in its own frame, trained on crops from a ``start``, and their provenance."""
    discs_there, seen = start
    targets = [_target(look, i) for i, look in enumerate(looks)]
    largest_m = float(2 * np.exp(discs_there.log_scales.max()))
    trained = train_still(
        discs_there,
        targets,
        _schedule(settings.iterations, largest_m),
        rng,
        extent_m=radius_m,
        threads=threads,
        label=label,
    )
    provenance = np.where(seen, MEASURED, INFERRED).astype(np.uint8)[trained.source]
    # Without a crop that shows it, a disc was trained on outlines only.
    sh = np.where((provenance == MEASURED)[:, None, None], trained.gaussians.sh, discs_there.sh[trained.source])
    return replace(trained.gaussians, sh=sh), provenance


def mean_squared_errors(gaussians: Gaussians, looks: Sequence[ObjectCrop], threads: int) -> tuple[float, float]:
    """Mean squared errors of crops, inside the object and of the whole crop; NaN without any."""
    rasteriser, squares, counts = Rasteriser(near_m=NEAR_M, threads=threads), np.zeros(2), np.zeros(2)
    for look in looks:
        target = _target(look, 0)
        drawn = rasteriser.forward(gaussians, look.camera, target.background_rgb).rgb.clip(0, 1)
        errors = channel_sum(np.square(drawn - target.rgb)) / 3
        for k, chosen in enumerate((target.used & (look.state == LOOSE), look.state != UNKNOWN)):
            squares[k] += float(errors[chosen].sum())
            counts[k] += int(chosen.sum())
    inside, whole = np.where(counts > 0, squares / np.maximum(counts, 1), np.nan)
    return float(inside), float(whole)


def _whole(region: ResidualRegion, track: ObjectTrack, frame: int, camera: Camera) -> bool:
    """Whether a region has about the object's area, so that no other object occludes it or is merged with it.

    Objects that are not round have areas of all sizes.
    """
    most = _ONE_AREA if track.is_sphere else _ONE_AREA_OBLONG
    radius_px = track.radius_m * camera.focal_px[0] / float(camera.project(track.centres_m[frame])[1])
    return 1 / most < region.area_px / (np.pi * radius_px**2) < most


def _sample_nearest(picture: np.ndarray, pixels: np.ndarray, beyond: int) -> np.ndarray:
    """Values of a picture (H, W) at pixels (N, K, 2); ``beyond`` outside of it and behind the camera."""
    values, inside = sample(picture, pixels, "nearest")
    return np.where(inside, values, beyond)


def _target(look: ObjectCrop, index: int) -> Target:
    """The training target: the object on black and white in turn, without its outline's seam and occluded pixels."""
    behind = np.float32(index % 2)
    loose, square = (look.state == LOOSE).astype(np.uint8), np.ones((3, 3), np.uint8)
    seam = (cv2.dilate(loose, square) > 0) & (cv2.erode(loose, square, borderType=cv2.BORDER_REPLICATE) == 0)
    rgb = np.where(loose[..., None] > 0, to_float(look.rgb), behind).astype(np.float32)
    weight = (~seam & (look.state != UNKNOWN)).astype(np.float32)
    return Target(look.camera, rgb, weight, background_rgb=(float(behind),) * 3)


def _schedule(iterations: int, largest_m: float) -> TrainingSettings:
    """Training of a small set that starts on its surface: no density control, one degree of harmonics, no warm-up."""
    return TrainingSettings(
        iterations=iterations,
        l1=1.0,
        ssim=0.0,
        position_lr_start=2e-3,
        position_lr_end=2e-5,
        opacity_lr=2e-2,
        sh_lr=1e-2,
        adam_epsilon=1e-6,
        sh_degree=0,
        warmup_half_resolution=0.0,
        near_m=NEAR_M,
        largest_scale_m=largest_m,
    )
