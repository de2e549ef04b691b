# SPDX-License-Identifier: Apache-2.0
"""Checksums of a picture and its gradients for one to three shares of work, as JSON:
``NUMBA_NUM_THREADS=3 python -m tests.splatting.several_threads``."""

from __future__ import annotations

import hashlib
import json

import numba
import numpy as np
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.gaussians import camera, hard
from tests.made.splatting_gradients import FIELDS, NEAR_M


def checksums(threads: int) -> list[str]:
    """Of the picture and of every gradient of a hard set, whose work is split among ``threads``."""
    view, rasteriser = camera(160, 90), Rasteriser(near_m=NEAR_M, threads=threads)
    by = np.random.default_rng(1).normal(size=(*view.hw, 3)).astype(np.float32)
    drawn = rasteriser.forward(hard(900, 7), view)
    gradients = rasteriser.backward(by)
    arrays = [drawn.rgb, drawn.depth_m, *(getattr(gradients, name) for name in FIELDS)]
    return [hashlib.sha256(array.tobytes()).hexdigest() for array in arrays]


if __name__ == "__main__":
    print(json.dumps({"threads": numba.get_num_threads(), "checksums": [checksums(n) for n in (1, 2, 3)]}))
