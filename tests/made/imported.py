# SPDX-License-Identifier: Apache-2.0
"""A calibration's files as ``calibration.json`` where nothing but names decides: without films and people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from studiorecon.calibration.files import Settings, paired_lenses, read_calibration
from studiorecon.scene.files import write_json


def imported(settings: Settings, files: Sequence[Path], cameras: Sequence[str], pixel_maps: str, path: Path) -> None:
    """Write ``path`` as ``calibration.choose`` does."""
    reading = read_calibration(files, settings.format)
    lenses, notes, floor_known = paired_lenses(
        reading, files[0].name, cameras, json.loads(pixel_maps or "{}"), settings
    )
    about = {"source": files[0].name, "format": reading.format, "floor_known": floor_known, "notes": notes}
    write_json(path, {**about, "lenses": [lens.as_json() for lens in lenses], "doubts": []})
