# SPDX-License-Identifier: Apache-2.0
"""The cameras' lenses in the imported calibration, ``calibration/calibration.json``."""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.scene.camera import Lens
from studiorecon.scene.intermediate import as_written, read_content


def read_lenses(calibration: Path) -> dict[str, Lens]:
    """All lenses by the name of their camera, in the file's order."""
    value = read_content(calibration)
    with as_written(calibration):
        return {lens.name: lens for lens in map(Lens.from_json, value["lenses"])}


def lens_of(calibration: Path, camera: str) -> Lens:
    """The lens of one camera; raises UserError when it is not there."""
    lenses = read_lenses(calibration)
    if camera not in lenses:
        raise UserError(
            f"{calibration} has no camera {camera}; it has {', '.join(lenses)}: run calibration.files again"
        )
    return lenses[camera]
