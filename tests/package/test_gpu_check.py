# SPDX-License-Identifier: Apache-2.0
"""``tests/gpu/run.sh`` where it cannot do its work: one sentence that says what is missing, and nothing written."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "gpu" / "run.sh"
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="a shell script")


def run(tools: Path, *arguments: str) -> tuple[int, str]:
    """Exit status and error line, with ``tools`` before everything on the PATH."""
    environment = {**os.environ, "PATH": f"{tools}:/usr/bin:/bin", "PYTHON": sys.executable}
    done = subprocess.run(["bash", SCRIPT, *arguments], env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    """A folder in which nvidia-smi and nvcc answer, whatever the machine has."""
    for name in ("nvidia-smi", "nvcc"):
        (tmp_path / name).write_text("#!/bin/sh\nexit 0\n")
        (tmp_path / name).chmod(0o755)
    return tmp_path


def test_without_a_gpu_it_says_so(tools: Path) -> None:
    (tools / "nvidia-smi").write_text("#!/bin/sh\nexit 9\n")
    status, told = run(tools)
    assert status == 1
    assert told == "tests/gpu/run.sh: no NVIDIA GPU answers on this machine (nvidia-smi); nothing was measured\n"


@pytest.mark.skipif(importlib.util.find_spec("gsplat") is not None, reason="gsplat is installed")
def test_a_missing_package_is_named_before_anything_is_compiled(tools: Path) -> None:
    status, told = run(tools)
    assert status == 1
    assert told.count("\n") == 1
    assert "gsplat" in told
    assert "--wheels" in told


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--speed"], "no option --speed"),
        (["--count"], "--count needs a number"),
        (["--wheels"], "--wheels needs a folder"),
    ],
)
def test_options_that_are_none_are_refused(tools: Path, arguments: list[str], sentence: str) -> None:
    status, told = run(tools, *arguments)
    assert status != 0
    assert sentence in told
