# SPDX-License-Identifier: Apache-2.0
"""A training that the system kills goes on at its checkpoint and writes the bytes of one that was left alone."""

from __future__ import annotations

import copy
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from studiorecon.humans.train_settings import Rates

from tests.made.background import cameras, capture
from tests.made.humans import Made, body, made

__all__ = ["body", "cameras", "capture", "made"]

ITERATIONS = 40


def command(step: str, section: Mapping, options: Mapping, outputs: Mapping[str, Path], log: Path) -> list[str]:
    given = [sys.executable, "-m", "studiorecon", step, "--settings", json.dumps(section), "--log", str(log)]
    for name, value in {**options, **outputs}.items():
        given += ["--" + name.replace("_", "-"), *(map(str, value) if isinstance(value, list) else [str(value)])]
    return given


def killed_and_taken_up(step: str, section: dict, options: Mapping, names: Mapping[str, str], folder: Path) -> None:
    """Runs the step undisturbed, then killed with SIGKILL at a checkpoint and again; compares the outputs."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}

    def outputs(run: str) -> dict[str, Path]:
        return {name: folder / run / file for name, file in names.items()}

    def start(run: str, every_s: float) -> subprocess.Popen:
        given = copy.deepcopy(section)
        given.get("training", given)["checkpoint_every_s"] = every_s
        working = {"working": folder / run / "working"}
        words = command(step, given, options, outputs(run) | working, folder / f"{run}.log")
        return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment)

    def finish(process: subprocess.Popen) -> None:
        _, problem = process.communicate(timeout=400)
        assert process.returncode == 0, problem.decode()

    finish(start("whole", 0.0))
    process = start("killed", 1e-9)
    stored = folder / "killed" / "working" / "checkpoint.npz"
    deadline = time.monotonic() + 300
    while not stored.exists():
        assert process.poll() is None, "it ended before its first checkpoint"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not any(path.exists() for path in outputs("killed").values())
    finish(start("killed", 1e-9))
    went_on = re.search(r"continues at iteration (\d+)", (folder / "killed.log").read_text())
    assert went_on, (folder / "killed.log").read_text()
    assert 0 < int(went_on.group(1)) < ITERATIONS
    for whole, again in zip(outputs("whole").values(), outputs("killed").values()):
        assert whole.read_bytes() == again.read_bytes(), whole.name
    assert not stored.exists()
    assert not (folder / "whole" / "working" / stored.name).exists()


@pytest.mark.slow  # the plain suite takes trainings up within a process
def test_a_killed_background_ends_with_the_same_bytes(
    default_settings: Callable, capture: dict, tmp_path: Path
) -> None:
    section = copy.deepcopy(default_settings("background"))
    changes = {"densify": "gradient", "densify_every": 10, "densify_from": 10}
    section["training"] = {**section["training"], "iterations": ITERATIONS, **changes}
    killed_and_taken_up(
        "background.train", section, capture, {"background": "scene.ply", "provenance": "provenance.npz"}, tmp_path
    )


@pytest.mark.slow
def test_a_killed_person_ends_with_the_same_bytes(default_settings: Callable, made: Made, tmp_path: Path) -> None:
    section = copy.deepcopy(default_settings("humans", iterations=ITERATIONS, gaussians=2000, pose_from=5))
    assert Rates().pose_rad > 0, "poses are refined too"
    section["temporal"] |= {"use": "always", "start": 2, "width": 8, "points": 0}
    section["densify"] |= {"use": "gradient", "every": 5, "until": 30, "gradient": 1e-6}
    killed_and_taken_up("humans.train", section, made.options, {"gaussians": "p3.ply", "avatar": "p3.npz"}, tmp_path)
