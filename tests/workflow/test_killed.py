# SPDX-License-Identifier: Apache-2.0
"""Runs that are killed: the lock they leave is told from a living one, and what they had made is worth what an
undisturbed run's is."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.plan.stale_lock import clear_stale_lock

from tests.workflow.conftest import QUICK, House, make_house, over

KILLS = 50
# They hold times, or how long something took.
TIMED = ("progress.html", "report/index.html", "report/cost.json", "seconds.json")


def locked(folder: Path, host: str) -> Path:
    """A working folder as a killed run leaves it."""
    (folder / ".snakemake/locks").mkdir(parents=True)
    (folder / ".snakemake/locks/0.input.lock").write_text("a\n")
    (folder / ".snakemake/log").mkdir()
    (folder / ".snakemake/log/2026.snakemake.log").write_text(f"SNAKEMAKE\n=========\n  Host: {host}\n  User: me\n")
    return folder / ".snakemake/locks"


def test_a_dead_run_s_lock_is_taken_away_and_said(tmp_path: Path) -> None:
    locks = locked(tmp_path, platform.node())
    assert "was killed" in clear_stale_lock(tmp_path)
    assert not locks.exists()
    assert clear_stale_lock(tmp_path) == ""


@pytest.mark.parametrize("words", ["snakemake", "-m studiorecon people.fit"])
def test_a_living_run_s_lock_stays_also_where_only_a_step_lives(words: str, tmp_path: Path) -> None:
    locks = locked(tmp_path, platform.node())
    with subprocess.Popen([sys.executable, "-c", "input()", words], cwd=tmp_path, stdin=subprocess.PIPE) as process:
        time.sleep(0.2)
        assert clear_stale_lock(tmp_path) == ""
        assert locks.is_dir()
        process.communicate(b"\n")
    assert "was killed" in clear_stale_lock(tmp_path)


def test_another_machine_s_lock_stays(tmp_path: Path) -> None:
    locks = locked(tmp_path, "another-machine")
    assert clear_stale_lock(tmp_path) == ""
    assert locks.is_dir()


def test_dry_runs_elsewhere_do_not_make_another_machine_s_lock_ours(tmp_path: Path) -> None:
    locks = locked(tmp_path, "another-machine")
    (tmp_path / ".snakemake/log/2026.snakemake.log").rename(
        tmp_path / ".snakemake/log/2026-11-24T003722.592663.snakemake.log"
    )
    later = tmp_path / ".snakemake/log/2100-01-01T000000.000001.snakemake.log"
    later.write_text(f"SNAKEMAKE\n  Host: {platform.node()}\n")
    assert clear_stale_lock(tmp_path) == ""
    assert locks.exists()


def started(house: House) -> subprocess.Popen:
    command = house.command("--cores", "2")
    with open(house.folder / "run.txt", "a") as log:
        return subprocess.Popen(
            command, cwd=house.folder, env=house.environment(), stdout=log, stderr=log, start_new_session=True
        )


def products(house: House) -> dict[str, str]:
    """Digest of every file of the results but those that hold times."""
    folder = house.folder / "results/tiny"
    found = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        if name not in TIMED and not path.name.startswith(".snakemake_timestamp"):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_fifty_kills_at_random_moments_end_with_the_bytes_of_an_undisturbed_run(
    finished: House, tmp_path: Path
) -> None:
    houses = []
    for name in ("undisturbed", "killed"):
        dataset = shutil.copytree(finished.folder / "results/studio/tiny/dataset", tmp_path / name / "tiny")
        house = make_house(tmp_path / name / "house", str(dataset))
        settings = house.folder / "config/config.yaml"
        settings.write_text(yaml.safe_dump(over(yaml.safe_load(settings.read_text()), QUICK), sort_keys=False))
        houses.append(house)
    undisturbed, killed = houses
    begun = time.monotonic()
    assert started(undisturbed).wait() == 0, (undisturbed.folder / "run.txt").read_text()[-4000:]
    took_s = time.monotonic() - begun
    rng = np.random.default_rng(0)
    kills = 0
    for _ in range(KILLS):
        process = started(killed)
        # Reading the workflow takes three seconds of every start; from then on any moment.
        time.sleep(3 + rng.uniform(0, 1.5 * took_s / KILLS))
        # The system kills one process at a time: in some of the cases steps outlive their driver. A terminal that is
        # closed, and Ctrl-C, reach all.
        end, number = [
            (os.kill, signal.SIGKILL),
            (os.kill, signal.SIGTERM),
            (os.killpg, signal.SIGKILL),
            (os.killpg, signal.SIGINT),
            (os.killpg, signal.SIGHUP),
        ][rng.integers(5)]
        with suppress(ProcessLookupError):
            end(process.pid, number)
        time.sleep(rng.uniform(0, 1))
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        kills += process.wait() != 0
    assert kills > KILLS / 2, "it was done before"
    assert started(killed).wait() == 0, (killed.folder / "run.txt").read_text()[-4000:]
    left = [p.name for p in (killed.folder / "results").rglob(".partial-*")]
    assert not left, "what was half written is gone"
    whole, again = products(undisturbed), products(killed)
    assert set(whole) == set(again)
    assert [name for name in whole if whole[name] != again[name]] == []
