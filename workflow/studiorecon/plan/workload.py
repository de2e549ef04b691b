# SPDX-License-Identifier: Apache-2.0
"""The amount of work of a run, from its footage and settings, before the first job.

Every rule has one unit of work in which its time is nearly linear; ``prices`` has the cost of a unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.footage.source import FootageSource, open_source
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.plan.decisions import Plan
from studiorecon.render.kinds import read_film_settings
from studiorecon.scene.effects import COVERED_DEG
from studiorecon.studio.description import read_description

_MEGA = 1e6
ASSUMED_PEOPLE = 2
"""Number of people where no keypoints give it: most captures have one to three."""
# Share of the photos' pixels that no other photo shows in finer detail, in the demo.
_OWN = 0.65
# Frames of a film in which people are looked for before there are clocks: six seconds at 30 per second.
_FIRST_FRAMES = 180
# Gaussians in unseen parts, per square of ``fill_step_m``'s side in m², in the demo's room of 60 m².
_UNSEEN_M2 = 58.0
# The default steps of depth's catalogue of planes.
_PLANE_STEPS_M = (0.04, 0.06)
ON_DEMAND = {"objects_find": "dynamic_objects", "render_light": "moving_shadows", "render_shade": "moving_shadows"}
"""Rule → the effect that turns it on; counted only where ``survey.force`` turns the effect on."""


@dataclass(frozen=True)
class Footage:
    """The size of a capture, in numbers of cameras, frames, pixels and people; a ``synthetic`` one is filmed first."""

    training: int
    held_out: int
    detector_cameras: int
    frames: int
    wh: tuple[int, int]
    people: int
    people_known: bool = True
    synthetic: bool = False


@dataclass(frozen=True)
class Work:
    """The work of one rule: ``jobs``, each with ``units``."""

    jobs: int
    units: float


def measure_footage(plan: Plan, picture_fps: float) -> Footage:
    """The size of a plan's capture, from its files; raises UserError where one cannot be read.

    Recorded keypoints give the number of people: as many as two cameras see in the median frame.
    """
    count = plan.dataset.frame_count
    cameras = (
        len(plan.training),
        len(plan.held_out),
        len(set(plan.person_sources.detector_cameras) & set(plan.training)),
    )
    if plan.studio:
        described = read_description(Path(plan.description))
        return Footage(*cameras, described.frames, described.size, described.people, synthetic=True)
    first = plan.dataset.first_frame
    sources = {camera: open_source(path, picture_fps) for camera, path in plan.dataset.footage.items()}
    lengths = [
        source.frames
        + sum(open_source(path, picture_fps).frames for path in plan.dataset.chapters.get(camera, ())[1:])
        - first
        for camera, source in sources.items()
    ]
    frames = max(min([*lengths, *([count] if count else [])]), 1)
    widest = max((source.wh for source in sources.values()), key=max)
    if not plan.people:
        return Footage(*cameras, frames, widest, 0)
    recorded = [_people_in(plan.dataset.keypoints[c], sources[c]) for c in plan.training if c in plan.dataset.keypoints]
    people = max(sorted(recorded)[-2:][0], 1) if recorded else ASSUMED_PEOPLE
    return Footage(*cameras, frames, widest, people, people_known=bool(recorded))


def _people_in(keypoints: Path, source: FootageSource) -> int:
    """Number of people in one camera's keypoint files, in the median frame with any."""
    _, per_frame = np.unique(read_keypoints(keypoints, source.wh).frame, return_counts=True)
    return int(np.median(per_frame)) if len(per_frame) else 0


def segments_with_views(plan: Plan, config: Mapping[str, Any]) -> int:
    """Number of gaps that probably get synthesised views: all where cameras are too far apart for the survey.

    ``survey.force`` overrides this; decisions of an earlier run do not, so that repeated runs get the same plan.
    """
    if not config["background"]["views_share"]:
        return 0
    apart = 360.0 / max(len(plan.training), 1) > COVERED_DEG
    every = max(len(plan.segments) - (plan.forced_effects.get("closed_path") == "off"), 0)
    return every if plan.forced_effects.get("view_synthesis", "on" if apart else "off") == "on" else 0


