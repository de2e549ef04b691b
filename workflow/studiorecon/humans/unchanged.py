# SPDX-License-Identifier: Apache-2.0
"""A trained person stays as trained while nothing of what the training saw has changed.

Masks show everybody, so they are made again when somebody else's identity is corrected; but training sees only the crops around one
person. The same crops, body, fit, settings and code give the same bytes, so what was trained from them need not be trained again.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.body.avatar import written_from
from studiorecon.humans.footage import Crop
from studiorecon.splatting.checkpoint import fingerprint


def mark_of(settings: Any, crops: Sequence[Crop], inputs: Sequence[Path], code: str, *more: object) -> str:
    """Hex digest of all that a person's training depends on: as ``splatting.checkpoint.fingerprint``, and every crop to the pixel."""
    digest = hashlib.sha256(fingerprint(settings, inputs, code, *more).encode())
    for crop in crops:
        camera = dataclasses.asdict(crop.camera)
        digest.update(repr((crop.frame, crop.view, crop.rgb.shape, camera.pop("name"), camera.pop("wh"))).encode())
        for part in (*camera.values(), crop.rgb, crop.verdict):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def still_stands(mark: str, gaussians: Path, avatar: Path) -> bool:
    """Whether both files are there, belong together and were trained from what ``mark`` names; then their time becomes now."""
    if written_from(gaussians, avatar) != mark:
        return False
    for path in (gaussians, avatar):
        path.touch()
    return True
