# SPDX-License-Identifier: Apache-2.0
"""Arrays that are too many for memory: put into a file without a name, and read back one by one.

The file is gone with the process, however that ends. It is read, not mapped: pages of a mapped file count as the
process's own memory.
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
    """Where an array lies in the file, and what it is."""

    offset: int
    shape: tuple[int, ...]
    kind: np.dtype


class Spool:
    """The file, in ``folder``, which is made if it is not there."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 (open as long as it is there)
        weakref.finalize(self, self._file.close)
        self._end = 0

    def put(self, array: Shaped[np.ndarray, " ..."]) -> Slot:
        """Append an array."""
        slot = Slot(self._end, array.shape, array.dtype)
        self._write(slot, array)
        self._end += array.nbytes
        return slot

    def put_back(self, slot: Slot, array: Shaped[np.ndarray, " ..."]) -> None:
        """Write an array over another one. Raises ValueError for one of another shape or kind."""
        if (array.shape, array.dtype) != (slot.shape, slot.kind):
            raise ValueError(f"array is {array.shape} of {array.dtype}, its place is {slot.shape} of {slot.kind}")
        self._write(slot, array)

    def get(self, slot: Slot) -> Shaped[np.ndarray, " ..."]:
        """The array, in memory of its own."""
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
