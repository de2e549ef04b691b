# SPDX-License-Identifier: Apache-2.0
"""The initial state of the room's training: photos without people, first Gaussians, and the targets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.background import hole_filling
from studiorecon.background.targets import angle_between_axes, cutoff_angle, view_weight
from studiorecon.background.train_settings import Settings
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frame, read_stack, to_float
from studiorecon.images.regions import dilate
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors, read_factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.path import PathStep, read_path
from studiorecon.scene.provenance import INFERRED, INVENTED, MEASURED
from studiorecon.scene.room import RoomBox, read_room
from studiorecon.scene.step_files import require, require_size
from studiorecon.scene.support import support_weight
from studiorecon.splatting.cpu.harmonics import degree_supported
from studiorecon.splatting.discs import make_discs
from studiorecon.splatting.seeds import FLATNESS, finest_pixels, random_volume, seeds_from_depth
from studiorecon.splatting.train.targets import Target

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_WIDTH_SHARE = 0.75  # of the grid step: neighbours overlap enough to be opaque together
# How far into a hole its rim is trusted, as a share of the picture's width.
_RIM_SHARE = 0.01
_SAME_PLACE_M, _SAME_ANGLE_RAD = 0.01, 0.01


@dataclass(frozen=True)
class Sources:
    """The input files of the room's training, named as the steps' inputs."""

    model: Path
    plates: list[Path]
    depths: list[Path]
    room_box: Path
    path: Path
    views: list[Path]
    supports: list[Path]
    gains: list[Path] = field(default_factory=list)
    videos: list[Path] = field(default_factory=list)
    masks: list[Path] = field(default_factory=list)

    def files(self) -> list[Path]:
        """All files in a fixed order."""
        images = [self.model.parent / "cameras.txt", self.model, *self.plates, *self.depths, self.room_box, self.path]
        return [*images, *self.views, *self.supports, *self.gains, *self.videos, *self.masks]


@dataclass(frozen=True)
class PreparedTraining:
    """Inputs of the first iteration.

    Attributes:
        settings: with no more harmonics than the cameras can distinguish.
        start, marks: first Gaussians, and their provenance.
        real, synthesized: targets.
    """

    settings: Settings
    photos: list[Photo]
    start: Gaussians
    marks: Integer[np.ndarray, " N"]
    real: list[Target]
    synthesized: list[Target]


@dataclass(frozen=True)
class Photo:
    """A training camera's clean plate, where it is ``known``, and its depth and confidence."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    known: Bool[np.ndarray, "H W"]
    depth_m: Float[np.ndarray, "H W"]
    confidence: Float[np.ndarray, "H W"]


def paint_room(photos: Sequence[Photo], box: RoomBox, settings: Settings) -> list[hole_filling.PaintedFace]:
    """The room's faces, painted from the photos and continued over unseen parts."""
    faces = box.rectangles
    step_m = hole_filling.node_step(faces, settings.fill_step_m, settings.fill_limit)
    cameras, plates, known, depths = zip(*((p.camera, p.rgb, p.known, p.depth_m) for p in photos))
    return hole_filling.paint(faces, cameras, plates, known, depths, step_m)


def initial_gaussians(
    photos: Sequence[Photo], painted: Sequence[hole_filling.PaintedFace], settings: Settings
) -> tuple[Gaussians, Integer[np.ndarray, " N"]]:
    """First Gaussians and their provenance: discs on measured depth, and on unseen parts of the ``painted`` room."""
    degree = settings.training.sh_degree
    sets, marks = [], []
    wanted = finest_pixels([p.camera for p in photos], [p.depth_m for p in photos], [p.known for p in photos])
    for photo, finest_here in zip(photos, wanted):
        made, at = seeds_from_depth(
            photo.camera,
            photo.rgb,
            finest_here,
            photo.depth_m,
            settings.stride,
            settings.seed_size,
            settings.seed_opacity,
            degree,
        )
        sure = photo.confidence[at[:, 0], at[:, 1]] > settings.measured_confidence
        sets.append(made)
        marks.append(np.where(sure, MEASURED, INFERRED))
    for own in painted:
        points_m, rgb = own.points_m[~own.seen], own.rgb[~own.seen]
        normals = np.tile(own.face.normal, (len(points_m), 1))
        sets.append(make_discs(points_m, normals, rgb, own.step_m * _WIDTH_SHARE, FLATNESS, sh_degree=degree))
        marks.append(np.full(len(normals), INVENTED))
    return concatenate(sets), np.concatenate(marks).astype(np.uint8)


