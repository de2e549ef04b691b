# SPDX-License-Identifier: Apache-2.0
"""``background.refined``: views of the half-trained room, repaired by a network that is shown the nearest photo (paper,
appendix C)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studiorecon.background.targets import angle_between_axes
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames, to_bytes, to_float, write_lossless
from studiorecon.models.loading import load
from studiorecon.models.protocols import Moment
from studiorecon.progress import progress, say
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import one_each
from studiorecon.scene.path import read_path
from studiorecon.signature import Place, Written

_SEED = 0


def run(
    enhancer: str,
    looks: Path,
    looks_path: Path,
    model: Path,
    plates: list[Path],
    exposure: list[Path],
    weights: Place,
    device: str,
    refined: Written,
) -> None:
    """Write the film ``looks``, whose cameras are those of ``looks_path``, as the network ``enhancer`` repairs it;
    ``plates`` are the rooms without people of ``model``'s cameras, divided by the gains that ``exposure`` names."""
    steps, fps = read_path(looks_path)
    cameras = read_model(model.parent)
    one_each(cameras, plates=plates)
    factors = read_factors(exposure)
    photos = [to_bytes(factors.even(c.name, read_plate(plate)[0])) for c, plate in zip(cameras, plates)]
    network = load("picture enhancer", enhancer, weights, device, seed=_SEED)

    def repaired() -> Iterator[np.ndarray]:
        pictures = progress(read_frames(looks, 0, len(steps)), "views of the room", total=len(steps))
        for step, picture in zip(steps, pictures):
            nearest = int(np.argmin([angle_between_axes(step.camera, camera) for camera in cameras]))
            nothing = np.zeros(step.camera.hw, np.float32)
            moment = Moment(step.camera, 0.0, nothing, nothing)
            yield to_bytes(network.enhance(to_float(picture), photos[nearest], moment))

    write_lossless(refined, repaired(), fps)
    say(f"{len(steps)} views of the room as {enhancer} repairs them")
