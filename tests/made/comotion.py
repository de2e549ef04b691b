# SPDX-License-Identifier: Apache-2.0
"""What tests of comotion and their neighbours share."""

from __future__ import annotations

import numpy as np
from studiorecon.models.adapters.comotion import JOINTS

from tests.made.networks import room_views


def slots(ids: list[int], seed: int = 0) -> dict[str, np.ndarray]:
    """Track slots with people two metres apart in a camera's frame, seen by the first camera of the made room."""
    camera = room_views((192, 108))[0][0]
    rng = np.random.default_rng(seed)
    count = len(ids)
    joints = (
        rng.normal(0, 0.25, (count, JOINTS, 3))
        + np.array([0, 0, 5.0])
        + 2.0 * np.arange(count)[:, None, None] * np.array([1, 0, 0])
    )
    pixels = joints @ camera.intrinsics.T
    return {
        "id": np.array(ids, np.float32),
        "pose": rng.normal(0, 0.2, (count, 72)).astype(np.float32),
        "betas": rng.normal(0, 1, (count, 10)).astype(np.float32),
        "trans": rng.normal(0, 1, (count, 3)).astype(np.float32),
        "pred_3d": joints.astype(np.float32),
        "pred_2d": (pixels[..., :2] / pixels[..., 2:]).astype(np.float32),
    }
