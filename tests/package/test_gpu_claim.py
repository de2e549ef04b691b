# SPDX-License-Identifier: Apache-2.0
"""Several GPUs in one machine, planted as a list: every job has its own, and a scheduler's word stands."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from studiorecon.machine import gpu

ONE_JOB = """
import os, sys
from studiorecon.machine.gpu import claim_gpu
claim_gpu()
claim_gpu()
print(os.environ["CUDA_VISIBLE_DEVICES"], flush=True)
sys.stdin.readline()
"""


def job(root: Path, tmp_path: Path, devices: str) -> tuple[subprocess.Popen, str]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(root / "workflow"),
        "CUDA_VISIBLE_DEVICES": devices,
        "TMPDIR": str(tmp_path),
    }
    started = subprocess.Popen(
        [sys.executable, "-c", ONE_JOB], env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    lines = [started.stdout.readline()]
    while not lines[-1].strip() or ":" in lines[-1]:
        assert lines[-1], "the job ended before it named its GPU"
        lines.append(started.stdout.readline())
    return started, lines[-1].strip()


def finish(*jobs: subprocess.Popen) -> None:
    for one in jobs:
        one.communicate("\n", timeout=20)


def test_every_job_has_its_own_gpu_and_leaves_it_free_however_it_ends(root: Path, tmp_path: Path) -> None:
    first, a = job(root, tmp_path, "0,1,GPU-5f")
    second, b = job(root, tmp_path, "0,1,GPU-5f")
    third, c = job(root, tmp_path, "0,1,GPU-5f")
    # Without a claim all three would compute on the first.
    assert [a, b, c] == ["0", "1", "GPU-5f"]
    second.kill()
    second.communicate()
    again, d = job(root, tmp_path, "0,1,GPU-5f")
    assert d == "1"
    finish(first, third, again)


def test_what_a_scheduler_has_given_stands(root: Path, tmp_path: Path) -> None:
    first, a = job(root, tmp_path, "3")
    second, b = job(root, tmp_path, "3")
    assert (a, b) == ("3", "3")
    finish(first, second)
    assert not list(tmp_path.iterdir())


def test_more_jobs_than_gpus_share_and_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(gpu, "_HELD", [])
    folder = tmp_path / f"studiorecon-gpus-{os.getuid()}"
    folder.mkdir()
    held = [gpu.first_free(["0", "1"], folder)[1] for _ in range(2)]
    gpu.claim_gpu()
    assert os.environ["CUDA_VISIBLE_DEVICES"] in ("0", "1")
    assert "more jobs than GPUs run here; use --resources gpu=2" in capsys.readouterr().out
    for lock in held:
        lock.close()


def test_without_gpus_nothing_is_claimed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert gpu.visible_gpus() == []
    smi = tmp_path / "nvidia-smi"
    smi.write_text("#!/bin/sh\necho GPU-1a\necho GPU-2b\n")
    smi.chmod(0o755)
    assert gpu.visible_gpus() == ["GPU-1a", "GPU-2b"]
