# SPDX-License-Identifier: Apache-2.0
"""Machines without AVX-512: the kernels compiled for less give the same pictures and gradients, and call no C function
per lane."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from studiorecon.splatting.cpu.blocks import block, morton_order
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.gaussians import camera, room

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="instruction sets of x86-64")
ROOT = Path(__file__).resolve().parents[2]


def blended_with_sse(folder: Path, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    np.savez(folder / "given.npz", **arrays)
    environment = {
        **os.environ,
        "NUMBA_CPU_NAME": "x86-64",
        "NUMBA_CPU_FEATURES": "-avx,-avx2,-fma,-avx512f",
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": str(ROOT / "workflow"),
    }
    script = Path(__file__).with_name("narrow_kernels.py")
    subprocess.run([sys.executable, script, folder / "given.npz", folder / "found.npz"], env=environment, check=True)
    return dict(np.load(folder / "found.npz"))


@pytest.mark.slow  # compiles every kernel anew
def test_blending_with_sse_alone_is_the_same_to_rounding_and_calls_no_c_function(tmp_path: Path) -> None:
    scene, view, ours = room(1500, 5), camera(96, 56), Rasteriser(near_m=0.01, threads=1)
    with ours.own_threads():
        planes = ours.draw(block(scene.take(morton_order(scene.means_m))), view, (0, 0, 0))
    lists = {
        "splats": ours._splats,
        "starts": ours._starts,
        "pairs": ours._pairs,
        "touched": ours._touched,
        "ends": ours._ends,
    }
    found = blended_with_sse(tmp_path, {**lists, "planes": planes, "grid": np.array(ours._grid)})
    assert found["size"] > 1000, "there is machine code to look at"
    assert not any(found[wider] for wider in ("wide", "middle", "fused")), "numba compiles for SSE"
    # Naive, llvm.fma: without the instruction sixteen calls of fmaf for every product; the design saw 70 ms for 4.
    assert found["calls"] == 0
    assert np.abs(found["planes"] - planes).mean() < 1e-6
    assert np.abs(found["planes"][:3] - planes[:3]).max() < 5e-3, (
        "a pixel may change sides at the 1/255 threshold, no more"
    )
    assert np.mean(found["ends"] == ours._ends) > 0.9, "lists end where they ended"
