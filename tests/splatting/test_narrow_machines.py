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

from tests.made.gaussians import camera, hard, room

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="instruction sets of x86-64")
ROOT = Path(__file__).resolve().parents[2]
# Name → NUMBA_CPU_NAME, NUMBA_CPU_FEATURES.
INSTRUCTION_SETS = {"AVX2": ("haswell", "+avx2,+fma"), "SSE": ("x86-64", "-avx,-avx2,-fma,-avx512f")}
FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


def on_a_smaller_machine(
    folder: Path, instruction_set: str, what: str, arrays: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    np.savez(folder / "given.npz", **arrays)
    name, features = INSTRUCTION_SETS[instruction_set]
    environment = {
        **os.environ,
        "NUMBA_CPU_NAME": name,
        "NUMBA_CPU_FEATURES": features,
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": str(ROOT / "workflow"),
    }
    script = Path(__file__).with_name("narrow_kernels.py")
    subprocess.run(
        [sys.executable, script, folder / "given.npz", folder / "found.npz", what], env=environment, check=True
    )
    return dict(np.load(folder / "found.npz"))


def assert_machine_code(found: dict[str, np.ndarray], instruction_set: str) -> None:
    assert found["size"] > 1000, "there is machine code to look at"
    assert not found["wide"], "numba was told that there are no 512 bits"
    assert found["middle"] == found["fused"] == (instruction_set == "AVX2")
    # Naive, llvm.fma: without the instruction sixteen calls of fmaf for every product; the design saw 70 ms for 4.
    assert found["calls"] == 0


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
    found = on_a_smaller_machine(tmp_path, "SSE", "blend", {**lists, "planes": planes, "grid": np.array(ours._grid)})
    assert_machine_code(found, "SSE")
    assert np.abs(found["planes"] - planes).mean() < 1e-6
    assert np.abs(found["planes"][:3] - planes[:3]).max() < 5e-3, (
        "a pixel may change sides at the 1/255 threshold, no more"
    )
    assert np.mean(found["ends"] == ours._ends) > 0.9, "lists end where they ended"


@pytest.mark.slow
@pytest.mark.parametrize("instruction_set", list(INSTRUCTION_SETS))
@pytest.mark.parametrize("scene", [room(1500, 5), hard(600, 1)], ids=["room", "hard"])
def test_pictures_and_gradients_are_the_same_to_rounding(tmp_path: Path, scene, instruction_set: str) -> None:
    view = camera(96, 56)
    by = np.random.default_rng(3).normal(size=(*view.hw, 3)).astype(np.float32)
    ours = Rasteriser(near_m=0.01, threads=1)
    rgb = ours.forward(scene, view).rgb
    gradients = ours.backward(by)
    arrays = {name: getattr(scene, name) for name in FIELDS} | {
        "by": by,
        "wh": np.array(view.wh),
        "intrinsics": view.intrinsics,
    }
    found = on_a_smaller_machine(
        tmp_path, instruction_set, "everything", {**arrays, "camera_from_world": view.camera_from_world}
    )
    assert_machine_code(found, instruction_set)
    assert np.abs(found["rgb"] - rgb).mean() < 1e-6
    for name in FIELDS:
        wanted = getattr(gradients, name)
        assert np.linalg.norm(found[name] - wanted) < 2e-4 * np.linalg.norm(wanted), name
