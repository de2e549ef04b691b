# SPDX-License-Identifier: Apache-2.0
"""Files from the future are refused before the first job; Snakemake would fail at its end."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.plan.dates import refuse_future


def dated(path: Path, seconds: float) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("x")
    os.utime(path, (seconds, seconds))
    return path


def test_a_recorder_whose_clock_was_ahead_is_reported_with_the_command_that_mends_it(tmp_path: Path) -> None:
    now = time.time()
    dated(tmp_path / "take/videos/cam1.mp4", now - 9000)
    ahead = dated(tmp_path / "take/videos/cam2.mp4", now + 90_000)
    refuse_future(tmp_path / "take", tmp_path / "results", now + 90_000)
    with pytest.raises(
        UserError, match=r"take holds files dated in the future \(1, the latest .*cam2\.mp4: "
    ) as refusal:
        refuse_future(tmp_path / "take", tmp_path / "results", now)
    subprocess.run(str(refusal.value).rpartition("today: ")[2], shell=True, check=True)
    assert ahead.stat().st_mtime <= now
    refuse_future(tmp_path / "take", tmp_path / "results", now)


def test_a_clock_that_stepped_back_is_reported_with_results(tmp_path: Path) -> None:
    now = time.time()
    for name in ("a.npz", "cameras/images.txt"):
        dated(tmp_path / "results" / name, now + 4000)
    with pytest.raises(UserError, match=r"results holds files dated in the future \(2, "):
        refuse_future(tmp_path / "take", tmp_path / "results", now)
    # File servers' clocks differ by a little.
    refuse_future(tmp_path / "take", tmp_path / "results", now + 3998)
