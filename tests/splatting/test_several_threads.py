# SPDX-License-Identifier: Apache-2.0
"""Threads that run at once give what one thread gives that does their shares one after another."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

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


def test_threads_at_once_give_the_bytes_of_one_that_does_all_shares(root: Path) -> None:
    # Workers of this run have one thread each (tests/conftest.py); these are those that every step takes (__main__).
    done = subprocess.run(
        [sys.executable, "-m", "tests.splatting.test_several_threads"],
        cwd=root,
        env=os.environ | {"NUMBA_NUM_THREADS": "3", "NUMBA_THREADING_LAYER": "workqueue"},
        text=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    reported = json.loads(done.stdout)
    assert reported["threads"] == 3
    assert reported["checksums"] == [checksums(n) for n in (1, 2, 3)]
    assert reported["checksums"][0] != reported["checksums"][2], "the shares make no difference here"


if __name__ == "__main__":
    print(json.dumps({"threads": numba.get_num_threads(), "checksums": [checksums(n) for n in (1, 2, 3)]}))
