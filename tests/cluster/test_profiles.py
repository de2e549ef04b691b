# SPDX-License-Identifier: Apache-2.0
"""Profiles of clusters: what every rule asks for and how that grows when a job fails; nightly, a Slurm of this one
machine."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from studiorecon.plan.memory import memory

from benchmarks.memory import submitted

ROOT = Path(__file__).resolve().parents[2]
PROFILES = ("slurm", "kubernetes")


def profile(name: str) -> dict:
    return yaml.safe_load((ROOT / "profiles" / name / "config.yaml").read_text())


@pytest.mark.parametrize("name", PROFILES)
def test_every_rule_asks_for_its_memory_and_for_more_after_a_failure(name: str) -> None:
    rules, requested = submitted(), profile(name).get("set-resources", {})
    assert set(requested) <= set(rules)
    assert [rule for rule, block in rules.items() if "mem_mb=memory(" not in block] == []
    assert [memory(3000)(None, attempt) for attempt in (1, 2, 3)] == [3000, 6000, 12000]
    for wanted in requested.values():
        minutes = [eval(str(wanted["runtime"]), {"attempt": attempt}) for attempt in (1, 2, 3)]
        assert minutes == [minutes[0], 2 * minutes[0], 3 * minutes[0]]
    assert profile(name)["retries"] == 2


@pytest.mark.parametrize("name", PROFILES)
def test_gpu_rules_are_not_grouped_and_not_held_back_by_the_default_profile(name: str) -> None:
    with_gpu = {rule for rule, block in submitted().items() if "gpu=" in block}
    assert {"views_generate", "humans_canonical", "background_train"} <= with_gpu
    assert not {rule for rule in with_gpu if re.search(r"^ +group:", submitted()[rule], re.MULTILINE)}
    assert not {"groups", "group-components"} & set(profile(name))
    # The default profile is always read and allows one GPU job at a time, which is right for one machine.
    assert profile("default")["resources"]["gpu"] == 1
    assert profile(name)["resources"]["gpu"] >= 32


def test_segments_are_jobs_of_their_own() -> None:
    """A task of an array takes another's finished film with it when it fails: the plugin's issue 447."""
    assert "slurm-array-jobs" not in profile("slurm")
    assert {"views_generate", "views_synthesize"} <= set(submitted())


def test_profiles_hold_no_places_of_their_own() -> None:
    for name in PROFILES:
        text = "\n".join(
            line.partition("#")[0] for line in (ROOT / "profiles" / name / "config.yaml").read_text().splitlines()
        )
        assert "//" not in text
        assert "partition" not in text


def planned(profile_folder: Path, *arguments: str) -> str:
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "--dry-run",
        "--snakefile",
        str(ROOT / "Snakefile"),
        "--profile",
        str(profile_folder),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "workflow")}
    done = subprocess.run(
        [*command, *arguments],
        cwd=profile_folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    return done.stdout


@pytest.mark.slow
def test_a_plan_shows_what_slurm_would_get(tmp_path: Path) -> None:
    """Without the plugin: what is Snakemake's own in the profile, understood by Snakemake."""
    own = {key: value for key, value in profile("slurm").items() if key != "executor" and not key.startswith("slurm-")}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({**own, "cores": 64}))
    text = planned(
        tmp_path,
        "--config",
        "dataset=resources/studio/tiny.yaml",
        "views={synthesizer: gen3c}",
        "survey={force: {view_synthesis: 'on', closed_path: 'on'}}",
    )
    requested = {}
    for block in text.split("\nrule ")[1:]:
        resources = re.search(r"resources: (.*)", block)
        requested[block.partition(":")[0]] = (
            dict(pair.split("=", 1) for pair in resources.group(1).split(", ")) if resources else {}
        )
    generate = requested["views_generate"]
    assert (generate["gpu"], generate["mem_mb"], generate["runtime"]) == ("1", "64000", "240")
    assert requested["views_request"]["mem_mb"] == "3000"
    assert "gpu" not in requested["views_request"] or requested["views_request"]["gpu"] == "0"


@pytest.mark.slow
def test_kubernetes_is_planned_with_files_in_a_bucket(tmp_path: Path) -> None:
    """A folder stands in for the bucket: its storage plugin wants no account."""
    if importlib.util.find_spec("snakemake_storage_plugin_fs") is None:
        pytest.skip("snakemake-storage-plugin-fs is not installed")
    own = {
        key: value
        for key, value in profile("kubernetes").items()
        if key not in ("executor", "default-storage-provider")
    }
    bucket = {"default-storage-provider": "fs", "default-storage-prefix": str(tmp_path / "bucket"), "cores": 8}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(own | bucket))
    text = planned(
        tmp_path,
        "--config",
        "dataset=resources/studio/tiny.yaml",
        "survey={force: {view_synthesis: 'on', closed_path: 'on'}}",
    )
    assert "views_synthesize" in text
    assert "(storage)" in text or "bucket" in text


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_segments_go_through_slurm_each_with_its_gpu(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "STUDIORECON_SCRATCH": str(tmp_path),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    script = ROOT / "tests/cluster/slurm.sh"
    done = subprocess.run([str(script)], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode == 77:
        pytest.skip(done.stdout.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout[-4000:]
    assert "5 jobs, each with one GPU" in done.stdout
