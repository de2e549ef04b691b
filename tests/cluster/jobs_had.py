# SPDX-License-Identifier: Apache-2.0
"""Checks after ``slurm.sh``: ``python jobs_had.py NOTES JOBS FILM…``; prints a line per job and fails with a
sentence."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from studiorecon.footage.video import read_frame


def main(notes: Path, jobs: Path, films: list[Path]) -> None:
    """NOTES is the stand-in's folder, JOBS what ``scontrol show jobs`` said afterwards."""
    had = {path.name.removesuffix(".json"): json.loads(path.read_text()) for path in sorted(notes.iterdir())}
    for name, share in had.items():
        print(name, *(f"{key}={value}" for key, value in share.items()))
    assert set(had) == {"00.1", "01.1", "01.2", "02.1", "03.1"}, "every segment once, and the failed one again"
    first = [share for name, share in had.items() if name.endswith(".1")]
    assert len({share["SLURM_JOB_ID"] for share in first}) == 4, "segments share a job"
    assert not any(share["SLURM_ARRAY_JOB_ID"] for share in first), (
        "segments are an array, whose tasks remove each other's films"
    )
    for share in had.values():
        assert share["CUDA_VISIBLE_DEVICES"] in ("0", "1"), "a job sees other GPUs than its own"
    messages = [
        dict(re.findall(r"(\w+)=(\S*)", block)) for block in jobs.read_text().split("\n\n") if "JobId=" in block
    ]
    requested_mb = {job["JobId"]: megabytes(job["MinMemoryNode"]) for job in messages}
    memory = {name: requested_mb[share["SLURM_JOB_ID"]] for name, share in had.items()}
    assert memory["01.2"] >= 2 * memory["01.1"] - 1, "the second attempt has no more memory than the first"
    requested = [re.search(r"gres[/:]gpu[:=](\d+)", json.dumps(job)) for job in messages]
    assert requested, "Slurm knows no job"
    assert all(found and found.group(1) == "1" for found in requested), "a job did not ask for one GPU"
    # At any time at most two jobs ran, and never two on one GPU.
    spans = [(job["StartTime"], job["EndTime"]) for job in messages if job["StartTime"] != "Unknown"]
    assert max(sum(start <= at < end for start, end in spans) for at, _ in spans) <= 2
    for film in films:
        shape = read_frame(film, 0).shape
        assert shape == (704, 1280, 3), f"{film} is not of GEN3C's size"
    print(f"{len(films)} films, {len(had)} jobs, each with one GPU")


def megabytes(text: str) -> float:
    """``64001M`` or ``125G`` as Slurm writes it, in megabytes."""
    return float(text[:-1]) * {"M": 1, "G": 1024}[text[-1]]


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
