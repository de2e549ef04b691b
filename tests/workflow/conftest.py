# SPDX-License-Identifier: Apache-2.0
"""A copy of the workflow that tests may edit, break and kill."""

from __future__ import annotations

import atexit
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("Snakefile", "workflow", "envs", "config", "profiles", "resources")
WITNESS = Path(__file__).parent / "witness"
# What a finished house is run with: every step does its work, none of them for long.
QUICK = {
    "depth": {"primitives": 0},
    "background": {"training": {"iterations": 200}},
    "humans": {"iterations": 60, "gaussians": 2000},
    "views": {"views_per_segment": 4},
    "render": {"shots": {"orbit": {"frames": 24}}},
}


# What only plans.
PLANS = {"--dry-run", "--summary", "--list-changes"}


@cache
def planner() -> subprocess.Popen:
    """The process that plans for this one, until this one ends."""
    script = Path(__file__).with_name("planner.py")
    process = subprocess.Popen([sys.executable, script], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    atexit.register(process.communicate)
    return process


def planned(arguments: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess:
    """What ``python -m snakemake`` with these arguments does and prints, in a fraction of its time."""
    with tempfile.NamedTemporaryFile("r", suffix=".txt") as printed:
        requested = {"arguments": arguments, "folder": str(folder), "environment": environment, "printed": printed.name}
        process = planner()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(requested) + "\n")
        process.stdin.flush()
        status = int(process.stdout.readline())
        return subprocess.CompletedProcess(arguments, status, printed.read())


@dataclass(frozen=True)
class House:
    """A working directory with its own copy of the workflow and of the package."""

    folder: Path
    dataset: str
    # Where every Python process of a run here leaves what it loaded and whom it asked (witness/sitecustomize.py), if
    # anywhere.
    witness: Path | None = None

    def snakemake(self, *arguments: str, check: bool = True, path: Path | None = None) -> subprocess.CompletedProcess:
        """Run snakemake here on the house's dataset; output and errors come back as one text."""
        if PLANS.isdisjoint(arguments):
            streams = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
            done = subprocess.run(self.command(*arguments), cwd=self.folder, env=self.environment(path), **streams)
        else:
            done = planned(self.command(*arguments)[3:], self.folder, self.environment(path))
        if check:
            assert done.returncode == 0, done.stdout[-6000:]
        return done

    def command(self, *arguments: str) -> list[str]:
        config = ["--config", f"dataset={self.dataset}"] if self.dataset else []
        return [sys.executable, "-m", "snakemake", *arguments, *config]

    def environment(self, path: Path | None = None) -> dict[str, str]:
        binaries = [*([str(path)] if path else []), str(Path(sys.executable).parent), os.environ["PATH"]]
        # What keeps the workers of a test run to one thread (tests/conftest.py) is not a user's.
        own = {"OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"}
        users = {name: value for name, value in os.environ.items() if name not in own}
        watched = {"STUDIORECON_WITNESS": str(self.witness)} if self.witness else {}
        # A user's own places stay, behind the house's package: tests/gpu/run.sh has wheels there.
        places = [str(self.folder / "workflow"), *([str(WITNESS)] if watched else []), os.environ.get("PYTHONPATH", "")]
        path = os.pathsep.join(filter(None, places))
        return {**users, **watched, "PYTHONPATH": path, "PATH": os.pathsep.join(binaries)}

    def plan(self, *arguments: str) -> dict[str, int]:
        """Jobs per rule of a dry run; empty when there is nothing to do."""
        text = self.snakemake("--dry-run", "--cores", "2", *arguments).stdout
        if "Nothing to be done" in text:
            return {}
        table = text.partition("Job stats:")[2].partition("total")[0]
        return {
            m.group(1): int(m.group(2))
            for m in re.finditer(r"^(\w+) +(\d+)$", table, re.MULTILINE)
            if m.group(1) != "all"
        }

    def overlay(self, **sections: dict) -> str:
        """A configuration overlay file; returns its path."""
        path = self.folder / "overlay.yaml"
        path.write_text(yaml.safe_dump(sections))
        return str(path)

    def failing_python(self, *words: str) -> Path:
        """A folder for PATH whose ``python`` fails for the one step whose command line holds all ``words``."""
        folder = self.folder / "failing"
        folder.mkdir(exist_ok=True)
        tests = " && ".join(f'[[ " $* " == *" {w} "* ]]' for w in words)
        script = folder / "python"
        script.write_text(
            f'#!/usr/bin/env bash\nif {tests}; then echo "planted failure" >&2; exit '
            f'1; fi\nexec {sys.executable} "$@"\n'
        )
        script.chmod(script.stat().st_mode | stat.S_IXUSR)
        return folder


def over(below: dict, above: dict) -> dict:
    """``below`` with the entries of ``above``, section by section."""
    return below | {
        name: over(below[name], value) if isinstance(value, dict) else value for name, value in above.items()
    }


def make_house(folder: Path, dataset: str) -> House:
    """A house with a copy of everything; compiled kernels come along, because copies keep the times that their cache
    goes by."""
    folder.mkdir(parents=True, exist_ok=True)
    for part in PARTS:
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(source, folder / part)
        else:
            shutil.copy(source, folder / part)
    return House(folder, dataset)


@pytest.fixture(scope="session", autouse=True)
def byte_code(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where byte code does not lie beside the sources, that of the houses goes with them."""
    yield
    if sys.pycache_prefix:
        shutil.rmtree(Path(sys.pycache_prefix, *tmp_path_factory.getbasetemp().parts[1:]), ignore_errors=True)


@pytest.fixture(scope="session")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    """A house in which nothing was run yet."""
    return make_house(tmp_path_factory.mktemp("house"), "resources/studio/tiny.yaml")


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> House:
    """A house in which the smallest studio ran to its end."""
    made = replace(
        make_house(tmp_path_factory.mktemp("finished"), "resources/studio/tiny.yaml"),
        witness=tmp_path_factory.mktemp("witness"),
    )
    settings = made.folder / "config" / "config.yaml"
    settings.write_text(yaml.safe_dump(over(yaml.safe_load(settings.read_text()), QUICK), sort_keys=False))
    made.snakemake("--cores", "2")
    return made
