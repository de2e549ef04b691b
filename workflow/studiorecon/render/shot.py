# SPDX-License-Identifier: Apache-2.0
"""``render.shot``: draws one shot of the 4D scene: pictures, depth and truth map, from a single rasterisation."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.keypoints.layouts import JOINT_NAMES
from studiorecon.progress import progress, say
from studiorecon.render.composite import Composite, to_millimetres, truth_levels
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.render.draw_settings import DrawSettings
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.planning import plan_steps
from studiorecon.render.replacement import replace_people
from studiorecon.render.room_light import read_light
from studiorecon.render.shading import build_shading
from studiorecon.render.statistics import (
    PictureStatistics,
    angles_deg,
    nearby_obstacles,
    provenance_shares,
    write_ledger,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.path import PathStep, write_path
from studiorecon.signature import Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Frames in which it is asked which joints the cameras have in view.
_LOOKED = 16


@dataclass(frozen=True)
class Settings(DrawSettings):
    """Settings of drawing films."""

    width: int = setting(
        0,
        "Width of films; 0 = the working width.",
        minimum=0,
        maximum=16384,
        paper="1280",
        paper_value=1280,
    )
    background_rgb: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), "Colour where nothing was reconstructed, RGB.", minimum=0, maximum=1
    )
    # Orbits, oscillations and following cameras keep this distance to solid background by moving inwards.
    clearance_m: float = 0.3


def aim_m(person: Avatar, cameras: Sequence[Camera]) -> Float[np.ndarray, "T 3"]:
    """Where a film aims at a person, metres: the pelvis, or the middle of the joints that two cameras have in view.

    Of somebody at a desk the pelvis is below the pictures. The middle keeps its mean offset from the pelvis.
    """
    pelvis_m, there = np.asarray(person.trans, np.float64), np.flatnonzero(person.present)
    if not len(there):
        return pelvis_m
    looked = there[spread_indices(len(there), _LOOKED)]
    joints_m = np.stack([person.joints_m(frame)[: len(JOINT_NAMES)] for frame in looked])
    views = np.zeros(joints_m.shape[:2])
    for camera in cameras:
        pixels, depth_m = camera.project(joints_m)
        views += (depth_m > 0) & (pixels >= 0).all(-1) & (pixels < camera.wh).all(-1)
    in_view = np.median(views, axis=0) >= 2
    if in_view[0] or not in_view.any():
        return pelvis_m
    return pelvis_m + (joints_m[:, in_view].mean(axis=1) - pelvis_m[looked]).mean(axis=0)


def find_targets(people: Sequence[Avatar], cameras: Sequence[Camera], frames: int, fps: float) -> LookAtTargets:
    """The possible targets of a scene's shots."""
    aims = {person.person: aim_m(person, cameras) for person in people}
    facing = {person.person: person.facing() for person in people}
    present = {person.person: person.present for person in people}
    centre_m = scene_centre(cameras)
    reach_m = float(np.median([np.linalg.norm((camera.centre_m - centre_m)[:2]) for camera in cameras]))
    return LookAtTargets(aims, facing, present, centre_m, frames, fps, reach_m)


def draw_step(
    canvas: CompositeRenderer, step: PathStep, background_rgb: tuple[float, float, float]
) -> tuple[Integer[np.ndarray, "H W 3"], Integer[np.ndarray, "H W"], Integer[np.ndarray, "H W"]]:
    """Uint8 picture, uint8 truth map and uint16 depth in millimetres of one step."""
    rendering, shares = canvas.draw(step.camera, step.frame, background_rgb)
    return to_bytes(rendering.rgb), truth_levels(shares), to_millimetres(rendering.depth_m)


def read_composite(
    files: SceneFiles, shot: str, shots: Mapping, light: Sequence[Path] = (), stand_ins: Sequence[Path] = ()
) -> Composite:
    """Background, people and objects, with the shot's replacements, and shadows if there is a ``light``.

    Raises UserError when the provenance belongs to another background.
    """
    (static, classes), people, things = files.room(), files.people(), files.things()
    cast = replace_people(people, shots.get(shot, {}).get("replace", {}), shot, stand_ins)
    shade = build_shading(read_light(light[0]), static, cast, people, things) if light else None
    names = {person.person for person in cast}
    return Composite(static, classes, cast, shade, things, [person for person in people if person.person not in names])


def _of_frames(writer: Callable[..., object]) -> Callable[[Iterator[np.ndarray]], object]:
    return lambda frames: writer(frames=frames)


def run(
    settings: Settings,
    shot: str,
    model: Path,
    heldout_model: Path | None,
    manifest: Path,
    files: SceneFiles,
    video: Written,
    truth: Written,
    depth: Written,
    path: Written,
    ledger: Written,
    light: list[Path] | None = None,
    stand_ins: list[Path] | None = None,
    device: str = "cpu",
) -> None:
    """Render one shot; without people files it shows the background alone, without ``light`` no shadows."""
    capture = read_manifest(manifest)
    training = read_model(model.parent)
    held_out = read_model(heldout_model.parent) if heldout_model is not None else []
    scene = read_composite(files, shot, settings.shots, light or (), stand_ins or ())
    everybody = typing.cast("list[Avatar]", [*scene.people, *scene.absent])  # as read_composite made them
    captured = sorted(everybody, key=lambda person: person.person)
    subjects = find_targets(captured, training, capture.frames, capture.fps)
    steps = plan_steps(
        shot, settings.shots, settings.width, settings.clearance_m, training, held_out, subjects, scene.background
    )
    say(
        f"shot {shot}: {len(steps)} pictures of {scene.background.count} background "
        f"Gaussians and {len(scene.people)} people"
    )
    for person in scene.people:
        away = sum(not np.isfinite(person.joints_m(step.frame)).all() for step in steps)
        if away:
            say(f"shot {shot} shows {person.person} in {len(steps) - away} pictures; in {away} {person.person} is away")
    for thing in scene.objects:
        absent = sum(not np.isfinite(thing.joints_m(step.frame)).all() for step in steps)
        say(
            f"shot {shot} shows {thing.person} in {len(steps) - absent} pictures; in {absent} its position is unknown, "
            "and it is left out"
        )
    canvas = CompositeRenderer(scene, settings.near_m, resolve(device))
    around = zip(angles_deg(steps, training, subjects.scene_m), nearby_obstacles(steps, scene, settings.clearance_m))
    entries = []
    writers = [partial(write_lossless, target, fps=capture.fps) for target in (video, truth, depth)]
    with parallel_writers([_of_frames(writer) for writer in writers]) as put:
        for index, (step, (angle, near)) in enumerate(zip(progress(steps, f"pictures of {shot}"), around)):
            rgb, truth_map, depth_mm = draw_step(canvas, step, settings.background_rgb)
            entries.append(
                PictureStatistics(index, step.segment, step.frame, *provenance_shares(truth_map), float(angle), near)
            )
            put(rgb, truth_map, depth_mm)
    write_path(path, steps, capture.fps)
    write_ledger(ledger, entries)
    measured, inferred, invented = 100 * np.mean([[e.measured, e.inferred, e.invented] for e in entries], axis=0)
    say(f"shot {shot} is {measured:.0f} % measured, {inferred:.0f} % inferred and {invented:.0f} % invented")
