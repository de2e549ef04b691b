# SPDX-License-Identifier: Apache-2.0
"""``humans.canonical``: a person in a rest pose by a network, from one photo.

The photo is the capture's best (``photo``), or one of a person outside the capture (``stranger``). Runs on request, or
where a film's ``replace`` names a photo. Writes a canonical ``.ply`` (3DGS layout, SMPL's body axes), to replace a
person (paper: human replacement).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from studiorecon.footage.stills import read_image
from studiorecon.models.catalogue.selection import CANONICAL
from studiorecon.models.loading import load
from studiorecon.progress import say
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.signature import Place, Written


def run(photo: Path, weights: Place, gaussians: Written) -> None:
    """Write the canonical Gaussians of the person in ``photo`` (PNG with alpha)."""
    stored = read_image(photo, cv2.IMREAD_UNCHANGED)
    network = load("canonical avatar", CANONICAL, weights, "cuda")
    made = network.avatar(np.ascontiguousarray(stored[..., 2::-1]), stored[..., 3] >= 128)
    name = photo.name.partition(".")[0]
    say(f"{name}: {made.count} Gaussians in the rest pose, height {np.ptp(made.means_m[:, 1]):.2f} m")
    write_ply(gaussians, made)
