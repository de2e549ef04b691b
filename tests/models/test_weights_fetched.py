# SPDX-License-Identifier: Apache-2.0
"""``snakemake weights`` with the hub's real client, from a server on this machine: broken off and resumed, damaged, not
allowed, no room."""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import WeightFile
from studiorecon.models.catalogue.fetching import fetch
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.sandbox import OFFLINE
from studiorecon.models.weights import stage_file

from tests.made.hub import Hub, serving

pytest.importorskip("huggingface_hub", reason="huggingface_hub is not installed")


def content_of(name: str, size: int = 200_000) -> dict[tuple[str, str], bytes]:
    """Something for every file of a network that a hub has."""
    source = np.random.default_rng(3)
    return {(f.repository, f.remote): source.bytes(size) for f in MODELS[name].weights if f.repository}


def weights(hub: Hub, name: str, folder: Path, before: Callable[[], None] | None = None) -> tuple[int, str]:
    """Status and words of the step of ``snakemake weights``, in a process of its own: the client asks once where its
    hub is."""
    environment = {key: value for key, value in os.environ.items() if key not in OFFLINE}
    environment |= {"HF_ENDPOINT": hub.address, "HF_HUB_DISABLE_XET": "1", "HF_HUB_DISABLE_PROGRESS_BARS": "1"}
    environment |= {"HF_HOME": str(folder / "home"), "HF_HUB_DISABLE_TELEMETRY": "1"}
    command = [sys.executable, "-m", "studiorecon", "models.weights", "--models", name]
    command += ["--weights", str(folder / "weights"), "--fetching", "yes"]
    done = subprocess.run(command, env=environment, text=True, capture_output=True, timeout=300, preexec_fn=before)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.timeout(300)
def test_files_come_at_the_cards_commit_and_once(tmp_path: Path) -> None:
    with serving(Hub(content_of("fixer"))) as hub:
        status, messages = weights(hub, "fixer", tmp_path)
        assert status == 0, messages
        assert messages.count("VERIFIED") == len(MODELS["fixer"].weights) == len(hub.requested)
        assert {commit for _, commit, _ in hub.requested} == {MODELS["fixer"].weights[0].revision}
        for file in MODELS["fixer"].weights:
            assert (tmp_path / "weights" / file.path).read_bytes() == hub.files[file.repository, file.remote]
        weights(hub, "fixer", tmp_path)
        assert len(hub.requested) == len(MODELS["fixer"].weights), "what is there is not fetched again"


@pytest.mark.timeout(300)
def test_what_was_broken_off_goes_on_where_it_stopped(tmp_path: Path) -> None:
    wanted = MODELS["fixer"].weights
    # The client writes down ten megabytes at a time.
    large = {(wanted[0].repository, wanted[0].remote): np.random.default_rng(4).bytes(25_000_000)}
    with serving(Hub(content_of("fixer") | large)) as hub:
        hub.breaks_at = 12_000_000
        status, messages = weights(hub, "fixer", tmp_path)
        hub.breaks_at = None
        if status:
            assert "could not be fetched" in messages
            status, messages = weights(hub, "fixer", tmp_path)
        assert status == 0, messages
        resumed = [given for _, _, given in hub.requested if given]
        assert resumed, "every try began anew"
        assert int(resumed[0].removeprefix("bytes=").partition("-")[0]) >= 10_000_000
        for file in wanted:
            assert (tmp_path / "weights" / file.path).read_bytes() == hub.files[file.repository, file.remote]


def archived(content: bytes, *names: str) -> bytes:
    """An archive with ``content`` under each of the names."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name in names:
            archive.writestr(name, content)
    return made.getvalue()


def mirrored(hub: Hub, archive: bytes, inner: bytes, hosts: tuple[str, ...]) -> WeightFile:
    """A file whose mirrors are ``hosts`` (here: owners), of which ``hub`` has those with an archive."""
    hub.files["second/copy", "points.zip"] = archive
    mirrors = tuple(f"{hub.address}/{host}/copy/resolve/main/points.zip" for host in hosts)
    checksum = hashlib.sha256(inner).hexdigest()
    return WeightFile(
        "net/points.onnx", "two hosts", remote="end2end.onnx", how="mirrors", mirrors=mirrors, sha256=checksum
    )


def test_the_second_mirror_is_used_and_goes_on_where_it_broke_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inner = np.random.default_rng(5).bytes(300_000)
    archive = archived(inner, "20230605/rtmpose/end2end.onnx")
    with serving(Hub({})) as hub:
        file = mirrored(hub, archive, inner, ("gone", "second"))
        hub.breaks_at = 100_000
        with pytest.raises(UserError, match=r"net/points\.onnx could not be fetched from two hosts"):
            fetch(file, tmp_path)
        assert not (tmp_path / file.path).exists()
        hub.breaks_at, hub.requested = None, []
        pins: dict = {}
        assert stage_file(file, tmp_path, pins, may_fetch=True) == "verified"
        assert hub.requested == [("points.zip", "main", "bytes=100000-")]
    assert (tmp_path / file.path).read_bytes() == inner
    assert pins[file.path]["sha256"] == file.sha256
    assert [path.name for path in (tmp_path / "net").iterdir()] == ["points.onnx"]
    assert "trying the next mirror" in capsys.readouterr().out


def test_a_mirror_with_other_bytes_is_refused(tmp_path: Path) -> None:
    with serving(Hub({})) as hub:
        file = mirrored(hub, archived(b"other", "a/end2end.onnx"), b"the right one", ("second",))
        assert "expected" in (messages := stage_file(file, tmp_path, {}, may_fetch=True)), messages
        (tmp_path / file.path).unlink()
        two = mirrored(hub, archived(b"x", "a/end2end.onnx", "b/end2end.onnx"), b"x", ("second",))
        assert "has 2 files end2end.onnx, expected one" in stage_file(two, tmp_path, {}, may_fetch=True)
        assert not list((tmp_path / "net").iterdir())
