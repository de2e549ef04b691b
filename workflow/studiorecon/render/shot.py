# SPDX-License-Identifier: Apache-2.0
"""``render.shot``: one shot of the 4D scene: pictures, depth and truth map, from a single rasterisation of background and people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon import settings as settings_module
from studiorecon.body.avatar import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.errors import Refusal
from studiorecon.geometry.path import scene_centre
from studiorecon.images.streams import writing
from studiorecon.images.video import to_bytes, write_lossless
from studiorecon.progress import progress, say
from studiorecon.render.canvas import Canvas
from studiorecon.render.composite import TRUTH_LEVELS, Composite, blocked, millimetres, truth_levels
from studiorecon.render.shots import Orbit, every_frame, orbit_steps, smooth_dips
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import Step, write_path


@dataclass(frozen=True)
class Settings:
    shots: dict
    width: int
    background_rgb: tuple[float, float, float]
    near_m: float
    clearance_m: float


# Where an orbit stands in something it is tried with these factors on its radius, widest first.
_SHRINK = (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)


def picture_size(cameras: Sequence[Camera], width: int) -> tuple[int, int]:
    """Even width and height of a film: the first training camera's shape, at ``width`` pixels unless that is 0."""
    own_width, own_height = cameras[0].wh
    wanted = width or own_width
    return wanted // 2 * 2, round(wanted * own_height / own_width / 2) * 2


def plan(
    shot: str,
    settings: Settings,
    training: Sequence[Camera],
    held_out: Sequence[Camera],
    frames: int,
    scene: Composite,
    people_m: np.ndarray,
) -> list[Step]:
    """The pictures of a shot over ``frames`` frames; ``people_m`` (M, 3) are positions people took: an orbit looks at their middle.

    Raises Refusal for a shot that is not configured or cannot be made of these cameras.
    """
    if shot == "train":
        return every_frame(training, frames)
    if shot not in settings.shots:
        raise Refusal(f"there is no shot {shot!r} under render.shots; it names {', '.join(settings.shots) or 'none'}")
    described: Mapping[str, Any] = settings.shots[shot]
    kind = described.get("kind")
    if kind == "heldout":
        if not held_out:
            raise Refusal(f"shot {shot} shows the held-out cameras, but there are none; name some under held_out in capture.yaml")
        return every_frame(held_out, frames)
    if kind != "orbit":
        raise Refusal(f"shot {shot} is of kind {kind!r}; known kinds are orbit and heldout")
    orbit = settings_module.load(Orbit, described, f"render.shots.{shot}")
    target = np.median(people_m, axis=0) if len(people_m) else scene_centre(training)
    say(f"shot {shot} looks at {'the middle of the people' if len(people_m) else 'where the cameras look'}, {_metres(target)}")
    wh = picture_size(training, settings.width)

    def steps(shrink: np.ndarray) -> list[Step]:
        return orbit_steps(orbit, shot, training, target, wh, frames, shrink)

    return clear_orbit(steps, orbit.frames, shot, scene.background, settings.clearance_m)


def clear_orbit(
    orbit: Callable[[np.ndarray], list[Step]], pictures: int, shot: str, background: Gaussians, clearance_m: float
) -> list[Step]:
    """An orbit that comes closer to its centre where it would pass within ``clearance_m`` of solid background.

    ``orbit`` makes the steps from a factor on the radius of each picture. Where none of the factors tried is clear, the orbit is left
    as wide as it was, and says so.
    """
    inside = np.array([_blocked(orbit(np.full(pictures, shrink)), background, clearance_m) for shrink in _SHRINK])
    clear = ~inside.all(axis=0)
    factors = np.where(clear, np.array(_SHRINK)[np.argmin(inside, axis=0)], 1.0)
    steps = orbit(smooth_dips(factors))
    if inside[0].any():
        left = int(_blocked(steps, background, clearance_m).sum())
        say(
            f"shot {shot} would pass within {clearance_m} m of walls or furniture in {inside[0].sum()} pictures and steps inwards there, "
            f"by up to {100 - 100 * factors.min():.0f} %; {left} pictures remain that close"
        )
    return steps


def _blocked(steps: list[Step], background: Gaussians, clearance_m: float) -> np.ndarray:
    return blocked(np.array([step.camera.centre_m for step in steps]), background, clearance_m)


def picture(canvas: Canvas, step: Step, background_rgb: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 picture, (H, W) uint8 truth map and (H, W) uint16 depth in millimetres of one step."""
    rendering, shares = canvas.draw(step.camera, step.frame, background_rgb)
    return to_bytes(rendering.rgb), truth_levels(shares), millimetres(rendering.depth_m)


def run(
    settings: Settings,
    shot: str,
    model: Path,
    heldout_model: Path | None,
    manifest: Path,
    background: Path,
    provenance: Path,
    gaussians: list[Path],
    avatars: list[Path],
    body: Path | None,
    video: Path,
    truth: Path,
    depth: Path,
    path: Path,
) -> None:
    """Render one shot; without people files the film shows the background alone."""
    capture = read_manifest(manifest)
    training = read_model(model.parent)
    held_out = read_model(heldout_model.parent) if heldout_model is not None else []
    body_model = BodyModel.load(body) if avatars else None
    people = [read_avatar(ply, npz, body_model) for ply, npz in zip(gaussians, avatars, strict=True)]
    scene = _scene(background, provenance, people)
    positions = np.concatenate([np.asarray(person.trans, np.float64) for person in people]) if people else np.zeros((0, 3))
    steps = plan(shot, settings, training, held_out, capture.frames, scene, positions)
    say(f"shot {shot}: {len(steps)} pictures of {scene.background.count} background Gaussians and {len(people)} people")
    canvas = Canvas(scene, settings.near_m)
    counted = np.zeros(256, np.int64)
    writers = [partial(write_lossless, target, fps=capture.fps) for target in (video, truth, depth)]
    with writing([lambda frames, w=w: w(frames=frames) for w in writers]) as put:
        for step in progress(steps, f"pictures of {shot}"):
            rgb, truth_map, depth_mm = picture(canvas, step, settings.background_rgb)
            counted += np.bincount(truth_map.ravel(), minlength=256)
            put(rgb, truth_map, depth_mm)
    write_path(path, steps, capture.fps)
    measured, inferred, invented = 100 * counted[TRUTH_LEVELS] / counted.sum()
    say(f"shot {shot} is {measured:.0f} % measured, {inferred:.0f} % inferred and {invented:.0f} % invented")


def _scene(background: Path, provenance: Path, people: list) -> Composite:
    static = read_ply(background)
    with np.load(provenance, allow_pickle=False) as data:
        classes = np.asarray(data["provenance"], np.uint8)
    if len(classes) != static.count or (len(classes) and classes.max() > len(TRUTH_LEVELS) - 1):
        raise Refusal(f"{provenance} does not describe the {static.count} Gaussians of {background}; make the background again")
    return Composite(static, classes, people)


def _metres(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.2f}" for v in point) + ") m"
