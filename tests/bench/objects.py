# SPDX-License-Identifier: Apache-2.0
"""``python -m tests.bench.objects [CASE ...]``: things followed, made and seen from cameras that were not used.

In ``CASES`` it is the synthetic studio's ball. The same play is filmed with and without the ball. The step
``objects.find`` is given the true cameras, plates and bodies. Scored are the ball's middle and radius, and the PSNR
in the ball's true pixels of held-out cameras: of the film without a ball, and of the same film with the ball that was
made laid over it. In ``TURNING`` things tumble before smooth walls in four views of 240 × 136. Scored are how far their
turns and their long axes are off, and the PSNR in the thing's pixels at a fifth camera with the turns that were found,
without, and without the thing. Writes ``tests/bench/results/objects.json``; a case that was not asked for stays.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.footage.video import read_frames, to_bytes
from studiorecon.objects.find import Settings, moments_of, objects_in, open_view, rested
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_json
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rigid_object import RigidObject
from studiorecon.studio import capture
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import read_description

from tests.defaults import loaded
from tests.made.objects import Ball, bouncing, drawn
from tests.made.objects_rotation import Board, found, seen_db, shown, tumbling, turn_errors_deg

ROOT = Path(__file__).resolve().parents[2]
RESULT = Path(__file__).resolve().parent / "results" / "objects.json"
TAKE: dict[str, Any] = {
    "seed": 5,
    "frames": 24,
    "fps": 15.0,
    "size": [320, 180],
    "people": 2,
    "plates": True,
    "cameras": {"training": 4, "held_out": 2},
}
HARD: dict[str, Any] = {"effects": {"moving_shadows": True, "contact_shading": 0.5}, "faults": {"noise_levels": 3.0}}
# Name → what is different in the take, and how many training cameras the step is given.
CASES: dict[str, tuple[dict[str, Any], int]] = {
    "four cameras": ({}, 4),
    "three cameras": ({}, 3),
    "moving shadows, noise of 3 levels": (HARD, 4),
}
# Half the sides of a box of two colours that tumbles, metres; None is a ball that bounces and does not turn.
TURNING: dict[str, tuple[float, float, float] | None] = {
    "board, 48 × 18 × 9 cm": (0.24, 0.09, 0.045),
    "stick, 70 × 8 × 8 cm": (0.35, 0.04, 0.04),
    "box, 30 × 24 × 18 cm": (0.15, 0.12, 0.09),
    "ball, 24 cm": None,
}
# A pixel at a time says little where only its edge shows the ball.
_LEAST_PX = 20


def make(folder: Path, ball: bool, changed: dict[str, Any]) -> None:
    """A take in ``folder/dataset``, its truth in ``folder/truth``."""
    described = TAKE | changed | {"effects": changed.get("effects", {}) | {"ball": ball}}
    folder.mkdir(parents=True)
    (folder / "take.yaml").write_text(yaml.safe_dump(described))
    capture.run(folder / "take.yaml", folder / "dataset", folder / "truth", None, 1)


def true_middles(folder: Path) -> tuple[np.ndarray, float]:
    """(T, 3) middle of the ball, and its radius."""
    described = read_description(folder / "take.yaml")
    troupe = Actors(described, BodyModel.load(ROOT / "resources/body.npz"), np.arange(described.frames) / described.fps)
    balls = [next(s for s in troupe.at(t)[0] if s.name == "ball") for t in range(described.frames)]
    middles = np.array([ball.world_from_solid[:3, 3] for ball in balls])
    return middles, float(np.linalg.norm(balls[0].vertices_m - middles[0], axis=1).max())


def found_in(folder: Path, cameras: int) -> list[RigidObject]:
    """What the step finds with the first so many training cameras."""
    settings = loaded(Settings)
    known = {c["name"]: Camera.from_json(c) for c in json.loads((folder / "truth/cameras.json").read_text())}
    names = [name for name in known if name.startswith("cam")][:cameras]
    data = folder / "dataset"
    views = [open_view(known[n], data / f"videos/{n}.mp4", data / f"plates/{n}.png", settings.pixels) for n in names]
    people = [read_person(path) for path in sorted((folder / "truth/bodies").glob("p*.npz"))]
    frames = TAKE["frames"]
    about = (people, BodyModel.load(ROOT / "resources/body.npz"), frames, settings.loose.margin_m)
    views = rested(views, moments_of(views, *about, step=2), settings.loose)
    return objects_in(moments_of(views, *about), views, frames, TAKE["fps"], settings, 1)


def seen(folder: Path, without: Path, things: Sequence[RigidObject], pictures: Path) -> dict[str, float]:
    """PSNR in the ball's true pixels of every held-out camera and frame that shows it, dB over all these pixels."""
    rasteriser, squares, count, frames_seen = Rasteriser(near_m=0.05, threads=1), np.zeros(2), 0, 0
    for entry in json.loads((folder / "truth/cameras.json").read_text()):
        camera = Camera.from_json(entry)
        if not camera.name.startswith("view"):
            continue
        films = (f / f"truth/frames/{camera.name}.mkv" for f in (folder, without))
        masks = read_frames(folder / f"truth/masks/{camera.name}.mkv")
        for t, (truth, empty, mask) in enumerate(zip(*map(read_frames, films), masks)):
            shown = mask == 255
            if shown.sum() < _LEAST_PX:
                continue
            base, made = empty.astype(np.float64) / 255, empty.astype(np.float64) / 255
            for thing in things:
                drawn = rasteriser.forward(thing.posed(t), camera)
                # Who stands before the ball is not drawn here: only pixels that truly show the ball are compared.
                made = drawn.rgb + (1 - drawn.alpha[..., None]) * made
            squares += [np.square(p[shown] - truth[shown] / 255).sum() for p in (base, made)]
            count += 3 * int(shown.sum())
            frames_seen += 1
            if frames_seen % 6 == 1:
                strip = np.concatenate([truth, empty, to_bytes(made.astype(np.float32))], axis=1)
                cv2.imwrite(
                    str(pictures / f"{camera.name}-{t:02d}.png"), cv2.resize(strip, None, fx=2, fy=2)[..., ::-1]
                )
    off, on = -10 * np.log10(squares / count)
    return {"without_db": float(off), "with_db": float(on), "held-out pictures": frames_seen, "pixels": count // 3}


def score(name: str, takes: Path) -> dict[str, Any]:
    """One case; takes and pictures are kept in ``takes``."""
    changed, cameras = CASES[name]
    on, off = (takes / f"{'hard' if changed else 'plain'}-{ball}" for ball in ("ball", "none"))
    for folder in (on, off):
        if not folder.is_dir():
            make(folder, folder is on, changed)
    things, none = found_in(on, cameras), found_in(off, cameras)
    middles, radius_m = true_middles(on)
    row: dict[str, Any] = {"things": len(things), "things in the film without a ball": len(none)}
    if things:
        ball = max(things, key=lambda thing: thing.valid.sum())
        error_mm = 1000 * np.linalg.norm(ball.centres_m - middles, axis=1)
        pictures = takes / name.replace(" ", "_")
        pictures.mkdir(exist_ok=True)
        row |= {
            "turns": ball.turns,
            "measured frames": int(ball.valid.sum()),
            "filled frames": int((ball.present & ~ball.valid).sum()),
            "middle_mm": float(np.median(error_mm[ball.valid])),
            "middle_worst_mm": float(error_mm[ball.valid].max()),
            "radius_mm": 1000 * ball.radius_m,
            "true radius_mm": 1000 * radius_m,
            "gaussians": ball.gaussians.count,
            **seen(on, off, things, pictures),
        }
    return rounded(row)


def turning(name: str) -> dict[str, Any]:
    """One tumbling or bouncing thing, with and without looking for its turns."""
    settings = loaded(Settings)
    never = replace(settings, turn=replace(settings.turn, gain_db=99.0))
    half_m = TURNING[name]
    board = replace(tumbling(), half_m=half_m) if half_m else None
    ball = Ball(bouncing())

    def pictured(camera: Camera, frame: int) -> np.ndarray:
        return shown(board, camera, frame) if board else drawn(camera, [ball], frame)

    made = {"with_turns_db": found(settings, pictured), "without_turns_db": found(never, pictured)}
    row: dict[str, Any] = {"things": len(made["with_turns_db"])}
    for column, things in (*made.items(), ("without_it_db", [])):
        row[column] = seen_db(things[0] if things else None, pictured)
    if things := made["with_turns_db"]:
        middles, valid = board.path_m if board else ball.path_m, things[0].valid
        error_mm = 1000 * np.linalg.norm(things[0].centres_m - middles, axis=1)[valid]
        row |= {"turns": things[0].turns, "measured frames": int(valid.sum()), "middle_mm": float(np.median(error_mm))}
        if board:
            error_deg = turn_errors_deg(things[0], board)[valid]
            row |= {"turn_deg": float(np.median(error_deg)), "turn_worst_deg": float(error_deg.max())}
            row["long_axis_deg"] = float(np.median(axis_errors_deg(things[0], board)[valid]))
    return rounded(row)


def axis_errors_deg(thing: RigidObject, board: Board) -> np.ndarray:
    """(T,) degrees between true and found directions of the longest side: a square stick looks the same after a quarter
    turn about it."""
    true = board.world_from_board[:, :, 0]
    in_object = np.einsum("txy,tx->ty", thing.world_from_object, true)[thing.valid].mean(axis=0)
    cosine = np.einsum("txy,y,tx->t", thing.world_from_object, in_object / np.linalg.norm(in_object), true)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {k: round(float(v), 2) if isinstance(v, float) else v for k, v in row.items()}


def main(wanted: Sequence[str]) -> None:
    known = json.loads(RESULT.read_text()) if RESULT.is_file() else {}
    rows = known.get("cases", {}) | known.get("turning", {})
    with tempfile.TemporaryDirectory() as folder:
        takes = Path(os.environ.get("OBJECTS_TAKES", folder))
        for name in wanted or [*CASES, *TURNING]:
            rows[name] = score(name, takes) if name in CASES else turning(name)
            print(name, rows[name], flush=True)
            parts = {
                part: {n: rows[n] for n in names if n in rows}
                for part, names in (("cases", CASES), ("turning", TURNING))
            }
            write_json(RESULT, {"date": str(date.today()), "take": TAKE, **parts})


if __name__ == "__main__":
    main(sys.argv[1:])
