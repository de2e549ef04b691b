# SPDX-License-Identifier: Apache-2.0
"""nerfstudio and instant-ngp ``transforms.json``."""

from __future__ import annotations

from pathlib import Path

from studiorecon.cameras.formats.raw import Reading, merged_static
from studiorecon.scene.transforms_json import read_transforms


def recognises(files: list[Path]) -> bool:
    return len(files) == 1 and files[0].suffix == ".json"


def read(files: list[Path]) -> Reading:
    """One camera per label, picture folder or picture name; ``applied_transform`` is undone."""
    found = read_transforms(files[0])
    return Reading("nerfstudio transforms.json", tuple(merged_static(list(found.cameras), 0.01, 1.0)), "unknown", found.notes)
