# SPDX-License-Identifier: Apache-2.0
"""What tests of render layers and their neighbours share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR


def channels_of(path: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}
