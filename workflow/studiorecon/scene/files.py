# SPDX-License-Identifier: Apache-2.0
"""Files that are either complete or absent: written under a temporary name, renamed when done."""

from __future__ import annotations

import csv
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_json as read_json
from studiorecon.scene.user_files import read_rows


def require_one_each(cameras: Sequence[object], **files: Sequence[object]) -> None:
    """Raises UserError unless every kind has one file per camera; the kinds are named in words."""
    if any(len(several) != len(cameras) for several in files.values()):
        counted = ", ".join(f"{len(several)} {kind.replace('_', ' ')}" for kind, several in files.items())
        counted = " and ".join(counted.rsplit(", ", 1))
        raise UserError(f"{counted} for {len(cameras)} training cameras; one of each is needed per camera")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder with the same suffix; renamed to ``path`` when the block ends without error.

    Operating-system errors in the block name ``path``: errors of writes to an open file otherwise name no file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        partial.unlink(missing_ok=True)


def remove_remains(path: Path) -> None:
    """Delete what killed processes left of writing ``path``; nothing else may be writing it now."""
    for partial in path.parent.glob(".partial-*"):
        if re.fullmatch(rf"\.partial-\d+-{re.escape(path.name)}", partial.name):
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text, completely or not at all."""
    with atomic_path(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write JSON with sorted keys; arrays become lists, NaN and infinities become null (strict JSON has neither)."""
    write_text(path, json.dumps(_plain(value), indent=1, sort_keys=True, allow_nan=False) + "\n")


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write a compressed npz, completely or not at all."""
    with atomic_path(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, **arrays)


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write a tab-separated table with a header line."""
    with atomic_path(path) as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter="\t", lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def read_table(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a tab-separated table as dictionaries; raises UserError as ``user_files.read_rows`` does."""
    return [row for _, row in read_rows(path, columns)]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
