# SPDX-License-Identifier: Apache-2.0
"""Where numba keeps the machine code of our kernels: by what is compiled, not by where the checkout lies.

numba itself keeps it beside the sources, so a second clone compiles everything again, and it looks at one file alone,
so a kernel that was compiled into another one may stay as it was. Here the name of a folder is the digest of a module
and of all it imports. numba finds ``ByContent`` by a variable that ``__main__`` sets, and that older ones ignore.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

from studiorecon import code

# Of a module's machine code so many versions are kept: that of this checkout, and of others beside it.
_VERSIONS = 4


def folder() -> Path:
    """Where it lies: ``kernels`` in the user's cache, or what NUMBA_CACHE_DIR says."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "studiorecon" / "kernels"


class ByContent:
    """Place and freshness of one compiled function, as numba asks for them."""

    def __init__(self, function: Callable, module: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._digest = _digest(module)
        self._place = folder() / module / self._digest

    @classmethod
    def from_function(cls, function: Callable, file: str) -> ByContent | None:
        """None for a function that is not of this package, or where nothing can be written."""
        try:
            module = ".".join(Path(file).relative_to(code.PACKAGE).with_suffix("").parts)
            found = cls(function, module)
            found.ensure_cache_path()
        except (ValueError, OSError, RuntimeError):  # another package's; no room or no right; nobody's home
            return None
        return found

    def ensure_cache_path(self) -> None:
        """Make the folder; of older versions of the module only the latest are kept."""
        if not self._place.is_dir():
            self._place.mkdir(parents=True, exist_ok=True)
            versions = sorted(self._place.parent.iterdir(), key=lambda path: path.stat().st_mtime)
            for old in versions[:-_VERSIONS]:
                shutil.rmtree(old, ignore_errors=True)
        if not os.access(self._place, os.W_OK):
            raise PermissionError(f"{self._place} cannot be written")

    def get_cache_path(self) -> str:
        """The folder of the function's machine code."""
        return str(self._place)

    def get_source_stamp(self) -> str:
        """What must be the same for machine code to be taken."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Tells functions of one name apart."""
        return str(self._line)


@cache
def _digest(module: str) -> str:
    """Of the sources of a module and of all that it imports of ours: machine code has what it calls in it."""
    total, files = hashlib.sha256(), code.reached([module])
    code.remember()
    for name, path in sorted(files.items()):
        total.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]
