# SPDX-License-Identifier: Apache-2.0
"""What a picture of a film costs beside what the rasteriser alone needs for it.

Three made scenes: a room of 27,600 Gaussians with two people of 10,000 each, whose looks drift by a network asked at
512 control points; the same under fifteen lamps, so that both people shade the floor; and a hall's worth of Gaussians,
179,200, under these lamps at 640×360. A film circles them in slow motion: three pictures a frame. A
picture is everything: people posed, the room shaded, rasterised with truth map and depth, turned to bytes and written
as three lossless videos. The rasteriser alone draws the same Gaussians from the same cameras, colours only. Both take
turns, film by film, and the least of all rounds counts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.avatar.binding import surface_weights
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.model import BodyModel
from studiorecon.footage.streams import writing
from studiorecon.footage.video import write_lossless
from studiorecon.render.canvas import Canvas
from studiorecon.render.composite import Composite
from studiorecon.render.room_light import Lamps, Light
from studiorecon.render.shading import shading
from studiorecon.render.shot import picture
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.path import PathStep
from studiorecon.splatting.cpu.blocks import block
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.scene import avatar, ring, room

FRAMES, GAUSSIANS, POINTS = 30, 10_000, 512
BAR = 3.0


def person(body: BodyModel, rng: np.random.Generator, name: str, place_m: tuple[float, float]) -> Avatar:
    """Somebody who moves all limbs, with Gaussians all over the body and a network that changes them over time."""
    plain, rest = avatar(body, rng, name, FRAMES), body.rest_vertices(np.zeros(10))
    means = (rest[rng.integers(0, len(rest), GAUSSIANS)] + rng.normal(0, 0.004, (GAUSSIANS, 3))).astype(np.float32)
    bones, weights = surface_weights(means, rest, body.weights)
    sway = np.sin(np.linspace(0, 6, FRAMES))[:, None] * rng.normal(0, 0.2, 69)
    gaussians = Gaussians(
        means,
        rng.normal(size=(GAUSSIANS, 4)),
        np.full((GAUSSIANS, 3), np.log(0.01)),
        np.full(GAUSSIANS, 3.0),
        np.concatenate([rng.normal(0, 0.3, (GAUSSIANS, 1, 3)), rng.normal(0, 0.02, (GAUSSIANS, 3, 3))], axis=1),
    )
    network = TemporalNetwork.start(
        means.min(axis=0), means.max(axis=0), FRAMES, rng, control=ControlPoints.on(means, POINTS)
    )
    return replace(
        plain,
        gaussians=gaussians,
        bones=bones,
        weights=weights,
        provenance=np.zeros(GAUSSIANS, np.uint8),
        poses=np.concatenate([plain.poses[:, :3], plain.poses[:, 3:] + sway], axis=1),
        trans=plain.trans + np.array([*place_m, 0.0]),
        valid=np.ones(FRAMES, bool),
        network=network,
    )


def scene(body: BodyModel, step_m: float, shaded: bool) -> Composite:
    """The made room, tiled ``step_m`` apart, and two people; ``shaded`` by fifteen lamps of the ceiling."""
    rng = np.random.default_rng(0)
    plain = room(rng, step_m)
    static = replace(plain, sh=np.concatenate([plain.sh, rng.normal(0, 0.02, (plain.count, 3, 3))], axis=1))
    people = [person(body, rng, "p0", (-0.5, -0.4)), person(body, rng, "p1", (0.6, 0.7))]
    classes = np.where(static.means_m[:, 2] == 0, 1, 0).astype(np.uint8)
    if not shaded:
        return Composite(static, classes, people)
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-2.4, 2.4, 5), np.linspace(-2, 2, 3)))
    lamps = Lamps(np.stack([x, y, 0 * x + 2.8], axis=1), np.tile([0, 0, -1.0], (15, 1)), np.full(15, 0.42))
    usual = np.maximum(lamps.falloff(np.zeros((1, 3)))[0], 1e-3)
    light = Light(True, "", lamps, np.full(15, 0.06), usual, 0.0, 0.0, 0.1, 0.0)
    return Composite(static, classes, people, shading(light, static, people, people))


def clocked(work: Callable[[], object]) -> np.ndarray:
    """(2,) wall and processor seconds that ``work`` took."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return np.array([time.perf_counter() - wall, time.process_time() - processor])


def costs(made: Composite, wh: tuple[int, int], pictures: int, rounds: int) -> dict[str, dict[str, float]]:
    """Milliseconds a picture of the rasteriser alone and of the film, and their ratio, in wall and processor time."""
    cameras = ring(list(np.linspace(0, 360, pictures, endpoint=False)), "c", wh=wh)
    steps = [PathStep(camera, frame, "00") for camera, frame in zip(cameras, np.arange(pictures) / 3 % (FRAMES - 1))]
    canvas, alone = Canvas(made, 0.2), Rasteriser(near_m=0.2)
    blocked = block(concatenate([made.background, *(one.posed(0.0) for one in made.people)]))

    def colours() -> None:
        with alone.own_threads():
            for step in steps:
                alone.draw(blocked, step.camera, (0, 0, 0))

    def film(folder: Path) -> None:
        writers = [partial(write_lossless, folder / f"{k}.mkv", fps=30.0) for k in range(3)]
        with writing([lambda frames, w=w: w(frames=frames) for w in writers]) as put:
            for step in steps:
                put(*picture(canvas, step, (0.0, 0.0, 0.0)))

    with tempfile.TemporaryDirectory() as folder:
        both = [(clocked(colours), clocked(lambda: film(Path(folder)))) for _ in range(rounds + 1)]
    drawn, filmed = zip(*both)
    # The first round compiles.
    alone_ms, film_ms = (1e3 * np.min(spent[1:], axis=0) / pictures for spent in (drawn, filmed))
    return {
        kind: {"rasteriser_ms": alone_ms[k], "picture_ms": film_ms[k], "ratio": film_ms[k] / alone_ms[k]}
        for k, kind in enumerate(("wall", "processor"))
    }


def measured(root: Path, pictures: int = 24, rounds: int = 3) -> dict[str, dict[str, dict[str, float]]]:
    """Costs of every scene; printed as they are found."""
    body = BodyModel.load(root / "resources/body.npz")
    scenes = {
        "room, 480x272": ((480, 272), 0.06, False),
        "room with shadows, 480x272": ((480, 272), 0.06, True),
        "hall with shadows, 640x360": ((640, 360), 0.0235, True),
    }
    found = {}
    for name, (wh, step_m, shaded) in scenes.items():
        made = scene(body, step_m, shaded)
        found[name] = costs(made, wh, pictures, rounds)
        told = "; ".join(
            f"{kind} {c['picture_ms']:.1f} ms a picture, rasteriser alone {c['rasteriser_ms']:.1f} ms: {c['ratio']:.2f}"
            for kind, c in found[name].items()
        )
        print(f"{name}, {made.background.count} Gaussians and two people: {told} times (bar {BAR})", flush=True)
    return found
