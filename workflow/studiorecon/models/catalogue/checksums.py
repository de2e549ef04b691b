# SPDX-License-Identifier: Apache-2.0
"""SHA-256 of staged weights: the published one, or else the one pinned at first sight and compared later."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import WeightFile

PINS = "checksums.json"


def digest(file: Path, algorithm: str = "sha256") -> str:
    """Hexadecimal checksum of a file, read in blocks."""
    import hashlib

    total = hashlib.new(algorithm)
    with open(file, "rb") as stream:
        while block := stream.read(1 << 22):
            total.update(block)
    return total.hexdigest()


def git_blob_hash(file: Path) -> str:
    """The hash that git, and so a hub, assigns to a small file's content."""
    import hashlib

    content = file.read_bytes()
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


def read_pins(folder: Path) -> dict[str, Any]:
    """path → {sha256, bytes, modified_ns} of verified files; empty when none was verified."""
    path = folder / PINS
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
    except ValueError:
        raise UserError(
            f"{path} is not readable; delete it and run snakemake weights, which verifies every file again"
        ) from None


def write_pins(folder: Path, pins: dict[str, Any]) -> None:
    """Write the pins, complete or not at all."""
    partial = folder / f".{PINS}.{os.getpid()}.partial"
    partial.write_text(json.dumps(pins, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(folder / PINS)


def repository_code(folder: Path, files: Iterable[WeightFile]) -> list[WeightFile]:
    """Code that was downloaded with a whole repository (``snapshot``), and that its client runs to load the network."""
    found = []
    for file in (file for file in files if file.how == "snapshot"):
        root = (folder / file.path).parents[len(Path(file.remote).parts) - 1]
        for path in sorted(root.rglob("*.py")):
            name = path.relative_to(folder).as_posix()
            found.append(WeightFile(name, file.source, file.repository, remote=path.relative_to(root).as_posix()))
    return found


def other_file(path: Path, found: str) -> UserError:
    """The refusal of weights that are not their publisher's."""
    return UserError(f"{path} {found}: it is damaged or another version; delete it and get it again")


def verify(folder: Path, file: WeightFile, pins: dict[str, Any]) -> dict[str, Any]:
    """The pin of a file, hashed if it is new or modified; raises UserError when the hash differs."""
    path = folder / file.path
    about = path.stat()
    pin = pins.get(file.path)
    if pin and (pin["bytes"], pin["modified_ns"]) == (about.st_size, about.st_mtime_ns):
        return pin
    found = digest(path)
    expected = file.sha256 or (pin["sha256"] if pin else "")
    if expected and not found.startswith(expected):
        raise other_file(path, f"has SHA-256 {found[:12]}…, expected {expected[:12]}…")
    if file.md5 and digest(path, "md5") != file.md5:
        raise other_file(path, f"has another MD5 than its publisher states ({file.md5})")
    return {"sha256": found, "bytes": about.st_size, "modified_ns": about.st_mtime_ns}
