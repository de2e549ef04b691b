# SPDX-License-Identifier: Apache-2.0
"""``objects.find``: finds loose and carried objects as rigid sets of Gaussians that differ from the plates.

Writes ``objects/objects.npz`` (``splatting/rigid_object.py``), possibly without any object: with fewer than two cameras
an object has no position in space.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.body.silhouettes import dilated_silhouettes
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.footage.stills import read_plate, shrink_plate
from studiorecon.footage.video import read_frames
from studiorecon.objects import carving
from studiorecon.objects.object_tracks import FollowSettings, ObjectTrack, is_covered, link_sightings, track_object
from studiorecon.objects.residual import (
    LooseSettings,
    ResidualRegion,
    loose_regions,
    pixel_states,
    shadow_free_difference,
    typical_difference,
)
from studiorecon.objects.rigid import (
    ObjectCrop,
    ShapeSettings,
    crop_at_pose,
    mean_squared_errors,
    train_object,
    unoccluded_crops,
    validation_split,
)
from studiorecon.objects.rotation import NEVER_DB, TurnSettings, track_rotation
from studiorecon.objects.sightings import Sighting, find_sightings
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.factors import NONE, Factors, read_factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.people import Person
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import MEASURED_TURNS, RigidObject, write_objects

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Number of pictures that measure the usual difference from the plate.
_REST_FRAMES = 16
# A body that was filled in may be this many times as far off.
_FILLED_MARGIN = 3.0
Moments = Iterator[tuple[Sequence[np.ndarray], Sequence[np.ndarray]]]


@dataclass(frozen=True)
class Settings:
    """Settings of detection, tracking and modelling.

    Attributes:
        pixels: longer side of the pictures to search; larger ones are shrunk.
        gate_m: rays of one object pass within this distance.
        radius_m: least and most radius of an object.
        seed: of the training.
    """

    pixels: int = 480
    loose: LooseSettings = LooseSettings()
    gate_m: float = 0.08
    radius_m: tuple[float, float] = (0.03, 0.35)
    follow: FollowSettings = FollowSettings()
    shape: ShapeSettings = ShapeSettings()
    turn: TurnSettings = setting(TurnSettings(), "How a thing's turning is sought.")
    seed: int = 0


@dataclass(frozen=True)
class ObjectView:
    """One training camera at the searched size: film, clean plate in [0, 1], and where that is ``measured``.

    ``typical`` is the difference of its pictures from the plate without objects.
    """

    camera: Camera
    video: Path
    plate: Float[np.ndarray, "H W 3"]
    measured: Bool[np.ndarray, "H W"]
    typical: Float[np.ndarray, "H W"]


def find_objects(
    moments: Moments,
    views: Sequence[ObjectView],
    frames: int,
    fps: float,
    settings: Settings,
    threads: int,
) -> list[RigidObject]:
    """The objects that move through a clip.

    ``moments`` are, frame by frame, every view's picture and the region of people.
    """
    cameras = [view.camera for view in views]
    found: list[tuple[int, list[Sighting]]] = []
    alone = np.zeros(len(views), int)
    for frame, (pictures, explained) in enumerate(moments):
        shown = [
            pixel_states(shadow_free_difference(p, v.plate, settings.loose), v.typical, v.measured, e, settings.loose)
            for p, v, e in zip(pictures, views, explained)
        ]
        loose: list[list[ResidualRegion]] = [
            loose_regions(p, s, v, settings.loose.min_share) for v, (p, s) in enumerate(zip(pictures, shown))
        ]
        things = find_sightings(cameras, shown, loose, settings.gate_m, settings.radius_m)
        paired = {id(region) for thing in things for region in thing.regions.values()}
        alone += [any(id(region) not in paired for region in own) for own in loose]
        found.append((frame, things))
    for camera, count in zip(cameras, alone):
        if count:
            say(
                f"{camera.name}: in {count} of {frames} frames no second camera confirms a difference from the plate, "
                "which is ignored"
            )
    made_objects: list[RigidObject] = []
    for track in link_sightings(found, fps, settings.follow):
        result = track_object(track, cameras, frames, fps, settings.follow)
        where = f"frames {track[0][0]} to {track[-1][0]}"
        looks = unoccluded_crops(result, cameras) if isinstance(result, ObjectTrack) else []
        if isinstance(result, ObjectTrack) and looks:
            thing = _model_object(f"o{len(made_objects)}", result, looks, cameras, fps, settings, threads)
            if thing is not None:
                made_objects.append(thing)
                continue
        if len(track) > 2:
            say(f"an object in {where} is left out: {result if isinstance(result, str) else 'no crop shows all of it'}")
    if not made_objects:
        say(
            f"no two cameras see an object for {settings.follow.min_s:g} s, so films show none; clean plates "
            "(plates/CAMERA.png) and more cameras help"
        )
    return made_objects


def _model_object(
    name: str,
    track: ObjectTrack,
    looks: Sequence[ObjectCrop],
    cameras: Sequence[Camera],
    fps: float,
    settings: Settings,
    threads: int,
) -> RigidObject | None:
    """The model of a track; None where its outlines leave nothing."""
    apart = validation_split(looks)
    keys = {(look.frame, look.view) for look in apart}
    taught = [look for look in looks if (look.frame, look.view) not in keys]
    rng = np.random.default_rng([settings.seed, int(name[1:])])
    start = carving.init_carved_surface(taught, settings.shape.gaussians)
    if start is None:
        return None
    gaussians, provenance = train_object(taught, start, track.radius_m, settings.shape, rng, threads, name)
    still = RigidObject(name, gaussians, provenance, track.centres_m, track.valid, track.present, track.radius_m)
    thing, turning = _track_rotation(still, track, looks, keys, cameras, fps, settings, threads) or (
        still,
        "its rotation is undetermined",
    )
    validation = [crop_at_pose(look, cameras, thing.pose_at(look.frame)) for look in apart if thing.valid[look.frame]]
    agreement_db = -10 * np.log10(max(mean_squared_errors(thing.gaussians, validation, threads)[0], 1e-10))
    between, unknown = int((thing.present & ~thing.valid).sum()), int((~thing.present).sum())
    say(
        f"{name}: radius {100 * track.radius_m:.1f} cm; measured in {int(thing.valid.sum())} frames, interpolated in "
        f"{between}, unknown in {unknown}; {thing.gaussians.count} Gaussians from {len(looks)} "
        f"crops, {agreement_db:.1f} dB on validation crops; {turning}"
    )
    return thing


def _track_rotation(
    still: RigidObject,
    track: ObjectTrack,
    looks: Sequence[ObjectCrop],
    apart: Collection[tuple[int, int]],
    cameras: Sequence[Camera],
    fps: float,
    settings: Settings,
    threads: int,
) -> tuple[RigidObject, str] | None:
    """A turning object and a message; None where ``still`` fits the validation crops ``apart`` nearly as well."""
    if settings.turn.gain_db >= NEVER_DB:
        return None
    rng = np.random.default_rng([settings.seed, int(still.person[1:]), 1])
    motion = track_rotation(track, cameras, apart, fps, settings.turn, rng, threads)
    if motion is None:
        return None
    known = [look for look in looks if motion.measured[look.frame]]
    validation = [look for look in known if (look.frame, look.view) in apart]
    taught = [
        crop_at_pose(look, cameras, motion.world_from_thing[look.frame])
        for look in known
        if (look.frame, look.view) not in apart
    ]
    start = carving.init_carved_surface(taught, settings.shape.gaussians)
    if start is None or not validation:
        return None
    gaussians, seen = train_object(
        taught, start, carving.reach_m(taught), settings.shape, rng, threads, f"{still.person}, turning"
    )
    moved = [crop_at_pose(look, cameras, motion.world_from_thing[look.frame]) for look in validation]
    gain_db = 10 * np.log10(
        mean_squared_errors(still.gaussians, validation, threads)[1]
        / max(mean_squared_errors(gaussians, moved, threads)[1], 1e-10)
    )
    if not gain_db >= settings.turn.gain_db:
        return None
    present = is_covered(motion.measured, fps, settings.follow)
    centres = np.where(present[:, None], motion.world_from_thing[:, :3, 3], np.nan)
    turns = motion.world_from_thing[:, :3, :3]
    thing = RigidObject(
        still.person, gaussians, seen, centres, motion.measured, present, still.radius_m, turns, MEASURED_TURNS
    )
    return thing, f"it turns, which explains the validation crops {gain_db:.1f} dB better, outlines included"


def add_typical_difference(views: Sequence[ObjectView], moments: Moments, settings: LooseSettings) -> list[ObjectView]:
    """The views with their typical difference from the plate, measured at moments spread over the clip."""
    seen = list(moments)
    found = []
    for v, view in enumerate(views):
        differences = [shadow_free_difference(pictures[v], view.plate, settings) for pictures, _ in seen]
        found.append(replace(view, typical=typical_difference(differences, [explained[v] for _, explained in seen])))
    return found


def read_moments(
    views: Sequence[ObjectView],
    people: Sequence[Person],
    body: BodyModel | None,
    frames: int,
    margin_m: float,
    step: int = 1,
    factors: Factors = NONE,
) -> Moments:
    """Every ``step``-th frame: every view's picture at the searched size without ``factors``, and people's region."""
    films = zip(*(read_frames(view.video, 0, frames) for view in views), strict=True)
    for frame, filmed in enumerate(progress(films, "loose things", frames)):
        if frame % step:
            continue
        pictures = [factors.normalise(view.camera.name, picture, frame) for view, picture in zip(views, filmed)]
        yield (
            [
                p if p.shape[:2] == v.camera.hw else cv2.resize(p, v.camera.wh, interpolation=cv2.INTER_AREA)
                for p, v in zip(pictures, views)
            ],
            [dilated_silhouettes(people, body, view.camera, frame, margin_m, _FILLED_MARGIN) for view in views],
        )


def open_view(camera: Camera, video: Path, plate: Path, pixels: int, factors: Factors = NONE) -> ObjectView:
    """A camera with its plate at the searched size, divided by its exposure's ``factors``."""
    share = min(1.0, pixels / max(camera.wh))
    small = camera.resized((round(camera.wh[0] * share), round(camera.wh[1] * share)))
    rgb, measured = read_plate(plate, camera.wh)
    return ObjectView(
        small,
        video,
        *shrink_plate(factors.normalise(camera.name, rgb), measured, small.wh),
        np.zeros(small.hw, np.float32),
    )


