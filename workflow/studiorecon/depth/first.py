# SPDX-License-Identifier: Apache-2.0
"""``depth.first``: the first moment's depth from the network that estimated the cameras, unchanged, as in the paper.

It includes the people at their first positions; training of the room masks them. Plane stereo is not used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.progress import say
from studiorecon.rig.first_depth import first_moment
from studiorecon.signature import Written

_INSTEAD = "set depth.reference to planes"


def run(camera: str, model: Path, first: Path, found: Path, depth: Written) -> None:
    """Write one camera's ``depth`` (EXR) in working metres from ``first``, that of the network's cameras ``found``."""
    cameras = read_model(model.parent)
    own = camera_named(cameras, camera, model)
    depth_m, sure = first_moment(first, found, cameras, own, _INSTEAD)
    known = depth_m > 0
    if not known.any():
        raise UserError(f"{first} has no depth for camera {camera}; {_INSTEAD}")
    say(f"{camera}: the network that estimated the cameras gives depth for {known.mean():.0%} of the first frame")
    write_depth(depth, depth_m.astype(np.float32), np.where(known, np.clip(sure, 0, 1), 0).astype(np.float32))