def limit_harmonics(settings: Settings, start: Gaussians, cameras: Sequence[Camera], varied: bool = True) -> Settings:
    """The settings, with harmonics limited to those that the real cameras distinguish at the middle of the room.

    None at all unless colours are ``varied`` with the direction of view. Synthesized views are made of the photos and
    have no highlights of their own to add (G15).
    """
    middle_m = np.median(start.means_m, axis=0)
    degree = degree_supported(np.array([camera.centre_m - middle_m for camera in cameras])) if varied else 0
    if not settings.limit_sh_to_views or degree >= settings.training.sh_degree:
        return settings
    why = (
        f"{len(cameras)} cameras cannot resolve more"
        if varied
        else "the survey finds no colour that changes with the view"
    )
    say(f"spherical harmonics have degree {degree} instead of {settings.training.sh_degree}: {why} (limit_sh_to_views)")
    return replace(settings, training=replace(settings.training, sh_degree=degree))


def plate_targets(photos: Sequence[Photo], boost: float) -> list[Target]:
    """Every plate as a target, with its depth; at distance 0 from itself its pixels weigh 1 + ``boost`` (U15, U16)."""
    weight = view_weight(0.0, cutoff_angle([p.camera for p in photos]), boost)
    return [Target(p.camera, p.rgb, p.known * np.float32(weight)) for p in photos]


def view_targets(
    steps: Sequence[PathStep],
    pictures: Iterable[Integer[np.ndarray, "H W 3"]],
    supports: Iterable[Integer[np.ndarray, "H W"]],
    cameras: Sequence[Camera],
    painted: Sequence[hole_filling.PaintedFace],
    settings: Settings,
) -> list[Target]:
    """Every synthesized view as a target; its weight falls with the angle to the nearest real camera (appendix C).

    Painted pixels without support continue the hole's rim, which is often furniture: there the target fades to the
    ``painted`` room, if any. Views at a photo's pose are left out, because the photo is a target already (U16).
    """
    cutoff = cutoff_angle(cameras)
    targets = []
    for step, rgb, support in zip(steps, pictures, supports, strict=True):
        nearest = min(angle_between_axes(step.camera, c) for c in cameras)
        beside = min(np.linalg.norm(step.camera.centre_m - c.centre_m) for c in cameras)
        if beside < _SAME_PLACE_M and nearest < _SAME_ANGLE_RAD:
            continue
        weight = view_weight(nearest, cutoff, settings.photo_weight)
        picture, hole = to_float(rgb), support == 0
        if painted and hole.any():
            apart = np.inf if hole.all() else scipy.ndimage.distance_transform_edt(hole)
            rim = np.broadcast_to(np.exp(-apart / (_RIM_SHARE * hole.shape[1])), hole.shape)[hole, None]
            picture[hole] = rim * picture[hole] + (1 - rim) * hole_filling.draw_faces(step.camera, painted)[hole]
        targets.append(Target(step.camera, picture, support_weight(support, settings.hole_weight) * np.float32(weight)))
    return targets


