# SPDX-License-Identifier: Apache-2.0
"""Every step of a finished run again, alone, on a machine that refuses it something: room on the disk, the right to
write, memory, a place for temporary files. It ends in a sentence, and what was there stays as it was."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.workflow.conftest import House

# Quick steps that write what the others write: a picture, arrays, depth, a film.
QUICK_STEPS = ("plates.clean", "depth.sweep", "depth.refine", "people.overlay")
READ_ONLY = "mount --bind results results && mount -o remount,bind,ro results && exec {command}"
FULL = "ulimit -f 4; exec {command}"
POOR = "ulimit -v {kilobytes}; exec {command}"
# Too little memory makes some libraries end the process, or crash, and where no thread can be started numba waits for
# ever.
RUNS_ON = -1
ENDED_BY_LIBRARIES = ("OpenBLAS error: Memory allocation still failed", "LLVM ERROR: out of memory", "std::bad_alloc")


@dataclass(frozen=True)
class Job:
    """A step as a finished run called it."""

    step: str
    arguments: tuple[str, ...]

    def command(self) -> str:
        return shlex.join(["python", "-m", "studiorecon", self.step, *self.arguments])


@dataclass(frozen=True)
class Ended:
    """How a job ended, in how many of its user's files."""

    status: int
    text: str

    @property
    def last(self) -> str:
        return next(iter(self.text.strip().splitlines()[-1:]), "")


def jobs_of(finished: House) -> list[Job]:
    """One job of every step that the run had, in no order that matters."""
    assert finished.witness is not None
    commands = [json.loads(path.read_text())["command"] for path in sorted(finished.witness.glob("*.json"))]
    found = {
        c[1]: Job(c[1], tuple(c[2:])) for c in commands if c[0].endswith("studiorecon/__main__.py") and "." in c[1]
    }
    assert len(found) > 30
    return [found[step] for step in sorted(found)]


def place(finished: House, folder: Path) -> Path:
    """A folder with a finished run's results, where no workflow engine was."""
    shutil.copytree(finished.folder / "results", folder / "results")
    for part in ("resources", "config", "timings", "workflow"):
        (folder / part).symlink_to(finished.folder / part)
    return folder


def tried(finished: House, folder: Path, job: Job, script: str, limit_s: float = 300, **variables: str) -> Ended:
    """One job in ``folder``, by a shell ``script`` that holds its command."""
    namespace = ["unshare", "-rm"] if "mount" in script else []
    shell = [*namespace, "bash", "-c", script.format(command=job.command())]
    environment = {**finished.environment(), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    environment = {name: value for name, value in environment.items() if value != "unset"}
    environment.pop("STUDIORECON_WITNESS", None)
    streams = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    try:
        done = subprocess.run(shell, cwd=folder, env=environment, timeout=limit_s, **streams)
    except subprocess.TimeoutExpired:
        return Ended(RUNS_ON, f"{job.step} runs on without an end")
    return Ended(done.returncode, done.stdout)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def unchanged(before: dict[str, str], after: dict[str, str]) -> list[str]:
    """Files that are not what they were; those that hold how long something took are new with every run."""
    timed = ("report/index.html", "report/cost.json", "progress.html", ".snakemake_timestamp")
    names = sorted(before.keys() | after.keys())
    return [n for n in names if before.get(n) != after.get(n) and not n.endswith(timed)]


def refusals(finished: House, folder: Path, steps: tuple[str, ...], script: str, sentence: str) -> int:
    """How many of the jobs are refused; each of them says why, and leaves what there was."""
    before, refused = digests(folder / "results"), 0
    for job in jobs_of(finished):
        # It empties its own folder before it films.
        if job.step == "studio.capture" or (steps and job.step not in steps):
            continue
        ended = tried(finished, folder, job, script)
        assert "Traceback" not in ended.text, (job.step, ended.text[-3000:])
        if ended.status != 0:
            refused += 1
            assert f"{job.step}: {sentence}" in ended.last, (job.step, ended.text[-2000:])
            assert "run again: finished results are kept" in ended.last
        changed = unchanged(before, digests(folder / "results"))
        assert not changed, (job.step, changed)
    return refused


def can_mount() -> bool:
    if shutil.which("unshare") is None:
        return False
    return subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode == 0


def test_on_a_full_disk_a_step_says_so_and_leaves_what_there_was(finished: House, tmp_path: Path) -> None:
    folder = place(finished, tmp_path / "full")
    assert refusals(finished, folder, QUICK_STEPS, FULL, "the disk is full (") == len(QUICK_STEPS)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_on_a_full_disk_every_step_says_so_and_leaves_what_there_was(finished: House, tmp_path: Path) -> None:
    """Files of up to 4 kB are written, so that some steps with small results come through."""
    assert refusals(finished, place(finished, tmp_path / "full"), (), FULL, "the disk is full (") > 15


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not can_mount(), reason="this user may not mount folders of their own (unshare -rm)")
def test_in_a_folder_that_is_read_only_every_step_says_so(finished: House, tmp_path: Path) -> None:
    folder = place(finished, tmp_path / "closed")
    refused = refusals(finished, folder, (), READ_ONLY, "this may not be read or written (results/")
    assert refused == len(jobs_of(finished)) - 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_without_a_home_and_a_folder_for_temporary_files_every_step_works(finished: House, tmp_path: Path) -> None:
    folder = place(finished, tmp_path / "homeless")
    before = digests(folder / "results")
    for job in jobs_of(finished):
        ended = tried(finished, folder, job, "exec {command}", HOME="unset", TMPDIR=str(tmp_path / "nowhere"))
        assert ended.status == 0, (job.step, ended.text[-3000:])
    assert not unchanged(before, digests(folder / "results"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("megabytes", [600, 900, 1200])
def test_with_too_little_memory_every_step_says_so_or_works(finished: House, tmp_path: Path, megabytes: int) -> None:
    folder = place(finished, tmp_path / "poor")
    before = digests(folder / "results")
    for job in jobs_of(finished):
        if job.step == "studio.capture":
            continue
        ended = tried(finished, folder, job, POOR.replace("{kilobytes}", str(megabytes * 1000)), limit_s=60)
        reported = "there is not enough memory (" in ended.last or "MB of memory (ulimit -v)" in ended.last
        given_up = ended.status < 0 or any(words in ended.text for words in ENDED_BY_LIBRARIES)
        assert ended.status == 0 or reported or given_up, (job.step, ended.text[-2000:])
        assert not unchanged(before, digests(folder / "results")), job.step


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_step_that_the_system_kills_is_named_with_what_would_help(finished: House, tmp_path: Path) -> None:
    folder = tmp_path / "killing"
    folder.mkdir()
    script = folder / "python"
    words = '[[ " $* " == *" report.audit "* ]]'
    real = shutil.which("python", path=finished.environment()["PATH"])
    script.write_text(f'#!/usr/bin/env bash\nif {words}; then kill -9 $$; fi\nexec {real} "$@"\n')
    script.chmod(0o755)
    done = finished.snakemake("--cores", "2", "-R", "report_audit", check=False, path=folder)
    assert done.returncode != 0
    assert "report.audit: the system killed it, as it does when memory runs out; run fewer jobs" in done.stdout
    finished.snakemake("--cores", "2")
