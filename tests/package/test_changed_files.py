# SPDX-License-Identifier: Apache-2.0
"""A file that changed after its step wrote it is named by the steps that read it; a copy of it is the same file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from studiorecon import __main__ as steps
from studiorecon.machine import changed_files
from studiorecon.people import fit
from studiorecon.signature import Written

from tests.made.nouns import NOUNS

CAMERAS = [Path(f"results/s/capture/cam{k}.json") for k in (1, 2)]
MANIFEST = Path("results/s/capture/manifest.json")


@pytest.fixture
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder as a run leaves it: two cameras' footage, of which ``capture.frames`` wrote each."""
    monkeypatch.chdir(tmp_path)
    Path(".snakemake").mkdir()
    for k, path in enumerate(CAMERAS):
        path.parent.mkdir(parents=True, exist_ok=True)
        NOUNS["footage"].write(path, k)
        os.utime(path, (10**9 + k, 10**9 + k))
    changed_files.record_files("capture.frames", CAMERAS)
    return tmp_path


def run_manifest() -> int:
    return steps.main(
        ["capture.manifest", "--scene", "s", "--footage", *map(str, CAMERAS), "--manifest", str(MANIFEST)]
    )


def exchanged() -> None:
    os.replace(CAMERAS[0], "x")
    os.replace(CAMERAS[1], CAMERAS[0])
    os.replace("x", CAMERAS[1])


CHANGES: dict[str, tuple[Callable[[], object], list[Path]]] = {
    "nothing": (lambda: None, []),
    "touched": (lambda: CAMERAS[0].touch(), []),
    "copied": (lambda: [shutil.copy(CAMERAS[0], "x"), shutil.copy("x", CAMERAS[0])], []),
    "edited": (lambda: CAMERAS[1].write_text(CAMERAS[1].read_text().replace("30.0", "25.0")), CAMERAS[1:]),
    "no records": (lambda: [exchanged(), shutil.rmtree(changed_files.RECORDS)], []),
    "a damaged record": (
        lambda: [exchanged(), *(p.write_text("{") for p in changed_files.RECORDS.rglob("cam1*"))],
        CAMERAS[1:],
    ),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_step_names_inputs_that_changed(case: str, run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, named = CHANGES[case]
    change()
    run_manifest()
    messages = capsys.readouterr().out
    assert [path for path in CAMERAS if f"warning: {path} changed after capture.frames" in messages] == named


def test_what_a_step_writes_is_recorded(run_folder: Path) -> None:
    assert run_manifest() == 0
    assert not list(changed_files.changed_files([MANIFEST]))
    MANIFEST.write_text(MANIFEST.read_text().replace("cam1", "cam9"))
    assert "capture.manifest wrote it" in next(changed_files.changed_files([MANIFEST]))
    MANIFEST.unlink()
    assert run_manifest() == 0
    assert not list(changed_files.changed_files([MANIFEST]))


def test_a_full_disk_costs_no_result(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(changed_files.RECORDS)
    changed_files.RECORDS.write_text("no folder")
    assert run_manifest() == 0
    assert MANIFEST.is_file()
    assert "will not be noticed" in capsys.readouterr().out


def test_inputs_and_outputs_are_those_of_the_signature() -> None:
    options = {
        name: [Path(name)] if "list" in str(hint) else Path(name) for name, hint, _ in steps.step_options(fit.run)
    }
    assert Path("detections") in steps.step_paths(fit.run, options, Path)
    assert steps.step_paths(fit.run, options, Written) == [Path("fit")]
