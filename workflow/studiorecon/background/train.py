# SPDX-License-Identifier: Apache-2.0
"""Trains static Gaussians of the room on clean plates and synthesized views.

Writes ``background/scene.ply`` and ``background/provenance.npz`` (``provenance``: per Gaussian, in PLY order, measured
/ inferred / invented as in ``scene/provenance.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from studiorecon import code
from studiorecon.background.fitting import Training
from studiorecon.background.half_trained_files import read_half
from studiorecon.background.preparation import Photo, Sources, prepare_training
from studiorecon.background.train_settings import Settings
from studiorecon.camera_files.colmap import read_model
from studiorecon.images.metrics import psnr
from studiorecon.progress import say
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.scene.provenance import write_provenance
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint


def run(
    settings: Settings,
    sources: Sources,
    threads: int,
    background: Written,
    provenance: Written,
    working: Place,
    device: str = "cpu",
    specularity: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
    half: list[Path] | None = None,
) -> None:
    """Train the background and write it with its provenance; plates are divided by their gains, if any.

    With ``photos`` "first_frames" the first pictures of the videos are used, without the people in the masks. Without a
    file in ``specularity`` colours do not change with the view; None: no decision was made. ``half``: the half-trained
    room, its provenance, and enhanced views of it with their path, where ``refinement`` is on. ``working`` is a folder
    of its own: preview pictures, and the checkpoint of a killed run; ``lpips`` holds the weights of the perceptual
    term.
    """
    device = resolve(device)
    cameras = read_model(sources.model.parent)
    rng = np.random.default_rng(settings.seed)
    given = prepare_training(settings, sources, cameras, specularity is None or len(specularity) > 0, rng)
    training = Training(given.settings, cameras, rng, threads, device, working, lpips)
    mark = fingerprint(
        given.settings, [*sources.files(), *(half or [])], code.digest("background.train"), threads, device
    )
    checkpoint = Checkpoint(working / "checkpoint.npz", mark, settings.training.checkpoint_every_s)
    start, marks, synthesized, begun = given.start, given.marks, given.synthesized, 0
    if half:
        start, marks, looks = read_half(half, settings.refinement.weight)
        synthesized, begun = synthesized + looks, training.split
    trained = training.fit(start, given.real, synthesized, checkpoint, (begun, settings.training.iterations))
    marks = marks[trained.source]
    scores = _plate_scores(trained.gaussians, given.photos, training)
    say(
        f"{trained.gaussians.count} Gaussians after training; plates at {np.mean(scores):.2f} "
        f"dB on average, {min(scores):.2f} at worst"
    )
    write_ply(background, trained.gaussians)
    write_provenance(provenance, marks)
    checkpoint.remove()


def _plate_scores(gaussians: Gaussians, photos: Sequence[Photo], training: Training) -> list[float]:
    """PSNR of every plate on its measured pixels, dB."""
    drawing = training.build_rasteriser()
    return [psnr(drawing.forward(gaussians, p.camera).rgb, p.rgb, p.known) or 0.0 for p in photos]
