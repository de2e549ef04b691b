# SPDX-License-Identifier: Apache-2.0
"""``background.half``: the first half of the room's training, and views of the room as it is then, for a network that
runs in an image of its own to enhance (paper, appendix C)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon import code
from studiorecon.background.fitting import Training
from studiorecon.background.halves import write_looks, write_room
from studiorecon.background.preparation import Sources, prepared
from studiorecon.background.train_settings import Settings
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.progress import progress, say
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint


def run(
    settings: Settings,
    model: Path,
    plates: list[Path],
    depth: list[Path],
    shell: Path,
    path: Path,
    views: list[Path],
    supports: list[Path],
    threads: int,
    half: Written,
    marks: Written,
    looks: Written,
    looks_path: Written,
    working: Place,
    device: str = "cpu",
    exposure: list[Path] | None = None,
    gloss: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
    videos: list[Path] | None = None,
    masks: list[Path] | None = None,
) -> None:
    """Write the room half-way (``half``, ``marks``) and a film of it (``looks``, ``looks_path``); inputs as in
    ``background.train``, which goes on from here."""
    device = resolve(device)
    cameras = read_model(model.parent)
    sources = Sources(model, plates, depth, shell, path, views, supports, exposure or [], videos or [], masks or [])
    rng = np.random.default_rng(settings.seed)
    given = prepared(settings, sources, cameras, gloss is None or len(gloss) > 0, rng)
    training = Training(given.settings, cameras, rng, threads, device, working, lpips)
    if not training.split:
        raise UserError(
            f"background.refinement.views is {settings.refinement.views} of {settings.training.iterations} iterations: "
            "nothing is looked at half-way; ask for views and two iterations at least"
        )
    mark = fingerprint(given.settings, sources.files(), code.digest("background.half"), threads, device)
    checkpoint = Checkpoint(working / "half.checkpoint.npz", mark, settings.training.checkpoint_every_s)
    room, provenance = training.first_half(given, checkpoint)
    drawing = training.drawing()
    around = training.looks(path)
    pictures = [np.clip(drawing.forward(room, camera).rgb, 0, 1) for camera in progress(around, "views of the room")]
    write_room(half, marks, room, provenance)
    write_looks(looks, looks_path, around, pictures)
    say(f"{room.count} Gaussians half-way, looked at from {len(around)} places")
    checkpoint.remove()
