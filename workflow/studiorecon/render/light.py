# SPDX-License-Identifier: Apache-2.0
"""``render.light``: the light of the room from the shadows that people throw on its floor, checked on pictures it was not fitted to.

Only in the plan when the survey finds moving shadows, and somebody to throw them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.occluders import occluder
from studiorecon.errors import Refusal
from studiorecon.images.exr import read_depth
from studiorecon.images.seeking import read_frame_at
from studiorecon.images.stills import read_plate
from studiorecon.progress import progress, say
from studiorecon.render.lamps import losses, patches, strengths
from studiorecon.scene.camera import Camera
from studiorecon.scene.colmap import read_model
from studiorecon.scene.light import Lamps, Light, write_light
from studiorecon.scene.people import Person, read_person
from studiorecon.scene.shell import Shell, read_shell

_FLOOR_M = 0.06
# Levels of 255 between which a ratio means something; a change of colour beyond this is no shadow (log).
_DARKEST, _BRIGHTEST, _SAME_COLOUR = 12.0, 250.0, 0.08
# Nobody's shadow reaches so far that fewer pixels than these say how bright a picture is.
_LEAST_PX = 200
# Masks are grown by this share of the picture's width: their seams hold mixed colours.
_SEAM = 0.006
_HELD_OUT = 0.25


@dataclass(frozen=True)
class LightSettings:
    """How the light is estimated.

    Attributes:
        pictures: of every camera that are looked at, evenly over the clip.
        points: of the floor in every picture.
        reach_m: around people within which the floor is looked at.
        spacing_m: between the patches of ceiling and walls that may give light.
        contact_m: reach of the darkening beside a body that hides light from everywhere.
        least_gain: share by which the error on held-out pictures must fall.
    """

    pictures: int
    points: int
    reach_m: float
    spacing_m: float
    contact_m: float
    least_gain: float


@dataclass(frozen=True)
class Settings:
    light: LightSettings


@dataclass(frozen=True)
class Observed:
    """Floor beside people in one picture: points (N, 3), and by which share each is darker than the plate (N,)."""

    frame: int
    points_m: np.ndarray
    darker: np.ndarray


def bodies_over_time(people: Sequence[Person], model: BodyModel) -> list[list[np.ndarray]]:
    """Per frame the capsules (C, 7) of every person; none of who was not measured there.

    Raises Refusal when a body was fitted with another body model.
    """
    for person in people:
        if person.body != model.identity:
            raise Refusal(f"{person.name} was fitted with the body model {person.body}, not {model.identity}; use the same body file")
    shapes = [occluder(model, person.betas) for person in people]
    moved = [model.joint_transforms(person.poses, person.betas, person.trans) for person in people]
    return [
        [shape.posed(m[t]) if person.valid[t] else np.zeros((0, 7)) for person, shape, m in zip(people, shapes, moved)]
        for t in range(len(people[0].poses))
    ]


def floor_points(camera: Camera, depth_m: np.ndarray, floor_m: float) -> tuple[np.ndarray, np.ndarray]:
    """World points (H, W, 3) of the floor's pixels, and which those are (H, W): depth and the floor's height must agree."""
    known = np.isfinite(depth_m) & (depth_m > 0)
    points = camera.unproject(camera.pixel_centres().reshape(-1, 2), np.where(known, depth_m, 1.0).reshape(-1)).reshape(*camera.hw, 3)
    return points, known & (np.abs(points[..., 2] - floor_m) < _FLOOR_M)


def observe(
    picture: np.ndarray, plate: np.ndarray, free: np.ndarray, points_m: np.ndarray, floor: np.ndarray,
    near_m: np.ndarray, unsure_m: np.ndarray, settings: LightSettings, frame: int,
) -> Observed:  # fmt: skip
    """The floor beside people in a ``picture`` (H, W, 3) uint8 against the ``plate`` (H, W, 3) in 0..1, where ``free`` (H, W).

    ``near_m`` (P, 2): where people stand who were measured; ``unsure_m`` (Q, 2): where others may, whose surroundings are left out. What
    far pixels differ by, the picture's exposure, is taken off.
    """
    levels, before = picture.astype(np.float32), plate.astype(np.float32) * 255
    usable = free & (before.min(-1) > _DARKEST) & (np.maximum(levels, before).max(-1) < _BRIGHTEST)
    ratio = np.log(np.maximum(levels, 1)) - np.log(np.maximum(before, 1))
    level = ratio.mean(axis=-1)
    usable &= np.abs(ratio - level[..., None]).max(axis=-1) < _SAME_COLOUR

    def beside(places: np.ndarray, reach_m: float) -> np.ndarray:
        found = np.zeros(floor.shape, bool)
        for x, y in places:
            found |= np.hypot(points_m[..., 0] - x, points_m[..., 1] - y) < reach_m
        return found

    far = usable & ~beside(np.concatenate([near_m, unsure_m]), settings.reach_m)
    exposure = float(np.median(level[far])) if far.sum() >= _LEAST_PX else 0.0
    chosen = np.flatnonzero(usable & floor & beside(near_m, settings.reach_m) & ~beside(unsure_m, settings.reach_m))
    chosen = chosen[:: max(1, -(-len(chosen) // settings.points))]
    return Observed(frame, points_m.reshape(-1, 3)[chosen], 1 - np.exp(level.ravel()[chosen] - exposure))


def estimate(observed: Sequence[Observed], bodies: Sequence[Sequence[np.ndarray]], shell: Shell, settings: LightSettings) -> Light:
    """The light that explains what was observed; not kept where it does not explain the last quarter from the rest."""
    floor_m = float(shell.low_m[2])
    nothing = np.zeros((0, 3))
    blank = Light(False, "", Lamps(nothing, nothing, np.zeros(0)), np.zeros(0), np.ones(0), 0.0, 0.0, settings.contact_m, floor_m)
    seen = sorted({o.frame for o in observed if len(o.darker)})
    if len(seen) < 2:
        return _left_out(blank, "no floor is seen beside anybody in two pictures, so there is no shadow to tell the light from")
    lamps = patches(shell, settings.spacing_m)
    sets = [o for o in observed if len(o.darker)]
    points, darker = np.concatenate([o.points_m for o in sets]), np.concatenate([o.darker for o in sets])
    frame = np.concatenate([np.full(len(o.darker), o.frame) for o in sets])
    lost = np.concatenate([losses(o.points_m, bodies[o.frame], lamps, settings.contact_m) for o in progress(sets, "pictures with shadows")])
    falloff = lamps.falloff(points)
    usual = np.maximum(falloff.mean(axis=0), 1e-9)
    later = frame >= seen[-max(1, round(_HELD_OUT * len(seen)))]
    first = strengths(lost[~later], (falloff / usual)[~later], darker[~later])
    trial = _light(blank, first, lamps, usual)
    after = np.concatenate([trial.factor(o.points_m, bodies[o.frame]) for o in sets if o.frame >= frame[later].min()])
    error = float(np.sqrt(np.mean((darker[later] - (1 - after)) ** 2)))
    without = float(np.sqrt(np.mean(darker[later] ** 2)))
    figures = {
        "error_held_out": error, "error_held_out_without": without, "points": len(points), "pictures": len(sets), "frames": len(seen),
        "darkest_5_percent": float(np.quantile(darker, 0.95)),
    }  # fmt: skip
    if not error <= (1 - settings.least_gain) * without:
        sentence = f"the floor beside people is off by {without:.2%} without shadows and by {error:.2%} with them in pictures not fitted to"
        return _left_out(_with_figures(blank, figures), f"{sentence}: films are made without")
    # What was found holds; now from all pictures.
    found = _light(blank, strengths(lost, falloff / usual, darker), lamps, usual)
    sentence = (
        f"{len(found.share)} patches of lamps give {found.share.sum():.0%} of the floor's light, and the floor beside people is off by "
        f"{error:.2%} instead of {without:.2%} in pictures not fitted to"
    )
    return _with_figures(found, figures, True, sentence)


def _light(blank: Light, found: np.ndarray, lamps: Lamps, usual: np.ndarray) -> Light:
    on = np.flatnonzero(found[2:])
    sky, contact = float(found[0]), float(found[1])
    return Light(False, "", lamps.take(on), found[2:][on], usual[on], sky, contact, blank.contact_m, blank.floor_m)


def _left_out(light: Light, reason: str) -> Light:
    return _with_figures(light, light.figures, False, reason)


def _with_figures(light: Light, figures: dict, kept: bool = False, reason: str = "") -> Light:
    return Light(
        kept, reason, light.lamps, light.share, light.usual, light.sky, light.contact, light.contact_m, light.floor_m, figures
    )  # fmt: skip


def run(
    settings: Settings,
    model: Path,
    people: list[Path],
    body: Path,
    videos: list[Path],
    masks: list[Path],
    plates: list[Path],
    depths: list[Path],
    shell: Path,
    light: Path,
) -> None:
    """Look at the floor beside people and write what light explains its shadows."""
    cameras, box, chosen = read_model(model.parent), read_shell(shell), settings.light
    if not len(cameras) == len(videos) == len(masks) == len(plates) == len(depths):
        raise Refusal(
            f"{len(cameras)} training cameras, but {len(videos)} videos, {len(masks)} masks, {len(plates)} plates and {len(depths)} depth "
            "maps; one of each is needed per camera"
        )
    fits = [read_person(path) for path in people]
    if not fits:
        raise Refusal("nobody is there to throw a shadow: leave moving_shadows out of survey.force")
    bodies = bodies_over_time(fits, BodyModel.load(body))
    frames = np.unique(np.linspace(0, len(bodies) - 1, min(chosen.pictures, len(bodies))).round().astype(int))
    observed = []
    for camera, video, mask, plate_path, depth in zip(cameras, videos, masks, plates, depths):
        plate, measured = read_plate(plate_path)
        points, floor = floor_points(camera, read_depth(depth)[0], float(box.low_m[2]))
        seam = np.ones((2 * max(1, round(_SEAM * camera.wh[0])) + 1,) * 2, np.uint8)
        for frame in frames:
            somebody = cv2.dilate((read_frame_at(mask, int(frame)) > 0).astype(np.uint8), seam) > 0
            at = np.array([person.trans[frame, :2] for person in fits])
            sure = np.array([person.valid[frame] for person in fits])
            free = measured & ~somebody
            observed.append(
                observe(read_frame_at(video, int(frame)), plate, free, points, floor, at[sure], at[~sure], chosen, int(frame))
            )  # fmt: skip
    found = estimate(observed, bodies, box, chosen)
    say(f"light: {found.reason}")
    write_light(light, found)
