# SPDX-License-Identifier: Apache-2.0
"""Stores arrays that do not fit into memory in an unnamed file, and reads them back one by one.

The file disappears when the process ends in any way. It is not mapped: mapped pages count as the process's memory.
"""

from __future__ import annotations

import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Shaped


@dataclass(frozen=True)
class Slot:
    """Position, shape and type of an array in the file."""

    offset: int
    shape: tuple[int, ...]
    kind: np.dtype


class Spool:
    """The file, in ``folder``, which is created if needed."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 (open as long as the spool exists)
        weakref.finalize(self, self._file.close)
        self._end = 0

    def put(self, array: Shaped[np.ndarray, " ..."]) -> Slot:
        """Append an array."""
        slot = Slot(self._end, array.shape, array.dtype)
        self._write(slot, array)
        self._end += array.nbytes
        return slot

    def put_back(self, slot: Slot, array: Shaped[np.ndarray, " ..."]) -> None:
        """Overwrite an array with another one; raises ValueError for another shape or type."""
        if (array.shape, array.dtype) != (slot.shape, slot.kind):
            raise ValueError(f"array is {array.shape} of {array.dtype}, its place is {slot.shape} of {slot.kind}")
        self._write(slot, array)

    def get(self, slot: Slot) -> Shaped[np.ndarray, " ..."]:
        """A copy of the array in memory."""
        array = np.empty(slot.shape, slot.kind)
        rest = array.data.cast("B") if array.size else memoryview(b"")
        self._file.seek(slot.offset)
        while rest:
            count = self._file.readinto(rest)
            if not count:
                raise EOFError(f"{len(rest)} bytes are missing at the end")
            rest = rest[count:]
        return array

    def _write(self, slot: Slot, array: np.ndarray) -> None:
        rest = np.ascontiguousarray(array).data.cast("B") if array.size else memoryview(b"")
        self._file.seek(slot.offset)
        while rest:
            rest = rest[self._file.write(rest) :]
