# SPDX-License-Identifier: Apache-2.0
"""``background.refined``: views of the half-trained room, repaired by the recursive module around a network.

The network is shown the nearest photo (paper, section Iterative Refinement and appendix C).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from studiorecon.background.targets import angle_between_axes
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.settings import load as load_settings
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames, to_bytes, write_lossless
from studiorecon.models.loading import load
from studiorecon.progress import progress, say
from studiorecon.recursive.flows import load_flow
from studiorecon.recursive.injection import Injection
from studiorecon.recursive.sequence import adapt_injection, enhance_sequence
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.path import PathStep, read_path
from studiorecon.signature import Place, Written


def run(
    enhancer: str,
    injection: str,
    flow: str,
    renders: Path,
    renders_path: Path,
    model: Path,
    plates: list[Path],
    gains: list[Path],
    weights: Place,
    device: str,
    refined: Written,
) -> None:
    """Write the film ``renders``, repaired by the network ``enhancer``; ``renders_path`` holds its cameras.

    ``plates`` are the rooms without people of ``model``'s cameras, divided by their ``gains``. ``injection`` are the
    settings of ``enhance.injection`` as JSON, by which views enter later ones along ``flow``.
    """
    steps, fps = read_path(renders_path)
    cameras = read_model(model.parent)
    require_one_each(cameras, plates=plates)
    factors = read_factors(gains)
    photos = [to_bytes(factors.normalise(c.name, read_plate(plate, c.wh)[0])) for c, plate in zip(cameras, plates)]
    network = load("picture enhancer", enhancer, weights, device, seed=0)

    def reference(step: PathStep) -> np.ndarray:
        return photos[int(np.argmin([angle_between_axes(step.camera, camera) for camera in cameras]))]

    # Zeros: only enhancers that carry photos over use depth.
    depths_mm = (np.zeros(step.camera.hw, np.uint16) for step in steps)
    how = load_settings(Injection, json.loads(injection), "enhance.injection")
    search = load_flow(flow, "medium", weights, device)
    pictures = progress(read_frames(renders, 0, len(steps)), "views of the room", total=len(steps))
    repaired = enhance_sequence(steps, pictures, depths_mm, reference, network, adapt_injection(how, steps), search)
    write_lossless(refined, repaired, fps)
    say(f"{len(steps)} views of the room, repaired by {enhancer} one after the other")
