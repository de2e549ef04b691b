# SPDX-License-Identifier: Apache-2.0
"""Notices files that changed after the step that wrote them: a disk's fault, a copy over the wrong name, an edit.

A step's reader refuses values that cannot be. Another camera's film, a mirrored mask or a length in another unit can
be: only their digest says that no step wrote them. A file whose size and time are as recorded is not read again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from studiorecon.progress import warn

RECORDS = Path(".snakemake/written")
"""Folder of the records, one per file, among the run's own working files; without ``.snakemake`` nothing is kept."""


def record_files(step: str, paths: Iterable[Path]) -> None:
    """Record size, time and digest of the files that ``step`` wrote; warns where no record can be kept."""
    if not RECORDS.parent.is_dir():
        return
    try:
        for path in _files(paths):
            _record(path).unlink(missing_ok=True)
            _keep(path, {"step": step, "sha256": _sha256(path), **_state(path)})
    except OSError as error:  # the results are whole: a full disk must not cost them
        warn(f"{RECORDS} cannot be written ({error}): later changes of this step's files will not be noticed")


def changed_files(paths: Iterable[Path]) -> Iterator[str]:
    """A sentence for every one of ``paths`` whose content is not what its step wrote."""
    for path in _files(paths):
        try:
            found = json.loads(_record(path).read_text(encoding="utf-8"))
            state, step, digest = {key: found[key] for key in ("bytes", "mtime_ns")}, found["step"], found["sha256"]
        except (OSError, ValueError, LookupError, TypeError):
            continue  # no step wrote it, or the record itself is damaged
        if state == _state(path):
            continue
        if _sha256(path) == digest:
            _keep(path, found | _state(path))
        else:
            yield (
                f"{path} changed after {step} wrote it, and this step goes on with it as it is; if you did not mean "
                "that, delete it, and the next run makes it again"
            )


def _files(paths: Iterable[Path]) -> Iterator[Path]:
    """The regular files among ``paths`` that are named from the working folder on."""
    return (path for path in paths if not path.is_absolute() and ".." not in path.parts and path.is_file())


def _record(path: Path) -> Path:
    return RECORDS / path.with_name(f"{path.name}.json")


def _state(path: Path) -> dict[str, int]:
    found = path.stat()
    return {"bytes": found.st_size, "mtime_ns": found.st_mtime_ns}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _keep(path: Path, found: dict[str, object]) -> None:
    place = _record(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    partial = place.with_name(f".partial-{os.getpid()}-{place.name}")
    partial.write_text(json.dumps(found), encoding="utf-8")
    os.replace(partial, place)