def mask_people(
    photos: Sequence[Photo], videos: Sequence[Path], masks: Sequence[Path], dilation_px: int, gains: Factors
) -> list[Photo]:
    """The first pictures instead of the plates (paper, Eq. 5), unknown within ``dilation_px`` of people's ``masks``."""
    require_one_each([p.camera for p in photos], videos=list(videos))
    if masks:
        require_one_each([p.camera for p in photos], masks=list(masks))
    seen = []
    for view, (photo, video) in enumerate(zip(photos, videos)):
        picture = to_float(gains.normalise(photo.camera.name, read_frame(video, 0)))
        people = read_frame(masks[view], 0) > 0 if masks else np.zeros(photo.camera.hw, bool)
        require_size(video, picture, photo.camera.wh)
        require_size(masks[view] if masks else video, people, photo.camera.wh)
        known = ~dilate(people, dilation_px)
        if not known.any():
            raise UserError(
                f"camera {photo.camera.name} shows only people and {dilation_px} px around them in the first frame: "
                "set background.room_targets to plates"
            )
        say(
            f"{photo.camera.name}: people and {dilation_px} px around them cover {np.mean(~known):.1%} of the first "
            "picture"
        )
        seen.append(replace(photo, rgb=picture, known=known))
    return seen


def read_photos(cameras: Sequence[Camera], plates: list[Path], depths: list[Path], gains: Factors) -> list[Photo]:
    require_one_each(cameras, plates=plates, depth_maps=depths)
    photos = []
    for camera, plate_path, depth_path in zip(cameras, plates, depths):
        rgb, known = read_plate(plate_path, camera.wh)
        depth_m, confidence = read_depth(depth_path, camera.wh)
        if not known.any():
            raise UserError(
                f"{plate_path} has no measured pixel; give a clean plate of camera {camera.name} in plates/"
            )
        photos.append(Photo(camera, gains.normalise(camera.name, rgb), known, depth_m, confidence))
    return photos


def read_views(
    path: Path,
    views: list[Path],
    supports: list[Path],
    cameras: Sequence[Camera],
    painted: Sequence[hole_filling.PaintedFace],
    settings: Settings,
) -> list[Target]:
    """All synthesized views as targets; none when their share of the draws is 0, or there are none."""
    if settings.views_share == 0 or not views:
        return []
    steps, _ = read_path(path)
    segments = {step.segment for step in steps}
    targets = []
    for video, mask in zip(views, supports, strict=True):
        # Gaps without synthesized views have no video.
        segment = video.name.partition(".")[0]
        require(video, segment in segments, f"it is of no segment of {path}")
        own = [step for step in steps if step.segment == segment]
        pictures, masks = (read_stack(film, 0, len(own)) for film in (video, mask))
        targets += view_targets(own, pictures, masks, cameras, painted, settings)
    return targets


def prepare_training(
    settings: Settings, sources: Sources, cameras: Sequence[Camera], varied: bool, rng: np.random.Generator
) -> PreparedTraining:
    """Read all inputs and build the initial state; ``varied``: colours change with the direction of view."""
    box = read_room(sources.room_box)
    factors = read_factors(sources.gains)
    photos = read_photos(cameras, sources.plates, sources.depths, factors)
    if settings.room_targets == "first_frames":
        photos = mask_people(photos, sources.videos, sources.masks, settings.dilation_px, factors)
    painted = paint_room(photos, box, settings) if settings.fill_unseen else []
    if settings.start == "depth":
        start, marks = initial_gaussians(photos, painted, settings)
        shares = [int((marks == kind).sum()) for kind in (MEASURED, INFERRED, INVENTED)]
        say(
            f"training starts from {start.count} Gaussians: {shares[0]} measured, {shares[1]} on default walls, "
            f"{shares[2]} where no camera sees"
        )
    else:
        start = random_volume(
            list(cameras), settings.random_count, settings.random_size_m, settings.training.sh_degree, rng
        )
        marks = np.full(start.count, MEASURED, np.uint8)
        say(f"training starts from {start.count} random Gaussians: the baseline without depth")
    settings = limit_harmonics(settings, start, cameras, varied)
    real = plate_targets(photos, settings.photo_weight)
    synthesized = read_views(sources.path, sources.views, sources.supports, cameras, painted, settings)
    drawn = settings.views_share if synthesized else 0.0
    say(
        f"training uses {len(real)} plates and {len(synthesized)} synthesized views, the latter in {drawn:.0%} of steps"
    )
    return PreparedTraining(settings, photos, start, marks, real, synthesized)
