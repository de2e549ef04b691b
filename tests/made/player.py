# SPDX-License-Identifier: Apache-2.0
"""A small scene that has everything a player must draw, and its page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.avatar.weight_grid import strongest_weights
from studiorecon.body.model import BodyModel
from studiorecon.deliver.finished import FinishedScene
from studiorecon.deliver.packing import Bytes
from studiorecon.deliver.player import QUALITY, add_footage, build_page, render_poster
from studiorecon.deliver.player_data import Shade, describe_scene
from studiorecon.geometry import rotations
from studiorecon.images.encoded import jpeg
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest
from studiorecon.scene.factors import NONE, Factors
from studiorecon.scene.files import write_text
from studiorecon.scene.gaussians import Gaussians, concatenate, sh_from_rgb
from studiorecon.scene.path import PathStep
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rigid_object import MEASURED_TURNS, RigidObject

from tests.made.scene import FPS, ring, room

ROOT = Path(__file__).resolve().parents[2]
PARTS = sorted((ROOT / "resources/player").iterdir())
WH = (160, 100)


def acrobat(body: BodyModel, seed: int, frames: int, at_m: tuple[float, float], changing: bool = False) -> Avatar:
    """Somebody made of needles on the body's surface, carried by four bones each, who bends and twists every joint
    (one wrist by nearly half a turn), far from the origin; ``changing``: whose colours change over time."""
    rng = np.random.default_rng(seed)
    index = np.arange(0, len(body.weights), 10)
    means = body.rest_vertices(np.zeros(10))[index].astype(np.float32)
    count = len(index)
    scales = np.log(rng.uniform(0.004, 0.03, (count, 3)))
    sh = np.zeros((count, 9, 3))
    sh[:, 0] = sh_from_rgb(np.clip(rng.uniform(0.1, 0.9, 3) + 0.15 * rng.normal(size=(count, 3)), 0, 1))
    sh[:, 1:] = 0.12 * rng.normal(size=(count, 8, 3))
    gaussians = Gaussians(means, rng.normal(size=(count, 4)), scales, rng.uniform(0, 5, count), sh)
    bones, weights = strongest_weights(body.weights[index], 4)
    poses = np.cumsum(rng.normal(0, 0.25, (frames, 72)), axis=0)
    poses[:, :3] = [np.pi / 2, 0, 0]
    poses[:, 18 * 3 : 18 * 3 + 3] = [0, 2.2, 0]
    poses[:, 20 * 3] = 3.0
    trans = np.stack(
        [at_m[0] + np.linspace(-0.2, 0.2, frames), np.full(frames, at_m[1]), np.full(frames, 0.95)], axis=1
    )
    provenance = (rng.uniform(size=count) < 0.2).astype(np.uint8)
    valid = np.ones(frames, bool)
    valid[-1] = False
    network = None
    if changing:
        seen = means[provenance == 0]
        control = ControlPoints.on(seen, 60)
        low, high = seen.min(axis=0), seen.max(axis=0)
        network = TemporalNetwork.start(low, high, frames, rng, 32, 6, control)
        last, _ = network.matrices()[-1]
        last[...] = 0.1 * rng.normal(size=last.shape)
    return Avatar(
        f"p{seed}", body, gaussians, bones, weights, provenance, poses, trans, np.zeros(10), valid, FPS, True, network
    )


def tumbling(frames: int) -> RigidObject:
    """A coloured box of needles that turns as it goes, and whose place nobody knows in its first two frames."""
    rng = np.random.default_rng(8)
    means = rng.uniform(-0.15, 0.15, (200, 3)) * [1.5, 1, 0.6]
    scales = np.log(rng.uniform(0.01, 0.03, (200, 3)))
    own = Gaussians(
        means, rng.normal(size=(200, 4)), scales, np.full(200, 3.0), sh_from_rgb(rng.uniform(0, 1, (200, 3)))[:, None]
    )
    centres = np.stack([np.linspace(-0.8, 0.8, frames), np.full(frames, 0.7), np.full(frames, 0.8)], axis=1)
    present = np.arange(frames) >= min(2, frames - 1)
    centres[~present] = np.nan
    turns = rotations.exp(np.linspace(0, 2.5, frames)[:, None] * [0.3, 0.5, 0.9])
    marks = np.zeros(200, np.uint8)
    return RigidObject("o0", own, marks, centres, present, present, 0.2, turns, MEASURED_TURNS)


def scene_of(people: int, frames: int, things: bool = True, step_m: float = 0.2, degree: int = 3) -> FinishedScene:
    """A room whose colours depend on the view, people who move, and a tumbling thing."""
    rng = np.random.default_rng(5)
    own = room(rng, step_m).with_sh_degree(degree)
    own.sh[:, 1:] = 0.06 * rng.normal(size=own.sh[:, 1:].shape)
    provenance = np.where(own.means_m[:, 0] > 2.99, 2, np.where(own.means_m[:, 2] == 0, 1, 0)).astype(np.uint8)
    cameras = ring([0, 90, 180, 270], "cam", wh=WH)
    body = BodyModel.load(ROOT / "resources/body.npz")
    places = [(1.2, -0.9), (-0.6, 0.4), (0, 0), (0.6, 1.0), (-1, -1), (1.4, 0.2), (-1.5, 0.6)]
    footage = tuple(
        Footage(c.name, False, WH, c.intrinsics.tolist(), FPS, frames, 0, "a.mp4", "", WH, 0, 0.0, []) for c in cameras
    )
    steps = [PathStep(camera, k % frames, "00") for k, camera in enumerate(ring([20, 50, 80], "film", wh=WH))]
    return FinishedScene(
        "made",
        Manifest("made", FPS, frames, footage),
        cameras,
        own,
        provenance,
        [acrobat(body, k, frames, places[k], changing=k == 0) for k in range(people)],
        [tumbling(frames)] if things else [],
        {"orbit": steps},
    )


def shade_for(scene: FinishedScene) -> Shade:
    """A shadow that wanders over the floor."""
    at = np.flatnonzero(scene.provenance == 1)
    times = np.arange(scene.capture.frames)
    x = scene.room.means_m[at, 0]
    return Shade(at, times, 1 - 0.6 * np.exp(-((x[None] - np.linspace(-1, 1, len(times))[:, None]) ** 2)))


def write_page(
    path: Path, scene: FinishedScene, exposure: Factors = NONE, shade: Shade | None = None, videos: Sequence[Path] = ()
) -> Path:
    """The scene's player as a file; ``videos``: what its cameras filmed."""
    held = Bytes()
    reported, sentences = describe_scene(scene, held, exposure, shade)
    sentences += add_footage(held, reported["cameras"], videos, scene.capture.frames, scene.capture.fps)
    poster = jpeg(render_poster(scene), QUALITY)
    write_text(path, build_page(scene.name, reported | {"notes": sentences}, held, poster, PARTS))
    return path


def drawn(scene: FinishedScene, camera: Camera, frame: float, shade: Shade | None = None) -> np.ndarray:
    """(H, W, 3) float32 the same picture by the project's own rasteriser."""
    static = scene.room
    if shade is not None:
        low = min(int(frame), len(shade.times) - 2)
        left = shade.factors[low] + (frame - low) * (shade.factors[low + 1] - shade.factors[low])
        sh = static.sh.copy()
        sh[shade.at] *= left[:, None, None]
        sh[shade.at, 0] += (left[:, None] - 1) * 0.5 / 0.28209479177387814
        static = replace(static, sh=sh)
    people, things = ([one.posed(frame) for one in several] for several in (scene.people, scene.things))
    return Rasteriser(near_m=0.2).forward(concatenate([static, *people, *things]), camera).rgb
