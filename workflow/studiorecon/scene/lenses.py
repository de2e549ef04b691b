# SPDX-License-Identifier: Apache-2.0
"""Finding one camera's lens in the imported calibration."""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import Refusal
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import read_json


def lens_of(calibration: Path, camera: str) -> Lens:
    """The lens of one camera in ``cameras/calibration.json``; raises Refusal when it is not there."""
    lenses = [Lens.from_json(entry) for entry in read_json(calibration)["lenses"]]
    for lens in lenses:
        if lens.name == camera:
            return lens
    raise Refusal(f"{calibration} has no camera {camera}; it has {', '.join(lens.name for lens in lenses)}: run cameras.calibration again")