def workload(
    footage: Footage, config: Mapping[str, Any], segments: int, forced: Mapping[str, str] | None = None
) -> dict[str, Work]:
    """Rule → its jobs and the units of each; ``forced`` effects add their rules.

    ``segments`` gaps get synthesised views. Megapixels count all pictures that a job reads.
    """
    width, height = _working(footage.wh, config["capture"]["width"])
    training, frames, people = footage.training, footage.frames, footage.people
    everyone = training + footage.held_out
    picture_mpx, filmed_mpx = width * height / _MEGA, footage.wh[0] * footage.wh[1] / _MEGA
    views, room, human = config["views"], config["background"], config["humans"]
    seeds = _OWN * training * picture_mpx / room["stride"] ** 2
    gaussians = _gaussians(room, seeds)
    heavy = 1.0 if config["detect"]["detector"] == "blazepose_heavy" else 1 / 3
    # Work of an observer of every frame of every camera, and of its pixels.
    looked_at = training * frames
    looked_at_mpx, scene_people = looked_at * picture_mpx, int(people > 0)
    work = {
        "studio_capture": Work(int(footage.synthetic), everyone * frames * filmed_mpx),
        # By frames: those of the first moments are not looked at again.
        "clocks_moments": Work(1, footage.detector_cameras * min(frames, _FIRST_FRAMES) * max(people, 1) * heavy),
        "detect_people": Work(footage.detector_cameras, max(frames - _FIRST_FRAMES, 0) * max(people, 1) * heavy),
        "detect_keypoints": Work(training, frames),
        "clocks_offsets": Work(1, looked_at),
        "capture_frames": Work(everyone, frames * filmed_mpx),
        "tracks_keypoints": Work(training, frames),
        "plates_clean": Work(training, min(config["plates"]["frames"], frames) * picture_mpx),
        "cameras_refine": Work(1, looked_at * people),
        "cameras_held_out": Work(1, footage.held_out * frames * people),
        "people_first_associate": Work(1, looked_at * people),
        "people_second_look": Work(footage.detector_cameras, frames * people),
        "people_associate": Work(1, looked_at * people),
        "people_fit": Work(people, frames),
        "people_overlay": Work(training * scene_people, frames * picture_mpx),
        "survey_decide": Work(1, looked_at_mpx),
        "objects_find": Work(scene_people, looked_at_mpx),
        "masks_segment": Work(training * scene_people, frames * picture_mpx),
        "views_synthesize": Work(segments, views["views_per_segment"] * picture_mpx),
        "background_train": Work(1, room["training"]["iterations"] * (gaussians + picture_mpx / 10)),
        "humans_train": Work(people, human["iterations"] * picture_mpx * (1 + human["gaussians"] / 1e4)),
        "render_light": Work(scene_people, looked_at_mpx),
        "render_shade": Work(scene_people, gaussians),
        **{rule: Work(1, seeds) for rule in ("deliver_player", "deliver_scene_glb", "deliver_export")},
        **_depth_work(training, (width, height), config["depth"]),
        **_film_work(footage, picture_mpx, config["render"]["shots"]),
    }
    wanted = {rule: (forced or {}).get(effect) == "on" for rule, effect in ON_DEMAND.items()}
    return {rule: one for rule, one in work.items() if one.jobs and wanted.get(rule, True)}


def _depth_work(training: int, wh: tuple[int, int], depth: Mapping[str, Any]) -> dict[str, Work]:
    planes = sum(base / depth[name] for base, name in zip(_PLANE_STEPS_M, ("horizontal_step_m", "wall_step_m"))) / 2
    sweep_mpx, refine_mpx = _mpx(*wh, depth["sweep_width"]), _mpx(*wh, depth["refine_width"])
    return {
        "depth_sweep": Work(training, training * sweep_mpx * planes),
        "depth_box": Work(1, training**2 * sweep_mpx),
        "depth_preview": Work(1, training * sweep_mpx),
        "depth_room": Work(1, training**2 * (sweep_mpx + depth["primitives"] * 0.014)),
        "depth_refine": Work(training, training * refine_mpx),
    }


def film_pictures(footage: Footage, config: Mapping[str, Any]) -> int:
    """Pictures of all films."""
    return sum(_pictures(shot, given, footage) for shot, given in config["render"]["shots"].items())


def _film_work(footage: Footage, picture_mpx: float, shots: Mapping[str, Any]) -> dict[str, Work]:
    looked_at = footage.training * footage.frames
    films = {shot: _pictures(shot, given, footage) for shot, given in shots.items()}
    films = {shot: pictures for shot, pictures in films.items() if pictures}
    drawn = sum(films.values()) + looked_at
    mean_drawn, mean_film = drawn / (len(films) + 1), sum(films.values()) / max(len(films), 1)
    scored = films.get("heldout", looked_at)
    return {
        "render_shot": Work(len(films) + 1, mean_drawn * picture_mpx),
        "enhance_shot": Work(len(films), mean_film * picture_mpx),
        "report_recognition": Work(int(footage.people > 0), scored * picture_mpx),
        "report_evaluate": Work(1, scored * picture_mpx),
        "report_page": Work(1, drawn * picture_mpx),
    }


def _working(wh: tuple[int, int], longer_side: int) -> tuple[int, int]:
    shrink = min(1.0, longer_side / max(wh)) if longer_side else 1.0
    return round(wh[0] * shrink), round(wh[1] * shrink)


def _mpx(width: int, height: int, at_most: int) -> float:
    shrink = min(1.0, at_most / width)
    return width * height * shrink**2 / _MEGA


def _gaussians(room: Mapping[str, Any], seeds: float) -> float:
    """Millions of Gaussians that the room is trained with: from the photos and in unseen parts, at most the cap."""
    cap = room["training"]["cap"] / _MEGA or float("inf")
    if room["training"]["densify"] != "none" and cap < float("inf"):
        return cap
    unseen = min(_UNSEEN_M2 / room["fill_step_m"] ** 2, room["fill_limit"]) if room["fill_unseen"] else 0.0
    return min(seeds + unseen / _MEGA, cap)


def _pictures(shot: str, given: Mapping[str, Any], footage: Footage) -> int:
    if given["kind"] == "heldout":
        return footage.held_out * footage.frames
    return int(getattr(read_film_settings(given, shot), "frames", footage.frames))
