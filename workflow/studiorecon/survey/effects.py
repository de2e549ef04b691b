# SPDX-License-Identifier: Apache-2.0
"""All that can be decided before training, in the order in which one effect hides another (evaluation §3.19)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.geometry.triangulation import Limits
from studiorecon.images.plate import noise_levels
from studiorecon.images.stills import shrink
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision, Early, decide, in_order, not_measured
from studiorecon.scene.intervals import NOTHING, Estimate
from studiorecon.splatting.harmonics import degree_supported
from studiorecon.survey import detail, events, gloss, motion, stillness
from studiorecon.survey.bodies import Tracks, in_world
from studiorecon.survey.coverage import decide_ring, decide_views, stage
from studiorecon.survey.exposures import View, decide_exposure
from studiorecon.survey.films import Film, halved
from studiorecon.survey.rays import causes

# What counts as agreement of rays (numerics U34, T01, T06).
_LIMITS = Limits(min_confidence=0.0, huber_share=0.005, outlier_units=3.0, min_angle_deg=2.0, near_m=0.05)
_WRISTS, _NOSE, _ANKLES = ("left_wrist", "right_wrist"), ("nose",), ("left_ankle", "right_ankle")
# Plates hold the median of many pictures: their noise is a picture's over the root of about so many.
_PLATE_PICTURES = 16
# Statistics that compare pictures over time or between cameras at places that the calibration gives.
_NEED_STILL_CAMERAS = frozenset(
    {"exposure", "changing_light", "lens_distortion", "sync_offset", "rolling_shutter", "view_dependent_colour", "moving_shadows",
     "dynamic_objects"}
)  # fmt: skip
# Who acts on a verdict. What is not named here informs the reader, and nothing else yet.
OBEYED_BY = {
    "moving_shadows": "the plan: the light is estimated (render.light) and people throw shadows in films only when on",
    "people": "the plan: without people there are no masks, bodies and human training",
    "view_synthesis": "the plan: views between the cameras are made only when on",
    "dynamic_objects": "the plan: things are followed (humans.objects), shown in films and kept out of people's masks only when on",
    "exposure": "views, background.train, humans.train and enhance.shot: when on they divide every photo by its camera's gain",
    "view_dependent_colour": "background.train: unless on, with sh_cap, the room's colours have no harmonics",
    "changing_light": "masks.segment, humans.train and enhance.shot: when on they divide every frame by its brightness against the plate; "
    "films are in the plates' constant light",
}


@dataclass(frozen=True)
class Settings:
    """Thresholds and how much is looked at.

    Attributes:
        thresholds: effect → the value from which it is on.
        gap_deg: between neighbouring cameras nothing needs to be synthesised when they are at most this far apart.
        grid_m, height_m: step and height of the points of the stage.
        depth_tolerance: share of depth within which two depths are one surface.
        pictures, run: pictures of every camera that are looked at, in runs of so many without a gap.
        longest_px: longer side of those pictures.
        moments: frames of keypoints that lens, clocks and readout are judged by.
        search_s: largest lag of a clock that is looked for.
        min_confidence: keypoints below it are not used.
        force: effect → "on" or "off".
    """

    thresholds: Mapping[Early, float]
    gap_deg: float
    grid_m: float
    height_m: float
    depth_tolerance: float
    pictures: int
    run: int
    longest_px: int
    moments: int
    search_s: float
    min_confidence: float
    force: Mapping[Early, str]


@dataclass(frozen=True)
class Material:
    """What is known of a scene before training.

    Attributes:
        cameras: training cameras.
        people: who was found; None when the dataset says the room is empty.
        views: every camera's clean plate and depth.
        films: every camera's pictures over time.
        tracks: people's keypoints.
        floor_m: height of the floor.
        fps: frames per second.
    """

    cameras: Sequence[Camera]
    people: Sequence[str] | None
    views: Sequence[View]
    films: Sequence[Film]
    tracks: Tracks
    floor_m: float
    fps: float


def judge(material: Material, settings: Settings, was_on: Collection[str] = ()) -> list[Decision]:
    """One decision for every effect that shows before training; ``was_on`` names those that an earlier survey found."""
    limit, cameras = settings.thresholds, material.cameras
    names = [c.name for c in cameras]
    made = [_moving(material, limit["moving_cameras"], "moving_cameras" in was_on), decide_people(material.people)]
    exposure, gains = decide_exposure(material.views, settings.depth_tolerance, limit["exposure"], "exposure" in was_on)
    small = [halved(film) for film in material.films]
    light = [stillness.light(film.pictures, film.free) for film in small]
    made += [exposure, stillness.decide_light(names, light, limit["changing_light"], "changing_light" in was_on)]
    search = round(settings.search_s * material.fps)
    found = causes(material.tracks.pixels, cameras, settings.moments, search, _LIMITS)
    made += [
        motion.decide_lens(cameras, found, limit["lens_distortion"], "lens_distortion" in was_on),
        motion.decide_sync(cameras, found, limit["sync_offset"], "sync_offset" in was_on),
        motion.decide_readout(cameras, found, limit["rolling_shutter"], "rolling_shutter" in was_on),
        detail.decide_shift(
            names, [detail.depth_spread(v.depth_m) for v in material.views], limit["depth_shift"], "depth_shift" in was_on
        ),
        decide_ring(cameras, limit["closed_path"], "closed_path" in was_on),
        decide_views(
            cameras, [v.depth_m for v in material.views], grid_m=settings.grid_m, height_m=settings.height_m,
            tolerance=settings.depth_tolerance, gap_deg=settings.gap_deg, threshold=limit["view_synthesis"],
            was_on="view_synthesis" in was_on,
        ),
        _gloss(material, gains, settings, "view_dependent_colour" in was_on),
        *_parts(material, limit, was_on),
        not_measured(
            "vertex_term", "median triangulation residual of surface points over that of joints", limit["vertex_term"],
            "only a network's bodies bring surface points; what they count for is people.fit.vertex_weight", on_above=False,
        ),
        *_events(material, small, light, limit, was_on),
    ]  # fmt: skip
    moving = made[0].verdict == "on"
    made = [_void(d) if moving and d.effect in _NEED_STILL_CAMERAS else d for d in made]
    return in_order([replace(d, obeyed_by=OBEYED_BY.get(d.effect, "")) for d in made])


def decide_people(found: Sequence[str] | None) -> Decision:
    """Are there people? ``found`` is None when the dataset says the room is empty."""
    count = len(found or ())
    if found is None:
        reason = "the dataset says that nobody is there; the film shows the room alone"
    elif not found:
        reason = "nobody was seen by enough cameras; the film shows the room alone"
    else:
        reason = f"{', '.join(found)} will be reconstructed, each on its own"
    return decide("people", "persons followed by several cameras", float(count), (float(count),) * 2, 0.5, reason)


def _moving(material: Material, threshold_px: float, was_on: bool) -> Decision:
    # The first picture of every run is enough: who moves a camera leaves it moved, and a shake shows in some of them.
    shifts = []
    for film in material.films:
        later = [*(run.start for run in film.runs[1:]), len(film.times) - 1]
        free = [film.free[0] & film.free[t] for t in later]
        found = [stillness.block_shifts(film.pictures[0], film.pictures[t], f) for t, f in zip(later, free)]
        shifts.append(np.stack(found))
    names, scales = [f.camera.name for f in material.films], [f.scale for f in material.films]
    return stillness.decide_still(names, shifts, scales, threshold_px, was_on)


def _gloss(material: Material, gains: np.ndarray, settings: Settings, was_on: bool) -> Decision:
    noise = float(np.median([noise_levels(f.pictures) for f in material.films])) / 255 / np.sqrt(_PLATE_PICTURES)
    colours, errors = gloss.covisible(material.views, gains, noise, settings.depth_tolerance)
    centre = np.array([*stage(material.cameras)[0], material.floor_m + settings.height_m / 2])
    degree = degree_supported(np.array([c.centre_m - centre for c in material.cameras]))
    return gloss.decide_gloss(gloss.varying_share(colours, errors), degree, settings.thresholds["view_dependent_colour"], was_on)


def _parts(material: Material, limit: Mapping[str, float], was_on: Collection[str]) -> list[Decision]:
    made = []
    for effect, names, size_m in (("hands", _WRISTS, detail.HAND_M), ("face", _NOSE, detail.HEAD_M)):
        points, confidence = in_world(material.tracks, names, material.cameras, _LIMITS)
        # Left and right, and everybody, one after the other: frames in which some hand is seen.
        height, sure = detail.resolved_px(points.reshape(-1, 3), confidence.reshape(len(material.cameras), -1), material.cameras, size_m)
        missing = "" if points.size else f"no keypoints named {' or '.join(names)} are there"
        made.append(detail.decide_part(effect, height, sure, limit[effect], missing, effect in was_on))
    return made


def _events(
    material: Material,
    films: Sequence[Film],
    light: Sequence[tuple[np.ndarray, np.ndarray]],
    limit: Mapping[str, float],
    was_on: Collection[str],
) -> list[Decision]:
    """Shadows and things; ``films`` are the material's at half their size."""
    feet = in_world(material.tracks, _ANKLES, material.cameras, _LIMITS)[0]
    shadows: list[Estimate] = []
    objects: list[Estimate] = []
    for small, view, (drift, _) in zip(films, material.views, light, strict=True):
        hw = small.pictures.shape[1:3]
        wh = (hw[1], hw[0])
        camera = view.camera.resized(wh)
        plate, measured = shrink(view.rgb, view.measured, wh)
        rows, columns = (((np.arange(n) + 0.5) * full / n).astype(int) for n, full in zip(hw, view.depth_m.shape))
        depth_m = view.depth_m[rows][:, columns]
        free = small.free & measured
        ratio = events.relative(small.pictures, plate, drift, free)
        objects.append(events.moving_share(ratio, free, plate.mean(axis=-1) * 255, noise_levels(small.pictures), small.runs))
        theirs = feet[:, small.times].transpose(0, 2, 1, 3).reshape(-1, len(small.times), 3)
        ring = events.floor_ring(camera, depth_m, material.floor_m, theirs)
        shadows.append(events.shadow_share(ratio, free, ring, small.runs) if ring.any() else NOTHING)
    names = [c.name for c in material.cameras]
    return [
        events.decide_shadows(names, shadows, limit["moving_shadows"], "moving_shadows" in was_on),
        events.decide_objects(names, objects, limit["dynamic_objects"], "dynamic_objects" in was_on),
    ]


def _void(decision: Decision) -> Decision:
    return replace(
        decision, value=None, interval=None, verdict="undetermined",
        reason="the cameras move, which voids this measurement: steady the footage, or leave the moving camera out with train: [...]",
    )  # fmt: skip
