# SPDX-License-Identifier: Apache-2.0
"""``background.half``: the first half of the room's training, and renders of the half-trained room.

A network that runs in a container image of its own enhances the renders (paper, appendix C).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon import code
from studiorecon.background.fitting import Training
from studiorecon.background.half_trained_files import write_renders, write_room
from studiorecon.background.preparation import Sources, prepare_training
from studiorecon.background.train_settings import Settings
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.progress import progress, say
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint


def run(
    settings: Settings,
    sources: Sources,
    threads: int,
    half: Written,
    provenance: Written,
    renders: Written,
    renders_path: Written,
    working: Place,
    device: str = "cpu",
    specularity: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
) -> None:
    """Write the half-trained room (``half``, ``provenance``) and a film of it; inputs as in ``background.train``."""
    device = resolve(device)
    cameras = read_model(sources.model.parent)
    rng = np.random.default_rng(settings.seed)
    given = prepare_training(settings, sources, cameras, specularity is None or len(specularity) > 0, rng)
    training = Training(given.settings, cameras, rng, threads, device, working, lpips)
    if not training.split:
        raise UserError(
            f"background.refinement.views is {settings.refinement.views} of {settings.training.iterations} "
            "iterations: it needs at least one view and two iterations"
        )
    mark = fingerprint(given.settings, sources.files(), code.digest("background.half"), threads, device)
    checkpoint = Checkpoint(working / "half.checkpoint.npz", mark, settings.training.checkpoint_every_s)
    room, marks = training.first_half(given, checkpoint)
    drawing = training.build_rasteriser()
    around = training.refinement_views(sources.path)
    pictures = [np.clip(drawing.forward(room, camera).rgb, 0, 1) for camera in progress(around, "views of the room")]
    write_room(half, provenance, room, marks)
    write_renders(renders, renders_path, around, pictures)
    say(f"{room.count} Gaussians after half the training, rendered from {len(around)} places")
    checkpoint.remove()
