# SPDX-License-Identifier: Apache-2.0
"""``studiorecon run TAKE TAKE …``: many takes of one rig, one run of the workflow each, on the cameras of the first.

The rig's cameras are written as a calibration, and each further take gets a ``capture.yaml`` that names it: both could
have been written by hand.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from studiorecon.calibration.formats.pose2sim import camera_tables
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.camera_files.colmap import read_model
from studiorecon.deliver.camera_files import pose2sim_tables
from studiorecon.errors import UserError
from studiorecon.footage.source import open_source
from studiorecon.pages.run_summary import list_results, read_warnings
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.capture_yaml import read_description
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.files import write_table, write_text
from studiorecon.scene.names import compose_unicode
from studiorecon.scene.people import read_people
from studiorecon.scene.reports import read_refinement

RESULTS, LOGS = Path("results"), Path("logs")
TABLE = RESULTS / "takes.tsv"
COLUMNS = ("take", "result", "people", "frames", "minutes", "warnings", "film", "notes")
_FAILURE = re.compile(r"^[a-z]+\.[a-z_]+: ")

Runner = Callable[[Path, Sequence[str]], tuple[int, bool]]
"""Runs the workflow on a capture with further settings (``KEY=VALUE``): its exit status, and whether the user stopped
it."""


@dataclass(frozen=True)
class Take:
    """A capture of the batch; ``dataset`` is None where it cannot be opened, and ``refusal`` says why."""

    folder: Path
    dataset: Dataset | None
    refusal: str = ""

    @property
    def scene(self) -> str:
        return compose_unicode(self.folder.resolve().name)

    @property
    def calibration(self) -> tuple[bytes, ...]:
        """The contents of the take's own calibration files."""
        files = self.dataset.calibration if self.dataset else ()
        return tuple(file.read_bytes() for file in sorted(files) if file.is_file())

    @property
    def evidence(self) -> tuple[bool, bool, int, int]:
        """Orders takes by what they tell of the cameras: an earlier rig, a calibration, then cameras and frames."""
        films = self.dataset.footage.values() if self.dataset else ()
        try:
            frames = sum(open_source(film, 0.0).frames for film in films)
        except UserError:
            frames = 0
        return (RESULTS / self.scene / "rig.toml").is_file(), bool(self.calibration), len(films), frames


def open_takes(folders: Sequence[Path]) -> tuple[list[Take], list[str]]:
    """The takes in their order, each once, and a sentence for every file among them, which is none.

    Raises UserError for a folder that does not exist, and for two takes of one name.
    """
    if missing := [str(folder) for folder in folders if not folder.exists()]:
        raise UserError(f"there is no folder {', '.join(missing)}; give the folders of the takes")
    takes: dict[Path, Take] = {}
    for folder in folders:
        if not folder.is_dir():
            continue
        try:
            take = Take(folder, open_dataset(folder))
        except UserError as refusal:
            take = Take(folder, None, str(refusal))
        takes.setdefault(folder.resolve(), take)
    names = [take.scene for take in takes.values()]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UserError(
            f"two takes are called {twice[0]}, and their results would share a folder; rename one, or run it alone "
            "with -- --config scene=NAME"
        )
    return list(takes.values()), [f"{f} is a file and no take: it is left out" for f in folders if f.is_file()]


def run_takes(takes: Sequence[Take], rig_of: Take | None, run: Runner) -> list[dict[str, str]]:
    """Run every take, with the cameras of the first one that has them: of ``rig_of``, else by evidence.

    Returns a row of the table for each, in the order they ran. Nothing more is run once the user stops one.
    """
    by_evidence = sorted(takes, key=lambda take: take.evidence, reverse=True)
    reference = rig_of or by_evidence[0]
    waiting = [reference, *(take for take in takes if take.scene != reference.scene)]
    rows: dict[str, dict[str, str]] = {take.scene: {"take": take.scene, "result": "not run"} for take in waiting}
    rig: Path | None = None
    again: list[Take] = []
    for number, take in enumerate(waiting, 1):
        print(f"take {take.scene} ({number} of {len(waiting)})", flush=True)
        begun = time.time()
        rows[take.scene] = {"take": take.scene, "result": "running"}
        write_rows(list(rows.values()))
        try:
            rows[take.scene] = row = _run_take(take, reference, rig, begun, run)
            if rig is None and row["result"] != "stopped" and (rig := write_rig(take.scene)):
                reference = take
                # Those whose own people did not determine the cameras, again at the end.
                waiting += again
        except UserError as refusal:
            rows[take.scene] = row = {"take": take.scene, "result": "failed", "notes": str(refusal)}
        if row["result"] == "stopped":
            break
        if rig is None and rig_of is not None:
            row["notes"] += "; the other takes need its cameras"
            break
        if rig is None and take.dataset is not None and not take.calibration:
            again.append(take)
    write_rows(list(rows.values()))
    return list(rows.values())


def _run_take(take: Take, reference: Take, rig: Path | None, begun: float, run: Runner) -> dict[str, str]:
    if take.dataset is None:
        raise UserError(take.refusal)
    note, more = "", list[str]()
    if rig is not None and take.calibration in ((), reference.calibration):
        more, note = rig_settings(take, rig)
    elif rig is not None:
        note = f"uses its own calibration, which is not that of {reference.scene}"
    status, stopped = run(take.folder, more)
    return row_of(take, "stopped" if stopped else "failed" if status else "done", begun, note)


