# SPDX-License-Identifier: Apache-2.0
"""Machine code is found by what was compiled: from a clone elsewhere, and never for other sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from studiorecon.__main__ import KERNELS

ROOT = Path(__file__).resolve().parents[2]
INNER, OUTER = "geometry/inner_kernel.py", "geometry/outer_kernel.py"
HEAD = "from numba import njit\n"


@pytest.fixture
def clones(tmp_path: Path) -> list[Path]:
    """Two copies of what a kernel needs, one kernel calling another."""
    made = [tmp_path / name for name in ("one", "other")]
    for clone in made:
        package = clone / "studiorecon"
        for folder in ("geometry", "machine"):
            (package / folder).mkdir(parents=True)
        for name in ("__init__.py", "code.py", "machine/__init__.py", "machine/kernel_cache.py"):
            shutil.copy(ROOT / "workflow/studiorecon" / name, package / name)
        (package / "geometry/__init__.py").write_text("")
        inner(clone, 2)
        (package / OUTER).write_text(
            f"{HEAD}from studiorecon.geometry.inner_kernel import times\n\n"
            "@njit(cache=True)\ndef plus_one(x):\n    return times(x) + 1\n"
        )
    return made


def inner(clone: Path, factor: int) -> None:
    text = f"{HEAD}\n@njit(cache=True)\ndef times(x):\n    return {factor} * x\n"
    (clone / "studiorecon" / INNER).write_text(text)


def called(clone: Path, cache: Path, **more: str) -> tuple[int, int]:
    """(answer to 10, how often machine code was found) of the kernel, in a process of its own."""
    program = (
        "from studiorecon.geometry.outer_kernel import plus_one as f\nprint(f(10), sum(f.stats.cache_hits.values()))\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | KERNELS
    # Without byte code: sources that change within a second look unchanged to it.
    environment |= {"PYTHONPATH": str(clone), "XDG_CACHE_HOME": str(cache), "PYTHONDONTWRITEBYTECODE": "1", **more}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, text=True, capture_output=True, cwd=clone, check=True
    )
    answer, hits = done.stdout.split()
    return int(answer), int(hits)


def test_a_clone_takes_what_another_compiled(clones: list[Path], tmp_path: Path) -> None:
    one, other = clones
    assert called(one, tmp_path / "cache") == (21, 0)
    assert called(other, tmp_path / "cache") == (21, 1)
    assert not list(one.rglob("*.nbc")), "the checkout stays clean"


def test_a_kernel_that_calls_another_is_compiled_again_when_that_one_changes(
    clones: list[Path], tmp_path: Path
) -> None:
    one, other = clones
    assert called(one, tmp_path / "cache") == (21, 0)
    inner(one, 3)
    assert called(one, tmp_path / "cache") == (31, 0)
    assert called(other, tmp_path / "cache") == (21, 1), "what was there is there"


@pytest.mark.slow
def test_of_a_module_the_latest_versions_are_kept(clones: list[Path], tmp_path: Path) -> None:
    for factor in range(2, 7):
        inner(clones[0], factor)
        assert called(clones[0], tmp_path / "cache")[0] == 10 * factor + 1
    assert len(list((tmp_path / "cache/studiorecon/kernels/geometry.outer_kernel").iterdir())) == 4


@pytest.mark.slow
def test_where_nothing_can_be_written_numba_keeps_it_as_ever(clones: list[Path], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    assert called(clones[0], tmp_path / "file") == (21, 0)
    assert called(clones[0], tmp_path / "file") == (21, 1)
    assert list(clones[0].rglob("*.nbc"))
