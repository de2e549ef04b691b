# SPDX-License-Identifier: Apache-2.0
"""COLMAP models of users, text or binary, with distortion: ``cameras`` + ``images``, and ``rigs`` + ``frames`` where the model has them."""

from __future__ import annotations

from pathlib import Path

from studiorecon.cameras.formats.raw import Reading, merged_static
from studiorecon.scene.colmap_models import posed_pictures


def recognises(files: list[Path]) -> bool:
    return len(files) >= 2 and {f.stem for f in files} >= {"cameras", "images"} and {f.suffix for f in files} <= {".txt", ".bin"}


def read(files: list[Path]) -> Reading:
    """One static camera per picture folder (or picture); COLMAP's scale is arbitrary unless the model was aligned."""
    return Reading("COLMAP", tuple(merged_static(posed_pictures(files), 0.01, 1.0)), "unknown", ())
