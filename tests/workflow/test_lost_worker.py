# SPDX-License-Identifier: Apache-2.0
"""A worker of a cluster that is lost while it works: its job is sent again, and the run ends as if nothing had been."""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

import pytest
import yaml

from tests.workflow.conftest import House, make_house

ROOT = Path(__file__).resolve().parents[2]
# A node of a pretended cluster: a job is a process group, and its number the job's. The first job of the rule that is
# to be lost is killed with all its processes as soon as its step works, as when a node loses its power.
SUBMIT = """#!/usr/bin/env bash
set -euo pipefail
folder=FOLDER
setsid bash -c 'bash "$1"; echo $? > "$2/$$.status"' bash "$1" "$folder" > /dev/null 2>&1 &
job=$!
if grep -q 'plates_clean' "$1" && mkdir "$folder/lost" 2> /dev/null; then
  ( until pgrep -g $job -f 'studiorecon plates.clean' > /dev/null; do sleep 0.05; done; kill -9 -- -$job
    echo lost > "$folder/lost/$job" ) > /dev/null 2>&1 &
fi
echo $job
"""
STATUS = """#!/usr/bin/env bash
if [[ -e FOLDER/$1.status ]]; then
  if [[ $(cat FOLDER/$1.status) == 0 ]]; then echo success; else echo failed; fi
elif kill -0 -- -$1 2> /dev/null; then echo running
else sleep 0.2; if [[ -e FOLDER/$1.status ]]; then echo running; else echo failed; fi
fi
"""
PLATES = [f"results/tiny/plates/cam{k}.png" for k in (1, 2, 3, 4)]


def plates(house: House) -> dict[str, str]:
    return {name: hashlib.sha256((house.folder / name).read_bytes()).hexdigest() for name in PLATES}


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_lost_worker_s_job_is_sent_again(tmp_path: Path, finished: House) -> None:
    if importlib.util.find_spec("snakemake_executor_plugin_cluster_generic") is None:
        pytest.skip("snakemake-executor-plugin-cluster-generic is not installed")
    house = make_house(tmp_path / "house", "resources/studio/tiny.yaml")
    node = tmp_path / "node"
    node.mkdir()
    for name, text in (("submit", SUBMIT), ("status", STATUS)):
        (node / name).write_text(text.replace("FOLDER", str(node)))
        (node / name).chmod(0o755)
    own = yaml.safe_load((ROOT / "profiles/slurm/config.yaml").read_text())
    kept = {key: own[key] for key in ("keep-going", "rerun-incomplete", "retries", "latency-wait", "show-failed-logs")}
    kept |= {"executor": "cluster-generic", "jobs": 2, "cores": 2, "seconds-between-status-checks": 1}
    (tmp_path / "profile").mkdir()
    (tmp_path / "profile/config.yaml").write_text(yaml.safe_dump(kept))
    generic = [f"--cluster-generic-{name}-cmd={node / name}" for name in ("submit", "status")]
    done = house.snakemake("--profile", str(tmp_path / "profile"), *generic, *PLATES, check=False)
    assert done.returncode == 0, done.stdout[-6000:]
    assert list((node / "lost").iterdir()), "no worker was lost"
    assert "Trying to restart job" in done.stdout
    assert plates(house) == plates(finished)
    assert not list((house.folder / "results").rglob(".partial-*"))
