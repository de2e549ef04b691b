# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled ahead are those that trainings call, in the types in which they call them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher
from studiorecon.background import kernels
from studiorecon.configuration.settings import load
from studiorecon.humans import train
from studiorecon.humans.train_settings import Settings

from tests.made.humans import Made, body, made  # noqa: F401
from tests.made.steps import call


def compiled() -> set[tuple[str, str]]:
    """Kernels of the foundations that trainings share, with the types they are compiled for."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("studiorecon.")]
    found = {value for module in modules for value in vars(module).values() if isinstance(value, CPUDispatcher)}
    shared = [kernel for kernel in found if kernel.py_func.__module__.split(".")[1] in ("splatting", "body")]
    return {(kernel.py_func.__qualname__, str(types)) for kernel in shared for types in kernel.signatures}


@pytest.mark.slow
def test_a_person_is_trained_with_the_kernels_that_were_compiled_ahead(
    made: Made, default_settings: Callable[..., dict], tmp_path: Path
) -> None:
    kernels.run(1, "cpu", tmp_path / "kernels.txt")
    assert (tmp_path / "kernels.txt").is_file()
    before = compiled()
    section = default_settings("humans", iterations=6, pose_from=1)
    section["temporal"] = {**section["temporal"], "use": "always", "start": 1}
    settings = load(Settings, section, "humans")
    files = {"gaussians": tmp_path / "p3.ply", "avatar": tmp_path / "p3.npz", "working": tmp_path / "working"}
    call(train.run, settings, **made.options, **files)
    assert before
    assert compiled() - before == set()


def test_on_a_gpu_its_kernels_are_the_ones_compiled_ahead(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    places = []
    monkeypatch.setenv("MAX_JOBS", "1")
    monkeypatch.setattr(kernels, "resolve", lambda setting, what: setting)
    monkeypatch.setattr(kernels, "train_still", lambda *_, device, **__: places.append(device))
    monkeypatch.setattr(kernels, "_as_a_person", lambda threads: places.append("a person's"))
    kernels.run(1, "cuda", tmp_path / "kernels.txt")
    assert places == ["cuda"]