def write_rig(scene: str) -> Path | None:
    """A calibration file of the scene's cameras as refined, in pixels of the original one; None without cameras."""
    folder = RESULTS / scene
    model, capture = folder / "cameras/images.txt", folder / "capture/manifest.json"
    if not (model.is_file() and capture.is_file()):
        return None
    lenses = read_calibration(folder / "calibration/calibration.json").lenses
    held_out, filmed = folder / "cameras/heldout/images.txt", read_manifest(capture)
    found = []
    for camera in [*read_model(model.parent), *(read_model(held_out.parent) if held_out.is_file() else [])]:
        lens, longer = lenses[camera.name], np.eye(3)
        before_px = np.diag(np.array(filmed.of(camera.name).intrinsics))[:2]
        longer[[0, 1], [0, 1]] = np.array(camera.focal_px) / before_px
        found.append(replace(lens, intrinsics=lens.intrinsics @ longer, camera_from_world=camera.camera_from_world))
    return _kept(folder / "rig.toml", pose2sim_tables(found))


def rig_settings(take: Take, rig: Path) -> tuple[list[str], str]:
    """Settings with which a take reads its cameras from ``rig``, and a note about films that it has no camera for."""
    assert take.dataset is not None
    description = read_description(take.folder, None)
    # Symbolic links are followed: the path is read from the take's real folder.
    description["calibration"] = os.path.relpath(rig.resolve(), take.folder.resolve())
    known = [str(table["name"]) for table in camera_tables(rig).values()]
    unknown = [camera for camera in take.dataset.footage if camera not in known]
    note = f"without {', '.join(unknown)}, whose place the rig does not have" if unknown else ""
    if unknown and len(set(take.dataset.training) - set(unknown)) > 1:
        description["train"] = [camera for camera in take.dataset.training if camera in known]
        description["held_out"] = [camera for camera in take.dataset.held_out if camera in known]
    own = _kept(RESULTS / take.scene / "rig.yaml", yaml.safe_dump(description, allow_unicode=True))
    # The file is ours: what the settings say about the user's own format does not apply to it.
    added = ", ".join(f"{json.dumps(camera)}: 0.0" for camera in take.dataset.footage if camera in known)
    reading = "source: auto, format: pose2sim, poses: as_read, lens: as_read, unit: m, up: z, scale: 1.0"
    return [f"capture_yaml={own}", f"calibration={{{reading}, radial: {{{added}}}}}"], note


def rig_again(folder: Path) -> tuple[list[str], str]:
    """Settings with which a take of an earlier batch reads the rig's cameras again, and a note; [] and "" otherwise."""
    own = RESULTS / folder.resolve().name / "rig.yaml"
    if not own.is_file():
        return [], ""
    rig = folder.resolve() / yaml.safe_load(own.read_text(encoding="utf-8"))["calibration"]
    if not rig.is_file():
        return [], f"the cameras of {rig.parent.name}, which it used, are gone; it finds its own"
    settings, _ = rig_settings(Take(folder, open_dataset(folder)), rig)
    return settings, f"its cameras are those of {rig.parent.name}; remove {own} to find its own"


def _kept(path: Path, text: str) -> Path:
    """The file with that text, untouched if it has it: Snakemake compares dates."""
    if not (path.is_file() and path.read_text(encoding="utf-8") == text):
        write_text(path, text)
    return path


def row_of(take: Take, result: str, begun: float, note: str) -> dict[str, str]:
    """The take's row of the table; ``begun`` is the time at which its run began, seconds since 1970."""
    folder, logs = RESULTS / take.scene, LOGS / take.scene
    row = {"take": take.scene, "result": result, "minutes": f"{(time.time() - begun) / 60:.1f}"}
    people, capture = folder / "people/people.tsv", folder / "capture/manifest.json"
    row["people"] = str(len(read_people(people))) if people.is_file() else ""
    row["frames"] = str(read_manifest(capture).frames) if capture.is_file() else ""
    row["warnings"] = str(len({sentence for _, sentence in read_warnings(logs)}))
    row["film"] = next((str(path) for what, path in list_results(folder, None) if what == "film"), "")
    notes = [note] if note else []
    refinement = folder / "cameras/refinement.json"
    if refinement.is_file() and read_refinement(refinement).get("moved_cameras"):
        notes.append("its cameras were moved: cameras/refinement.png shows them")
    if result == "failed":
        notes.append(_last_failure(logs, begun) or "refused before its first step, with the reason above")
    return row | {"notes": "; ".join(notes)}


def _last_failure(logs: Path, begun: float) -> str:
    """The latest reason for which a step failed since ``begun``; "" without one."""
    recent = sorted((path.stat().st_mtime, path) for path in logs.rglob("*.log") if path.stat().st_mtime >= begun)
    lines = [line for _, path in recent for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    return next((line for line in reversed(lines) if _FAILURE.match(line)), "")


def write_rows(rows: Sequence[dict[str, str]]) -> None:
    """Write ``results/takes.tsv``."""
    write_table(TABLE, COLUMNS, [[row.get(column, "") for column in COLUMNS] for row in rows])


def table_text(rows: Sequence[dict[str, str]]) -> str:
    """The rows as a table to print."""
    cells = [list(COLUMNS), *([row.get(column, "") for column in COLUMNS] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in cells]
    return "\n".join(line.rstrip() for line in lines)
