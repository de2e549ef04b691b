# SPDX-License-Identifier: Apache-2.0
"""nerfstudio and instant-ngp ``transforms.json``."""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, merged_static, one_file
from studiorecon.camera_files.transforms_json import read_transforms
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes


def recognises(files: list[Path]) -> bool:
    """Whether a JSON has pictures, under any name; one called ``transforms.json`` is meant to."""
    return one_file("*.json")(files) and (
        files[0].name.lower() == "transforms.json" or b'"frames"' in read_bytes(files[0], MAX_TEXT_BYTES)
    )


def read(files: list[Path]) -> Reading:
    """One camera per label, picture folder or picture name; ``applied_transform`` is undone."""
    found = read_transforms(files[0])
    for index, camera in enumerate(found.cameras):
        if not camera.name:
            raise UserError(f"picture {index} of {files[0]} has no file_path; it must name the picture")
    notes = list(found.notes)
    return Reading("nerfstudio transforms.json", merged_static(found.cameras, notes), "unknown", tuple(notes))


FORMAT = CalibrationFormat(
    "nerfstudio", "nerfstudio, instant-ngp", "`transforms.json`", (("transforms.json",),), recognises, read
)
