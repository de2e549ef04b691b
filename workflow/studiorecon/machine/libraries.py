# SPDX-License-Identifier: Apache-2.0
"""Names a library that does not load, and the way to install it."""

from __future__ import annotations

import platform
import traceback
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
"""The package itself."""
EXTRAS = {
    "torch": "networks",
    "torchvision": "networks",
    "huggingface_hub": "networks",
    "lpips": "networks",
    "gsplat": "gpu",
    "kornia": "gpu",
    "open3d": "mesh",
    "pxr": "usd",
}
"""Library, by its import name → the extra that installs it; every other library of the package is in the plain
environment.
"""


WITHOUT_WHEELS = ("pycolmap", "embreex", "ezc3d")
"""Libraries without a wheel for every processor (pyproject.toml says which)."""


def missing_library(error: BaseException) -> str | None:
    """The import name of the library whose loading ended in ``error``; None for another error, and our own modules.

    Python names a missing module; for a shared object that the system's loader did not find, only the stack shows it.
    """
    if isinstance(error, ImportError) and error.name:
        library = error.name.partition(".")[0]
        return library if library != PACKAGE.name else None
    stack = traceback.extract_tb(error.__traceback__)
    frames = [frame.filename for frame in stack]
    # The importer's own frames are mostly missing in the stack.
    importing = any(
        f.filename.startswith("<frozen importlib") or (f.name == "<module>" and "site-packages" in f.filename)
        for f in stack
    )
    if not isinstance(error, ImportError) and not (isinstance(error, OSError) and error.errno is None and importing):
        return None
    ours = max((k for k, name in enumerate(frames) if Path(name).is_relative_to(PACKAGE)), default=-1)
    for name in frames[ours + 1 :]:
        _, installed, inside = name.replace("\\", "/").rpartition("site-packages/")
        if installed:
            return inside.partition("/")[0].removesuffix(".py")
    return None


def install_remedy(library: str) -> str:
    """The way to install a library: by its extra, from its source, or with the environment itself."""
    extra = EXTRAS.get(library.partition(".")[0])
    if extra:
        return f"install the extra {extra}: uv sync --inexact --extra {extra}, or pip install 'studiorecon[{extra}]'"
    if library in WITHOUT_WHEELS and platform.machine() != "x86_64":
        return f"it has no wheel for this processor ({platform.machine()}): build it from its source, or use another"
    return "it belongs to the plain environment: uv sync --inexact"
