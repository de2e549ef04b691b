# SPDX-License-Identifier: Apache-2.0
"""A library that does not load says which it is, and what brings it."""

from __future__ import annotations

import traceback
from pathlib import Path

OWN = Path(__file__).parents[1]
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
"""Library, as it is imported, → the extra that brings it; every other library of the package is part of the plain
environment."""


def unloaded(error: BaseException) -> str | None:
    """The library whose loading ended in ``error``, as it is imported; None for another error, and for our own modules.

    Python says which module is missing; of a shared object that the system's loader did not find, only the stack tells
    whose it was.
    """
    if isinstance(error, ImportError) and error.name:
        library = error.name.partition(".")[0]
        return library if library != OWN.name else None
    stack = traceback.extract_tb(error.__traceback__)
    frames = [frame.filename for frame in stack]
    # The importer's own frames are mostly cut out of the stack.
    importing = any(
        f.filename.startswith("<frozen importlib") or (f.name == "<module>" and "site-packages" in f.filename)
        for f in stack
    )
    if not isinstance(error, ImportError) and not (isinstance(error, OSError) and error.errno is None and importing):
        return None
    ours = max((k for k, name in enumerate(frames) if Path(name).is_relative_to(OWN)), default=-1)
    for name in frames[ours + 1 :]:
        _, installed, inside = name.replace("\\", "/").rpartition("site-packages/")
        if installed:
            return inside.partition("/")[0].removesuffix(".py")
    return None


def remedy(library: str) -> str:
    """How to get a library: with its extra, or with the environment itself."""
    extra = EXTRAS.get(library.partition(".")[0])
    if extra:
        return f"the extra {extra} brings it: uv sync --inexact --extra {extra}, or pip install 'studiorecon[{extra}]'"
    return "it belongs to the plain environment: uv sync --inexact"
