# SPDX-License-Identifier: Apache-2.0
"""A small scene of known Gaussians with a ring of cameras, written as the files that render, enhance, report and
deliver read."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from studiorecon.body.avatar.avatar_files import Avatar, write_avatar
from studiorecon.body.model import BodyModel
from studiorecon.camera_files.colmap import write_model
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import read_stack, to_bytes, write_lossless
from studiorecon.render.shots import look_at_pose
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians, concatenate, sh_from_rgb
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser

WH = (128, 80)
FRAMES = 6
FPS = 15.0
ROOM_M = 3.0


def ring(angles_deg: list[float], prefix: str, radius_m: float = 2.4, wh: tuple[int, int] = WH) -> list[Camera]:
    """Cameras on a circle at 1.6 m, looking at (0, 0, 1)."""
    cameras = []
    for index, angle in enumerate(np.radians(angles_deg)):
        eye = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), 1.6])
        intrinsics = np.array([[0.7 * wh[0], 0, wh[0] / 2], [0, 0.7 * wh[0], wh[1] / 2], [0, 0, 1.0]])
        cameras.append(Camera(f"{prefix}{index}", wh, intrinsics, look_at_pose(eye, np.array([0, 0, 1.0]))))
    return cameras


def room(rng: np.random.Generator, step_m: float = 0.09) -> Gaussians:
    """Floor and four walls of a 6 × 6 × 2.6 m room, tiled with flat opaque Gaussians of a smooth random pattern."""
    across = np.arange(-ROOM_M, ROOM_M, step_m) + step_m / 2
    up = np.arange(0, 2.6, step_m) + step_m / 2
    parts = []
    for axis, place, second in ((2, 0.0, across), (0, -ROOM_M, up), (0, ROOM_M, up), (1, -ROOM_M, up), (1, ROOM_M, up)):
        u, v = (grid.ravel() for grid in np.meshgrid(across, second))
        points = np.insert(np.stack([u, v], axis=1), axis, place, axis=1)
        waves = rng.uniform(2, 7, (3, 2)), rng.uniform(0, 6, 3)
        rgb = 0.5 + 0.35 * np.sin(np.stack([u, v], axis=1) @ waves[0].T + waves[1])
        scales = np.full((len(points), 3), np.log(0.55 * step_m))
        scales[:, axis] = np.log(0.004)
        quaternions = np.tile([1.0, 0, 0, 0], (len(points), 1))
        parts.append(Gaussians(points, quaternions, scales, np.full(len(points), 5.0), sh_from_rgb(rgb)[:, None]))
    return concatenate(parts)


def avatar(body: BodyModel, rng: np.random.Generator, person: str, frames: int = FRAMES) -> Avatar:
    """A coarse walking person: Gaussians on every 12th vertex of the bundled body, skinned to their strongest joint."""
    index = np.arange(0, len(body.weights), 12)
    rest = body.rest_vertices(np.zeros(10))[index]
    poses = np.zeros((frames, 72))
    poses[:, 0] = np.pi / 2
    poses[:, 16 * 3 + 2], poses[:, 17 * 3 + 2] = -1.2, 1.2
    trans = np.stack([np.linspace(-0.4, 0.4, frames), np.zeros(frames), np.full(frames, 0.95)], axis=1)
    shirt = rng.uniform(0.1, 0.9, 3)
    rgb = np.clip(shirt + 0.1 * rng.normal(size=(len(index), 3)), 0, 1)
    gaussians = Gaussians(
        rest,
        np.tile([1.0, 0, 0, 0], (len(index), 1)),
        np.full((len(index), 3), np.log(0.02)),
        np.full(len(index), 4.0),
        sh_from_rgb(rgb)[:, None],
    )
    bones = body.weights[index].argmax(axis=1).astype(np.uint8)[:, None]
    valid = np.ones(frames, bool)
    valid[-1] = False
    return Avatar(
        person,
        body,
        gaussians,
        bones,
        np.ones((len(index), 1), np.float32),
        np.zeros(len(index), np.uint8),
        poses,
        trans,
        np.zeros(10),
        valid,
        FPS,
        True,
    )


def write_scene(
    folder: Path, root: Path, people: int = 1, seed: int = 0, filmed: bool = True
) -> dict[str, list[Camera]]:
    """Write cameras, manifest, background, people and, if ``filmed``, footage (renders of the scene itself) below
    ``folder``."""
    rng = np.random.default_rng(seed)
    training, held_out = ring([0, 90, 180, 270], "cam"), ring([45, 135], "view")
    write_model(folder / "cameras", training)
    write_model(folder / "cameras/heldout", held_out)
    footage = tuple(
        Footage(
            c.name,
            c.name.startswith("view"),
            WH,
            c.intrinsics.tolist(),
            FPS,
            FRAMES,
            0,
            f"videos/{c.name}.mp4",
            "",
            WH,
            0,
            0.0,
            [],
        )
        for c in [*training, *held_out]
    )
    write_manifest(folder / "capture/manifest.json", Manifest("made", FPS, FRAMES, footage))
    static = room(rng)
    write_ply(folder / "background/scene.ply", static)
    # One wall is invented, the floor inferred, the rest measured.
    classes = np.where(static.means_m[:, 0] == ROOM_M, 2, np.where(static.means_m[:, 2] == 0, 1, 0)).astype(np.uint8)
    write_npz(folder / "background/provenance.npz", {"provenance": classes})
    persons = []
    if people:
        body = BodyModel.load(root / "resources/body.npz")
        persons = [avatar(body, rng, f"p{i}") for i in range(people)]
        for one in persons:
            write_avatar(folder / f"humans/{one.person}.ply", folder / f"humans/{one.person}.npz", one)
    rasteriser = Rasteriser(near_m=0.2)
    for camera in [*training, *held_out] if filmed else []:
        with parallel_writers(
            [lambda frames, c=camera: write_lossless(folder / f"capture/{c.name}.mkv", frames, FPS)]
        ) as put:
            for frame in range(FRAMES):
                put(to_bytes(rasteriser.forward(concatenate([static, *(p.posed(frame) for p in persons)]), camera).rgb))
    return {"training": training, "held_out": held_out}


def render_options(folder: Path, shot: str, people: int = 1) -> dict:
    """The options of ``render.shot`` for a scene written by ``write_scene``."""
    return {
        "shot": shot,
        "model": folder / "cameras/images.txt",
        "heldout_model": folder / "cameras/heldout/images.txt",
        "manifest": folder / "capture/manifest.json",
        "background": folder / "background/scene.ply",
        "provenance": folder / "background/provenance.npz",
        "gaussians": [folder / f"humans/p{i}.ply" for i in range(people)],
        "avatars": [folder / f"humans/p{i}.npz" for i in range(people)],
        "body": Path(__file__).resolve().parents[2] / "resources/body.npz",
        "video": folder / f"render/{shot}.mkv",
        "truth": folder / f"render/{shot}.truth.mkv",
        "depth": folder / f"render/{shot}.depth.mkv",
        "path": folder / f"render/{shot}.json",
        "ledger": folder / f"render/{shot}.tsv",
    }


def enhance_options(folder: Path, shot: str, cameras: list[Camera]) -> dict:
    """The options of ``enhance.shot`` for the same scene."""
    return {
        "shot": shot,
        "render": folder / f"render/{shot}.mkv",
        "render_path": folder / f"render/{shot}.json",
        "render_depth": folder / f"render/{shot}.depth.mkv",
        "train": [folder / f"render/train.{kind}" for kind in ("mkv", "json", "depth.mkv")],
        "model": folder / "cameras/images.txt",
        "manifest": folder / "capture/manifest.json",
        "videos": [folder / f"capture/{c.name}.mkv" for c in cameras],
        "video": folder / f"enhance/{shot}.mkv",
        "film": folder / f"enhance/{shot}.mp4",
        "decisions": folder / f"enhance/{shot}.decisions.json",
    }


# Exposures of four cameras, red, green and blue: ±12 % and less.
GAINS = np.array([[[1.12, 1.05, 1.1]], [[0.88, 0.92, 0.9]], [[1.1, 1.12, 1.05]], [[0.9, 0.88, 0.95]]])


def refilmed(videos: Sequence[Path], folder: Path, factors: Sequence[np.ndarray]) -> list[Path]:
    """Copies of films in ``folder``, every frame times its factor (1 or frames, 3)."""
    folder.mkdir(exist_ok=True)
    copies = [folder / path.name for path in videos]
    for path, copy, own in zip(videos, copies, factors, strict=True):
        frames = read_stack(path) * np.asarray(own)[:, None, None, :]
        write_lossless(copy, list(np.clip(np.rint(frames), 0, 255).astype(np.uint8)), 30.0)
    return copies


def replace_gaussians(ply: Path, npz: Path, gaussians: Gaussians) -> None:
    """Writes other Gaussians of a person, and into the file beside them that the two belong together."""
    write_ply(ply, gaussians)
    with np.load(npz) as data:
        arrays = dict(data)
    write_npz(npz, arrays | {"gaussians_sha256": hashlib.sha256(ply.read_bytes()).hexdigest()})
