# SPDX-License-Identifier: Apache-2.0
"""The digest that decides which steps an edited line re-runs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from studiorecon import code


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "studiorecon"
    shutil.copytree(code.PACKAGE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code, "PACKAGE", folder)
    return folder


def edit(path: Path, text: str) -> None:
    path.write_text(path.read_text() + text)
    code._read.cache_clear()


def test_comments_and_docstrings_change_nothing(copy: Path) -> None:
    before = code.digest("capture.manifest")
    source = (copy / "capture" / "manifest.py").read_text()
    (copy / "capture" / "manifest.py").write_text(source.replace('"""', '"""More words. ', 1) + "\n# a comment\n")
    code._read.cache_clear()
    assert code.digest("capture.manifest") == before


def test_a_changed_line_changes_the_steps_that_import_it_and_no_other(copy: Path) -> None:
    manifest, score = code.digest("capture.manifest"), code.digest("report.score")
    edit(copy / "capture" / "manifest.py", "\nEXTRA = 1\n")
    assert code.digest("capture.manifest") != manifest
    assert code.digest("report.score") == score


def test_an_edit_in_an_imported_foundation_is_seen(copy: Path) -> None:
    before = code.digest("capture.manifest")
    edit(copy / "scene" / "files.py", "\nEXTRA = 1\n")
    assert code.digest("capture.manifest") != before


def test_an_unknown_step_is_an_error() -> None:
    with pytest.raises(FileNotFoundError):
        code.digest("capture.nothing")
