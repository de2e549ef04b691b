# SPDX-License-Identifier: Apache-2.0
"""Container images: how each engine is asked, what is said when none answers, and, nightly, the core image for real."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.models import containers
from studiorecon.models.containers import ContainerImage, build_image, definition, find_engine, instructions, read_image


def planted(folder: Path, name: str, script: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


def test_the_first_engine_that_works_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    planted(tmp_path / "bin", "docker", "echo 27.0")
    assert find_engine() == "docker"
    planted(tmp_path / "bin", "podman", "echo cannot >&2; exit 1")
    assert find_engine() == "docker"
    planted(tmp_path / "bin", "apptainer", "echo apptainer version 1.3.0")
    assert find_engine() == "apptainer"


def test_without_an_engine_one_sentence_says_what_each_of_them_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    planted(tmp_path / "bin", "docker", "echo Cannot connect to the Docker daemon >&2; exit 1")
    sentence = (
        r"apptainer is not installed; podman is not installed; docker does not work here "
        r"\(Cannot connect to the Docker daemon\)"
    )
    with pytest.raises(UserError, match=sentence):
        containers.run(["core=studiorecon/core:0.1.0"], tmp_path, tmp_path)


def test_podman_is_given_folder_tag_and_context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, root: Path) -> None:
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    planted(tmp_path / "bin", "podman", f'echo "$@" >> {tmp_path}/calls; echo sha256:12')
    messages = build_image("podman", ContainerImage("core", "studiorecon/core", "0.1.0"), root, tmp_path)
    calls = (tmp_path / "calls").read_text().splitlines()
    assert calls[0] == f"build -f {root}/envs/core/Containerfile -t studiorecon/core:0.1.0 {root}"
    assert "studiorecon/core:0.1.0 in podman's store (sha256:12)" in messages


def test_apptainer_makes_a_file_completely_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, root: Path
) -> None:
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    core = ContainerImage("core", "studiorecon/core", "0.1.0")
    planted(tmp_path / "bin", "apptainer", 'echo half > "$3"; echo no space left; exit 1')
    with pytest.raises(UserError, match=r"image core could not be built by apptainer \(no space left\)"):
        build_image("apptainer", core, root, tmp_path / "images")
    assert not (tmp_path / "images/core-0.1.0.sif").exists()
    planted(tmp_path / "bin", "apptainer", 'cp "$4" "$3"')
    assert "core-0.1.0.sif, which --sdm apptainer uses" in build_image("apptainer", core, root, tmp_path / "images")
    assert (
        (tmp_path / "images/core-0.1.0.sif")
        .read_text()
        .startswith("Bootstrap: docker\nFrom: docker.io/library/python:3.11-slim\n")
    )


def test_a_containerfile_becomes_a_definition() -> None:
    text = "# c\nARG BASE=a/b:1\nFROM ${BASE}\nENV A=1\nRUN one \\\n  two\nCOPY x /opt/x\nENV PYTHONPATH=/opt\n"
    assert definition(text).split("\n") == [
        "Bootstrap: docker",
        "From: a/b:1",
        "",
        "%files",
        "    x /opt/x",
        "",
        "%environment",
        "    export A=1",
        "    export PYTHONPATH=/opt",
        "",
        "%post",
        "    set -e",
        "    export A=1",
        "    one    two",
        "    export PYTHONPATH=/opt",
        "",
    ]
    with pytest.raises(UserError, match="WORKDIR has no counterpart"):
        instructions("WORKDIR /opt")


def test_an_image_is_named_in_full() -> None:
    assert read_image("core=studiorecon/core:0.1.0") == ContainerImage("core", "studiorecon/core", "0.1.0")
    with pytest.raises(ValueError, match="not NAME=ADDRESS:VERSION"):
        read_image("core")


def test_the_driver_image_holds_the_whole_workflow(tmp_path: Path, root: Path) -> None:
    """Its files alone plan a film in a folder of a user's own."""
    text = (root / "envs/driver/Containerfile").read_text()
    for source, target in re.findall(r"^COPY (\S+) (\S+)$", text, re.MULTILINE):
        place = tmp_path / target.lstrip("/")
        place.parent.mkdir(parents=True, exist_ok=True)
        if (root / source).is_dir():
            shutil.copytree(root / source, place, ignore=shutil.ignore_patterns("__pycache__"))
        elif (root / source).name != "requirements.txt":
            shutil.copy(root / source, place)
    (tmp_path / "work").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "studiorecon.cli.command", "demo", "--cores", "1", "--", "--dry-run"],
        cwd=tmp_path / "work",
        env={**os.environ, "PYTHONPATH": str(tmp_path / "opt/studiorecon/workflow")},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert f"Snakefile: {tmp_path}/opt/studiorecon/Snakefile" in done.stdout
    assert "studio_capture" in done.stdout


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_the_core_image_is_built_and_rules_run_with_only_what_it_has(root: Path, tmp_path: Path) -> None:
    script = root / "tests/containers/core.sh"
    environment = {**os.environ, "STUDIORECON_SCRATCH": str(tmp_path)}
    done = subprocess.run([str(script)], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode == 77:
        pytest.skip(done.stdout.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout[-4000:]
    assert "jobs ran in the image" in done.stdout
