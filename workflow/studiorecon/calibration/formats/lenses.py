# SPDX-License-Identifier: Apache-2.0
"""Reads files with lenses but no poses, and explains why files that look like calibrations were not used."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studiorecon.calibration.formats import FORMATS, easymocap, opencv_storage, pose2sim
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import file_size, read_bytes

_SUFFIXES = {
    ".xml", ".yml", ".yaml", ".json", ".toml", ".calib", ".txt", ".npz", ".npy", ".pkl", ".pickle", ".mat", ".csv",
}  # fmt: skip
_WORDS = ("intrinsic", "extrinsic", "camera_matrix", "cameramatrix", "distortion", "dist_coef", "focal", "calib")
_MAX_BYTES = 2**20


def find_lenses(folder: Path) -> tuple[Path, ...]:
    """Files of ``folder`` with lenses and no poses, from the first place that has any."""
    for names in (*opencv_storage.FORMAT.files, *easymocap.FORMAT.files, *pose2sim.FORMAT.files):
        found = tuple(path for path in sorted(folder.glob(names[0])) if path.is_file() and _holds_lenses(path))
        if found:
            return found
    return ()


def read_lenses(files: Sequence[Path]) -> list[RawCamera]:
    """The lenses of all files, with the identity for a pose; raises UserError for a file that is none."""
    found: list[RawCamera] = []
    for path in files:
        if path.suffix == ".toml":
            found += [
                pose2sim.camera_of_table(str(table.get("name", key)), {**_NO_POSE, **table}, path)
                for key, table in pose2sim.camera_tables(path).items()
            ]
        elif opencv_storage.file_kind(path) == "lenses":
            tables = opencv_storage.camera_tables(path)
            found += [opencv_storage.read_camera(n, table, f"camera {n} in {path}") for n, table in tables.items()]
        else:
            found += easymocap.lenses_in(path)
    return found


_NO_POSE = {"rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}


def unused_reason(path: Path, used: Sequence[Path]) -> str | None:
    """A sentence why a file that looks like a calibration is not among the files ``used``; None for other files."""
    if path in used or not path.is_file() or path.suffix.lower() not in _SUFFIXES or path.stem == "capture":
        return None
    instead = f"{used[0].name} was used" if used else "name it in capture.yaml: calibration: FILE"
    for form in FORMATS.values():
        for names in form.files:
            patterns = [name.rpartition("/")[2] for name in names]
            if any(path.match(pattern) for pattern in patterns) and _recognised(form.holds_cameras, path):
                alone = len(names) > 1 and not all((path.parent / p).is_file() for p in patterns)
                kind = f"{'a part of ' if alone else ''}a calibration of {form.made_by}"
                return f"{kind}, which {' and '.join(patterns)} make together" if alone else f"{kind}; {instead}"
    if _recognised(_holds_lenses, path):
        return f"it holds lenses without poses; {instead}" if used else None
    if _speaks_of_cameras(path):
        return "it may be a calibration in an unknown format; docs/capture.md lists the known ones"
    return None


def _recognised(recognises: object, path: Path) -> bool:
    try:
        return bool(recognises(path))  # type: ignore[operator]
    except UserError:
        return False


def _holds_lenses(path: Path) -> bool:
    if path.suffix == ".toml":
        return any(
            "rotation" not in table and "translation" not in table for table in pose2sim.camera_tables(path).values()
        )
    return opencv_storage.file_kind(path) == "lenses" or (path.suffix in (".yml", ".yaml") and easymocap.is_intri(path))


def _speaks_of_cameras(path: Path) -> bool:
    if file_size(path) > _MAX_BYTES:
        return False
    text = read_bytes(path).decode("utf-8", errors="replace").lower()
    return sum(word in text for word in _WORDS) >= 2
