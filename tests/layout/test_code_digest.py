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


def forget() -> None:
    """What a process of its own would not know."""
    code._digests.cache_clear()
    code._read_cached.cache_clear()


def memory(copy: Path) -> Path:
    (file,) = (copy / "__pycache__").glob("digests.*.json")
    return file


def test_comments_and_docstrings_change_nothing(copy: Path) -> None:
    before = code.digest("capture.manifest")
    source = (copy / "capture" / "manifest.py").read_text()
    (copy / "capture" / "manifest.py").write_text(source.replace('"""', '"""More words. ', 1) + "\n# a comment\n")
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


def test_sources_are_parsed_once_and_remembered_by_what_they_hold(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = code.digest("capture.manifest")
    edit(copy / "capture" / "manifest.py", "\nEXTRA = 1\n")
    edited = code.digest("capture.manifest")
    source = (copy / "capture" / "manifest.py").read_text()
    (copy / "capture" / "manifest.py").write_text(source.removesuffix("\nEXTRA = 1\n"))
    forget()
    monkeypatch.setattr(code.ast, "parse", lambda source: pytest.fail("parsed again"))
    assert code.digest("capture.manifest") == before != edited


@pytest.mark.parametrize("damage", [b"", b"{", b"[1, 2]", b"\xff"], ids=["empty", "cut", "a list", "no text"])
def test_a_damaged_memory_is_made_anew(copy: Path, damage: bytes) -> None:
    before = code.digest("capture.manifest")
    memory(copy).write_bytes(damage)
    forget()
    assert code.digest("capture.manifest") == before
    assert memory(copy).read_bytes() != damage


def test_where_nothing_can_be_remembered_sources_are_parsed(copy: Path) -> None:
    before = code.digest("capture.manifest")
    shutil.rmtree(copy / "__pycache__")
    (copy / "__pycache__").touch()
    forget()
    assert code.digest("capture.manifest") == before


def test_modules_that_come_and_go_while_a_process_runs_are_seen(copy: Path) -> None:
    assert code.module_path("capture.later") is None
    (copy / "capture" / "later.py").write_text("from studiorecon import errors\n")
    assert code.module_path("capture.later") == copy / "capture" / "later.py"
    assert "errors" in code.dependencies(["capture.later"])
    (copy / "capture" / "later.py").unlink()
    with pytest.raises(FileNotFoundError):
        code.digest("capture.later")
