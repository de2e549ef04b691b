# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: the whole state of a training loop in one file, so that the same run can resume after being killed.

A checkpoint is in the working folder that the rule names, not among its outputs: a workflow engine deletes those of a
failed job. It carries a fingerprint of settings, inputs and code. One that does not match, or cannot be read, is
ignored with a message, and training starts from the beginning.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from studiorecon.progress import say
from studiorecon.scene.files import atomic_path, remove_remains

if TYPE_CHECKING:
    from jaxtyping import Shaped

_FACTS = "facts"


def fingerprint(settings: Any, inputs: Sequence[Path], code: str, *more: object) -> str:
    """Hex digest of a settings dataclass, the input files' bytes and the code's digest."""
    digest = hashlib.sha256(json.dumps([dataclasses.asdict(settings), code, *map(str, more)], sort_keys=True).encode())
    digest.update(f"numba {numba.__version__} numpy {np.__version__}".encode())
    for path in inputs:
        with open(path, "rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


class Checkpoint:
    """One run's checkpoint file; it is written under another name and renamed, so ``path`` is never incomplete."""

    def __init__(self, path: Path, mark: str, every_s: float) -> None:
        self.path, self._mark, self._every_s = path, mark, every_s
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether ``every_s`` seconds have passed since the start or the last ``save``; never with 0."""
        return self._every_s > 0 and time.monotonic() - self._last >= self._every_s

    def save(self, arrays: Mapping[str, Shaped[np.ndarray, " ..."]], facts: Mapping[str, Any]) -> None:
        """Write arrays and JSON facts; uncompressed, because this happens during training."""
        stored: dict[str, Any] = {_FACTS: np.array(json.dumps({"mark": self._mark, **facts}))}
        named: dict[str, Any] = dict(arrays)
        with atomic_path(self.path) as partial, open(partial, "wb") as file:
            np.savez(file, **stored, **named)
        self._last = time.monotonic()

    def load(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]] | None:
        """The arrays and facts saved with this fingerprint; None, after a message, for another one or an unreadable
        file.
        """
        if not self.path.is_file():
            return None
        try:
            # Reading checks every member's CRC.
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as stored:
                facts = json.loads(str(stored[_FACTS]))
                if facts.pop("mark") != self._mark:
                    say(f"{self.path} belongs to other settings, inputs or code and is not used; training restarts")
                    return None
                return {name: stored[name] for name in stored.files if name != _FACTS}, facts
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
            say(f"{self.path} cannot be read ({error}) and is not used; training restarts")
            return None

    def remove(self) -> None:
        """Delete the file, the remains of an interrupted ``save``, and the folder when it is empty."""
        self.path.unlink(missing_ok=True)
        remove_remains(self.path)
        if self.path.parent.is_dir() and not any(self.path.parent.iterdir()):
            self.path.parent.rmdir()