def run(
    settings: Settings,
    model: Path,
    manifest: Path,
    videos: list[Path],
    plates: list[Path],
    fits: list[Path],
    body: Path | None,
    threads: int,
    objects: Written,
    gains: list[Path] | None = None,
    brightness: list[Path] | None = None,
) -> None:
    """Find, track and model a scene's objects; the fitted bodies ``fits`` explain differences from the plates.

    The cameras' ``gains`` and the frames' ``brightness`` are divided out of the pictures, the gains out of the plates
    too.
    """
    cameras = read_model(model.parent)
    footage = read_manifest(manifest)
    require_one_each(cameras, videos=videos, plates=plates)
    body_model = BodyModel.load(body) if fits else None
    persons = [read_person(path, footage.frames, body_model) for path in fits]
    gain, every = read_factors(gains or []), read_factors([*(gains or []), *(brightness or [])], footage.frames)
    views = [open_view(*each, settings.pixels, gain) for each in zip(cameras, videos, plates)]
    about = (persons, body_model, footage.frames, settings.loose.margin_m)
    step = max(1, footage.frames // _REST_FRAMES)
    views = add_typical_difference(views, read_moments(views, *about, step=step, factors=every), settings.loose)
    moments = read_moments(views, *about, factors=every)
    found = find_objects(moments, views, footage.frames, footage.fps, settings, threads)
    write_objects(objects, found, footage.frames)
