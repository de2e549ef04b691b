# SPDX-License-Identifier: Apache-2.0
"""The first moment's depth from the network that estimated the cameras (``calibration.network``), in the scene's metres
and size."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.images.sizes import resample_nearest
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Two cameras of one picture: the network's and the working one differ only by rounding.
_FOCAL_TOLERANCE = 0.05


def network_scale(found: Sequence[Camera], used: Sequence[Camera], instead: str) -> float:
    """Working metres per metre of the network: the ratio of distances between the same cameras.

    It does not depend on later moves or scales of the world. Raises UserError, with the remedy ``instead``, when they
    share fewer than two positions.
    """
    own = {c.name: c.centre_m for c in found}
    shared = [(own[c.name], c.centre_m) for c in used if c.name in own]
    before, after = (sum(float(np.linalg.norm(a[k] - b[k])) for a, b in combinations(shared, 2)) for k in (0, 1))
    if not before > 0:
        raise UserError(
            f"the network's cameras ({', '.join(sorted(own))}) and those in use share no two "
            f"positions, so the scale of its depth is unknown; {instead}"
        )
    return after / before


def first_moment(
    first: Path, found: Path, cameras: Sequence[Camera], own: Camera, instead: str
) -> tuple[Num[np.ndarray, "H W"], Num[np.ndarray, "H W"]]:
    """Depth of the first moment in working metres, 0 = unknown, and its confidence, at the size of the camera ``own``.

    ``first`` is the depth (EXR) in the metres of the network's cameras ``found``, ``cameras`` are those in use. Raises
    UserError, with the remedy ``instead``, when the two show different pictures.
    """
    network = read_model(found.parent)
    seen = camera_named(network, own.name, found)
    apart = seen.resized(own.wh).focal_px[0] / own.focal_px[0]
    if abs(apart - 1) > _FOCAL_TOLERANCE:
        raise UserError(
            f"camera {own.name} has {apart:.2f} times its focal length where the network measured depth, so the two "
            f"do not show the same picture; {instead}"
        )
    depth, sure = read_depth(first)
    factor = network_scale(network, cameras, instead)
    return factor * resample_nearest(depth, own.hw).astype(np.float64), resample_nearest(sure, own.hw)
