# SPDX-License-Identifier: Apache-2.0
"""``render.light``: estimates the room's light from people's shadows on the floor, and checks it on held-out pictures.

Runs only when the survey detects moving shadows and there are people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.capsules import build_occluder
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frame
from studiorecon.geometry.floor import floor_points, is_near
from studiorecon.progress import progress, say
from studiorecon.render.area_lights import fit_strengths, lamp_patches, light_losses, unshaded_levels
from studiorecon.render.occlusion import Groups
from studiorecon.render.room_light import Lamps, Light, LitPoints, write_light
from studiorecon.scene.files import require_one_each
from studiorecon.scene.people import Person
from studiorecon.scene.room import RoomBox, read_room
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Levels of 255 between which a ratio is reliable; a larger change of colour (log) is no shadow.
_DARKEST, _BRIGHTEST, _SAME_COLOUR = 12.0, 250.0, 0.08
# The exposure of a picture is estimated from at least this many pixels out of reach of any shadow.
_MIN_PX = 200
# Masks are grown by this share of the picture's width: their seams hold mixed colours.
_SEAM = 0.006
_HELD_OUT = 0.25


@dataclass(frozen=True)
class LightSettings:
    """Settings of the estimate of light.

    Attributes:
        pictures: number per camera, spread over the clip.
        points: pixels of the floor in every camera.
        reach_m: distance from people's paths within which the floor is used.
        spacing_m: between the patches of ceiling and walls that may give light.
        contact_m: reach of the darkening near a body that hides diffuse light.
        min_gain: share by which the error on held-out pictures must fall.
    """

    pictures: int = 24
    points: int = 500
    reach_m: float = 2.0
    spacing_m: float = 0.75
    contact_m: float = 0.1
    min_gain: float = 0.05


@dataclass(frozen=True)
class Settings:
    light: LightSettings = LightSettings()


@dataclass(frozen=True)
class FloorObservations:
    """P pixels of the floor in one camera: points, and ratio of pictures to the plate, NaN where unknown."""

    points_m: Float[np.ndarray, "P 3"]
    ratio: Float[np.ndarray, "P T"]


def bodies_over_time(people: Sequence[Person], model: BodyModel) -> list[list[Float[np.ndarray, "C 7"]]]:
    """Per frame the capsules of every person; none where unmeasured. Raises UserError for another body model."""
    for person in people:
        model.require_same(person.body, person.name)
    shapes = [build_occluder(model, person.betas) for person in people]
    moved = [model.joint_transforms(person.poses, person.betas, person.trans) for person in people]
    return [
        [shape.posed(m[t]) if person.valid[t] else np.zeros((0, 7)) for person, shape, m in zip(people, shapes, moved)]
        for t in range(len(people[0].poses))
    ]


def people_positions(people: Sequence[Person], frame: int) -> tuple[Float[np.ndarray, "A 2"], Float[np.ndarray, "B 2"]]:
    """Positions of people measured at a frame, and possible positions of unmeasured ones, without absent people."""
    sure = [person.trans[frame, :2] for person in people if person.valid[frame]]
    guessed = [person.trans[frame, :2] for person in people if person.present[frame] and not person.valid[frame]]
    return np.reshape(sure, (-1, 2)), np.reshape(guessed, (-1, 2))


def brightness_ratios(
    picture: Integer[np.ndarray, "H W 3"],
    plate: Float[np.ndarray, "H W 3"],
    free: Bool[np.ndarray, "H W"],
    points_m: Float[np.ndarray, "H W 3"],
    near_m: Float[np.ndarray, "A 2"],
    unsure_m: Float[np.ndarray, "B 2"],
    reach_m: float,
) -> Float[np.ndarray, "H W"]:
    """Ratio of a ``picture`` to the ``plate`` in 0..1, NaN where not ``free`` or of another colour.

    ``near_m``: positions of measured people; ``unsure_m``: possible positions of others, around which the ratio is
    unknown. The picture's exposure, measured from pixels far from all people, is divided out.
    """
    levels, before = picture.astype(np.float32), plate.astype(np.float32) * 255
    usable = free & (before.min(-1) > _DARKEST) & (np.maximum(levels, before).max(-1) < _BRIGHTEST)
    ratio = np.log(np.maximum(levels, 1)) - np.log(np.maximum(before, 1))
    level = ratio.mean(axis=-1)
    usable &= np.abs(ratio - level[..., None]).max(axis=-1) < _SAME_COLOUR
    far = usable & ~is_near(points_m, np.concatenate([near_m, unsure_m]), reach_m)
    exposure = float(np.median(level[far])) if far.sum() >= _MIN_PX else 0.0
    return np.where(usable & ~is_near(points_m, unsure_m, reach_m), np.exp(level - exposure), np.nan)


def estimate_light(
    observed: Sequence[FloorObservations],
    frames: Sequence[int],
    bodies: Sequence[Sequence[Float[np.ndarray, "C 7"]]],
    room_box: RoomBox,
    settings: LightSettings,
) -> Light:
    """The light that explains the floor's changes over ``frames``; not accepted if it fails on their last quarter."""
    nothing = Lamps(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    blank = Light(False, "", nothing, np.zeros(0), np.ones(0), 0.0, 0.0, settings.contact_m, room_box.standing_m)
    points, ratio = np.concatenate([o.points_m for o in observed]), np.concatenate([o.ratio for o in observed])
    later = np.arange(len(frames)) >= len(frames) - max(1, round(_HELD_OUT * len(frames)))
    some = (np.isfinite(ratio[:, ~later]).sum(axis=1) >= 2) & np.isfinite(ratio[:, later]).any(axis=1)
    if some.sum() < _MIN_PX:
        return replace(blank, reason="too little floor is visible near people over time to estimate the light")
    points, ratio = points[some], ratio[some]
    lamps, groups = lamp_patches(room_box, settings.spacing_m, points.mean(axis=0)), Groups.of(points)
    lost = np.empty((len(points), len(frames), 2 + len(lamps.radius_m)), np.float32)
    for k, t in enumerate(progress(frames, "moments with shadows")):
        lost[:, k] = light_losses(groups, bodies[t], lamps, settings.contact_m)
    falloff = lamps.falloff(points)
    usual = np.maximum(falloff.mean(axis=0), 1e-9)
    trial = _light(blank, fit_strengths(lost[:, ~later], falloff / usual, ratio[:, ~later]), lamps, usual)
    lit = LitPoints(trial, points)
    left = np.stack([lit.remaining_light(bodies[t]) for t in frames], axis=1)
    error, without = (_error(ratio, used, later) for used in (left, np.ones_like(left)))
    figures = {
        "error_held_out": error,
        "error_held_out_without": without,
        "pixels": len(points),
        "moments": len(frames),
    }
    if not error <= (1 - settings.min_gain) * without:
        verdict = (
            f"in validation pictures, the brightness of the floor near people is off by {without:.2%} without shadows "
            f"and by {error:.2%} with them"
        )
        return replace(blank, figures=figures, reason=f"{verdict}, so films have no shadows")
    # The light passed the check; now it is estimated from all pictures.
    found = _light(blank, fit_strengths(lost, falloff / usual, ratio), lamps, usual)
    verdict = (
        f"{len(found.share)} patches give {found.share.sum():.0%} of the light; in validation pictures, the "
        f"brightness of the floor near people is off by {error:.2%} instead of {without:.2%}"
    )
    return replace(found, accepted=True, figures=figures, reason=verdict)


def _error(ratio: np.ndarray, left: np.ndarray, later: np.ndarray) -> float:
    """Root mean square residual of ``left`` of the light in the ``later`` frames, with levels from those before."""
    seen, weight = np.nan_to_num(ratio), np.isfinite(ratio)
    own = unshaded_levels(seen[:, ~later], left[:, ~later], weight[:, ~later])
    return float(np.sqrt(np.mean((seen - own[:, None] * left)[weight & later] ** 2)))


def _light(blank: Light, found: np.ndarray, lamps: Lamps, usual: np.ndarray) -> Light:
    on = np.flatnonzero(found[2:])
    sky, contact = float(found[0]), float(found[1])
    return Light(False, "", lamps.take(on), found[2:][on], usual[on], sky, contact, blank.contact_m, blank.floor_m)


def run(
    settings: Settings,
    model: Path,
    fits: list[Path],
    body: Path,
    videos: list[Path],
    masks: list[Path],
    plates: list[Path],
    depths: list[Path],
    room_box: Path,
    light: Written,
) -> None:
    """Write the light that explains the shadows on the floor near people."""
    cameras, box, chosen = read_model(model.parent), read_room(room_box), settings.light
    require_one_each(cameras, videos=videos, masks=masks, plates=plates, depth_maps=depths)
    persons = [read_person(path) for path in fits]
    if not persons:
        raise UserError("no person is there to cast a shadow: delete moving_shadows from survey.force")
    bodies = bodies_over_time(persons, BodyModel.load(body))
    frames = spread_indices(len(bodies), chosen.pictures)
    at = np.array([person.trans[frames, :2] for person in persons])
    sure = np.array([person.valid[frames] for person in persons])
    observed = []
    for camera, video, mask, plate_path, depth in zip(cameras, videos, masks, plates, depths):
        plate, measured = read_plate(plate_path, camera.wh)
        points, floor = floor_points(camera, read_depth(depth, camera.wh)[0], box.standing_m)
        pixels = np.flatnonzero(floor & measured & is_near(points, at[sure], chosen.reach_m))
        pixels = pixels[:: max(1, -(-len(pixels) // chosen.points))]
        seam = np.ones((2 * max(1, round(_SEAM * camera.wh[0])) + 1,) * 2, np.uint8)
        ratio = np.full((len(pixels), len(frames)), np.nan)
        for k, frame in enumerate(map(int, frames)):
            free = measured & (cv2.dilate((read_frame(mask, frame) > 0).astype(np.uint8), seam) == 0)
            places = people_positions(persons, frame)
            ratio[:, k] = brightness_ratios(
                read_frame(video, frame), plate, free, points, *places, chosen.reach_m
            ).ravel()[pixels]
        observed.append(FloorObservations(points.reshape(-1, 3)[pixels], ratio))
    found = estimate_light(observed, frames.tolist(), bodies, box, chosen)
    say(f"light: {found.reason}")
    write_light(light, found)
