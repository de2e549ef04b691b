# SPDX-License-Identifier: Apache-2.0
"""Combines all cameras' footage into one manifest."""

from __future__ import annotations

from pathlib import Path

from studiorecon.progress import say
from studiorecon.scene.capture import Manifest, read_footage, write_manifest
from studiorecon.scene.step_files import require
from studiorecon.signature import Written


def run(scene: str, footage: list[Path], manifest: Written) -> None:
    """Write ``manifest`` from ``footage`` (JSON of every camera)."""
    cameras = [read_footage(path) for path in footage]
    for path, one in zip(footage, cameras):
        others = f"it has {one.frames} frames at {one.fps:g} per second, {footage[0]} others"
        require(path, (one.frames, one.fps) == (cameras[0].frames, cameras[0].fps), others)
    write_manifest(manifest, Manifest(scene, cameras[0].fps, cameras[0].frames, tuple(cameras)))
    held_out = [c.camera for c in cameras if c.held_out]
    say(
        f"{len(cameras)} cameras, {cameras[0].frames} frames at {cameras[0].fps:g} per "
        f"second; held out: {', '.join(held_out) or 'none'}"
    )
