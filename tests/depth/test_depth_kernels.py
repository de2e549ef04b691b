# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled ahead are those that the fit of the room calls, in the types in which it calls them."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher
from studiorecon.configuration.settings import load
from studiorecon.depth import box, kernels, room, sweep

from tests.made.room import made_room, photograph, ring, write_capture

SMALL = {"sweep_width": 96, "wall_step_m": 0.1, "reach_m": 6.0, "furniture_m": 1.0}
SMALL |= {"primitives": 2, "primitives_width": 64, "primitives_gain": 5.0}


def compiled() -> set[tuple[str, str]]:
    """Kernels of the stage, with the types they are compiled for in this process."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("studiorecon.depth")]
    found = {value for module in modules for value in vars(module).values() if isinstance(value, CPUDispatcher)}
    return {(kernel.py_func.__qualname__, str(types)) for kernel in found for types in kernel.signatures}


def compiled_by_the_fit_alone(folder: Path, section: dict, seen: dict, files: dict) -> set[tuple[str, str]]:
    """What ``depth.box`` and ``depth.room`` compile after ``depth.kernels``, in a process that has compiled nothing."""
    assert not compiled()
    kernels.run(folder / "kernels.txt")
    assert (folder / "kernels.txt").is_file()
    before = compiled()
    box.run(load(box.Settings, section, "depth"), **seen)
    room.run(load(room.Settings, section, "depth"), **seen, **files)
    return compiled() - before


@pytest.mark.slow
def test_the_room_is_fitted_with_the_kernels_that_were_compiled_ahead(
    default_settings: Callable[..., dict], tmp_path: Path
) -> None:
    section, cameras = default_settings("depth", **SMALL), ring(wh=(96, 54))
    plates = write_capture(tmp_path, cameras, [photograph(made_room(), camera)[0] for camera in cameras])
    model = tmp_path / "cameras" / "images.txt"
    sweeps = [tmp_path / f"{c.name}.sweep.npz" for c in cameras]
    for camera, path in zip(cameras, sweeps):
        sweep.run(load(sweep.Settings, section, "depth"), camera.name, model, plates, path)
    seen = {"model": model, "plates": plates, "sweeps": sweeps, "box": tmp_path / "box.json"}
    written = {name: tmp_path / f"{name}.out" for name in ("room_box", "primitives")}
    files = {"fits": [], "detections": [], "identities": [], "picture": tmp_path / "primitives.png", **written}
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(compiled_by_the_fit_alone, tmp_path, section, seen, files).result() == set()
