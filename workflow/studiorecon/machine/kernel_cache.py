# SPDX-License-Identifier: Apache-2.0
"""Numba's cache of our kernels' machine code, keyed by the code and not by the checkout's path.

numba's own cache is next to the sources, so a second clone compiles everything again. It also compares a single file,
so a kernel that was compiled into another one may stay outdated. Here a folder's name is the digest of a module and of
all its imports. numba finds ``ByContent`` by a variable that ``__main__`` sets, and that older versions ignore.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

from studiorecon import code


def cache_folder() -> Path:
    """The cache folder: ``kernels`` in the user's cache, or the one in NUMBA_CACHE_DIR."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "studiorecon" / "kernels"


class ByContent:
    """Path and freshness of one compiled function, in the form of numba's cache locators."""

    def __init__(self, function: Callable, module: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._digest = _digest(module)
        self._place = cache_folder() / module / self._digest

    @classmethod
    def from_function(cls, function: Callable, file: str) -> ByContent | None:
        """A locator; None for a function outside this package, or where the cache cannot be written."""
        try:
            module = ".".join(Path(file).relative_to(code.PACKAGE).with_suffix("").parts)
            found = cls(function, module)
            found.ensure_cache_path()
        except (ValueError, OSError, RuntimeError):  # another package's; disk full or not writable; no home
            return None
        return found

    def ensure_cache_path(self) -> None:
        """Make the folder, and delete all but the latest versions of the module."""
        if not self._place.is_dir():
            self._place.mkdir(parents=True, exist_ok=True)
            versions = sorted(self._place.parent.iterdir(), key=lambda path: path.stat().st_mtime)
            # Versions of a module's machine code that are kept: that of this checkout, and of others on the machine.
            for old in versions[:-4]:
                shutil.rmtree(old, ignore_errors=True)
        if not os.access(self._place, os.W_OK):
            raise PermissionError(f"{self._place} cannot be written")

    def get_cache_path(self) -> str:
        """The folder of the function's machine code."""
        return str(self._place)

    def get_source_stamp(self) -> str:
        """The stamp that must match before machine code is used."""
        return self._digest

    def get_disambiguator(self) -> str:
        """A string that differs between functions of one name."""
        return str(self._line)


@cache
def _digest(module: str) -> str:
    """Digest of the sources of a module and of all its imports from this package, which its machine code includes."""
    total, files = hashlib.sha256(), code.dependencies([module])
    code.save_digests()
    for name, path in sorted(files.items()):
        total.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]
