# SPDX-License-Identifier: Apache-2.0
"""A library that does not load says which it is, which step wanted it, and what brings it."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import types
from pathlib import Path

import pytest
from studiorecon.__main__ import _run
from studiorecon.machine.libraries import install_remedy, missing_library

ROOT = Path(__file__).resolve().parents[2]
BROKEN = {
    # As open3d fails where the desktop's libraries are missing: Python itself says it, without a name.
    "extension": "raise ImportError('libnot-there.so.0: cannot open shared object file')",
    # As a library fails that loads a shared object by hand.
    "by hand": "import ctypes; ctypes.CDLL('libnot-there.so.0')",
    "missing": "raise ModuleNotFoundError('No module named LIBRARY', name='LIBRARY')",
}


def broken(library: str, body: str, folder: Path) -> Path:
    """A folder that holds such a package, for before the installed one."""
    package = folder / "site-packages" / library
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(body.replace("LIBRARY", library) + "\n")
    return package.parent


def run_without(library: str, body: str, folder: Path, *words: str) -> subprocess.CompletedProcess:
    """``python -m studiorecon`` where that library does not load."""
    path = os.pathsep.join([str(broken(library, body, folder)), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "studiorecon", *words]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, text=True, capture_output=True, check=False)


def test_a_library_without_a_wheel_for_this_processor_is_not_sought_on_the_registry(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert "no wheel for this processor (aarch64)" in install_remedy("pycolmap")
    assert "uv sync" in install_remedy("numpy")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "pythons"),
    [
        ("x86_64-manylinux_2_28", ("3.11", "3.13")),
        ("aarch64-manylinux_2_28", ("3.11", "3.13")),
        ("aarch64-apple-darwin", ("3.11", "3.13")),
    ],
)
def test_the_plain_environment_has_wheels_on_other_machines(platform: str, pythons: tuple[str, ...]) -> None:
    """connection-pool, which Snakemake needs, is pure Python without a wheel."""
    for python in pythons:
        where = ("--python-platform", platform, "--python-version", python)
        wheels = ("--only-binary", ":all:", "--no-binary", "connection-pool")
        command = ["uv", "pip", "compile", "--quiet", "pyproject.toml", "--extra", "run", *where, *wheels]
        environment = {**os.environ, "MACOSX_DEPLOYMENT_TARGET": "14.0"}
        done = subprocess.run(command, cwd=ROOT, env=environment, text=True, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("how", BROKEN)
def test_a_library_that_a_step_cannot_do_without_is_named_with_its_remedy(how: str, tmp_path: Path) -> None:
    log = tmp_path / "logs/capture.log"
    done = run_without("embreex", BROKEN[how], tmp_path, "studio.capture", "--log", str(log))
    assert done.returncode == 1
    assert done.stderr.startswith("studio.capture: the library embreex cannot be loaded (")
    assert "uv sync" in done.stderr
    assert "Traceback" not in done.stderr
    assert log.read_text() == done.stderr


@pytest.mark.parametrize(("library", "extra"), [("open3d", "mesh"), ("gsplat", "gpu")])
@pytest.mark.parametrize("how", BROKEN)
def test_a_library_that_is_loaded_on_the_way_is_named_with_its_extra(
    how: str,
    library: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    broken(library, BROKEN[how], tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "site-packages")
    monkeypatch.delitem(sys.modules, library, raising=False)
    step = types.SimpleNamespace(run=lambda: importlib.import_module(library))
    assert _run(step, "deliver.room", {"settings": "{}"}, log=None) == 1
    reported = capsys.readouterr().err
    assert reported.startswith(f"deliver.room: the library {library} cannot be loaded (")
    assert f"uv sync --inexact --extra {extra}" in reported
    assert len(reported.splitlines()) == 1


def test_a_file_that_is_not_there_is_no_library(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nothing") as caught:
        (tmp_path / "nothing.so").read_bytes()
    assert missing_library(caught.value) is None
    with pytest.raises(ModuleNotFoundError) as missing:
        importlib.import_module("studiorecon.nothing")
    assert missing_library(missing.value) is None, "our own"


def test_a_step_that_is_not_there_is_still_no_library(tmp_path: Path) -> None:
    done = run_without("embreex", BROKEN["missing"], tmp_path, "studio.nothing")
    assert done.returncode == 2
    assert "no step 'studio.nothing'" in done.stderr
