# SPDX-License-Identifier: Apache-2.0
"""COLMAP models of users, text or binary, with distortion: ``cameras``, ``images``, and ``rigs``, ``frames``."""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, merged_static
from studiorecon.camera_files.colmap_models import posed_pictures


def recognises(files: list[Path]) -> bool:
    return (
        len(files) >= 2
        and {f.stem.lower() for f in files} >= {"cameras", "images"}
        and {f.suffix.lower() for f in files} <= {".txt", ".bin"}
    )


def read(files: list[Path]) -> Reading:
    """One static camera per picture folder (or picture); COLMAP's scale is arbitrary unless the model was aligned."""
    notes: list[str] = []
    return Reading("COLMAP", merged_static(posed_pictures(files), notes), "unknown", tuple(notes), has_floor=False)


FORMAT = CalibrationFormat(
    "colmap",
    "COLMAP",
    "`sparse/0` (text or binary, rigs too)",
    (
        ("sparse/0/cameras.txt", "sparse/0/images.txt"),
        ("sparse/0/cameras.bin", "sparse/0/images.bin"),
        ("sparse/cameras.txt", "sparse/images.txt"),
        ("cameras.txt", "images.txt"),
    ),
    recognises,
    read,
)
