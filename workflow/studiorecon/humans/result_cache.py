# SPDX-License-Identifier: Apache-2.0
"""Reuses a trained person while no input of the training has changed.

Masks show all people, so they are computed again when another person's identity is corrected; but training sees only
the crops around one person. The same crops, body, fit, settings and code give the same bytes, so training need not run
again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.body.avatar.avatar_files import read_cache_key
from studiorecon.humans.crops import Crop
from studiorecon.scene.files import atomic_path
from studiorecon.splatting.train.checkpoint import fingerprint

UP_TO_DATE = "the existing result is kept"
"""How a log says that nothing was trained."""


def cache_key(settings: Any, crops: Sequence[Crop], inputs: Sequence[Path], code: str, *more: object) -> str:
    """Hex digest of everything a person's training depends on: inputs, settings, code and every crop's pixels."""
    digest = hashlib.sha256(fingerprint(settings, inputs, code, *more).encode())
    for crop in crops:
        camera = dataclasses.asdict(crop.camera)
        digest.update(repr((crop.frame, crop.view, crop.rgb.shape, camera.pop("name"), camera.pop("wh"))).encode())
        for part in (*camera.values(), crop.rgb, crop.verdict):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def is_up_to_date(mark: str, gaussians: Path, avatar: Path, working: Path) -> bool:
    """Whether the last result in ``working`` was trained from the inputs of ``mark``; if so, restore it with a new
    date."""
    kept = [_cached_path(path, working) for path in (gaussians, avatar)]
    if read_cache_key(*kept) != mark:
        return False
    for path, last in zip((gaussians, avatar), kept):
        _link_or_copy(last, path)
        path.touch()
    return True


def store_result(gaussians: Path, avatar: Path, working: Path) -> None:
    """Copy the trained files to ``working``, because a workflow deletes the outputs of steps it runs again."""
    for path in (gaussians, avatar):
        _link_or_copy(path, _cached_path(path, working))


def _cached_path(path: Path, working: Path) -> Path:
    return working / f"last{path.suffix}"


def _link_or_copy(source: Path, target: Path) -> None:
    """Link ``target`` to ``source``, or copy it where the file system has no such links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as partial:
        try:
            os.link(source, partial)
        except OSError:
            shutil.copyfile(source, partial)
