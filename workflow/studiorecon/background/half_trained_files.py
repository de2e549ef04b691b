# SPDX-License-Identifier: Apache-2.0
"""Files of the half-trained room, for a network that enhances views of it between the halves of the training."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.video import read_stack, to_bytes, to_float, write_lossless
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import PathStep, read_path, write_path
from studiorecon.scene.provenance import read_provenance, write_provenance
from studiorecon.scene.step_files import require_size
from studiorecon.splatting.train.targets import Target

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# The views are single pictures; a film of them runs at this rate.
_FPS = 30.0


def write_room(half: Path, provenance: Path, room: Gaussians, marks: Integer[np.ndarray, " N"]) -> None:
    """Write the Gaussians (PLY) and the provenance, ``marks``, of each (npz)."""
    write_ply(half, room)
    write_provenance(provenance, marks)


def write_renders(
    renders: Path, renders_path: Path, cameras: list[Camera], pictures: list[Float[np.ndarray, "H W 3"]]
) -> None:
    """Write views in [0, 1] of the room from ``cameras`` as a lossless film, with its path."""
    write_lossless(renders, (to_bytes(picture) for picture in pictures), _FPS)
    write_path(renders_path, [PathStep(camera, 0, "refinement") for camera in cameras], _FPS)


def read_half(files: list[Path], weight: float) -> tuple[Gaussians, Integer[np.ndarray, " N"], list[Target]]:
    """The half-trained room, its Gaussians' provenance, and enhanced views of it as targets (paper, appendix C).

    Every pixel of the targets has ``weight``. ``files``: the room, its provenance, the path and the film of the views.
    Raises UserError for files that do not belong together.
    """
    room_file, marks_file, path_file, film = files
    room = read_ply(room_file)
    provenance = read_provenance(marks_file, room.count)
    steps, _ = read_path(path_file)
    targets = []
    for step, picture in zip(steps, read_stack(film, 0, len(steps))):
        require_size(film, picture, step.camera.wh)
        targets.append(Target(step.camera, to_float(picture), np.full(step.camera.hw, weight, np.float32)))
    return room, provenance, targets
