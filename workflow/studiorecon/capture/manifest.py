# SPDX-License-Identifier: Apache-2.0
"""Combines all cameras' footage into one manifest."""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.capture import Manifest, read_footage, write_manifest
from studiorecon.signature import Written


def run(scene: str, footage: list[Path], manifest: Written) -> None:
    """Write ``manifest`` from ``footage`` (JSON of every camera)."""
    cameras = [read_footage(path) for path in footage]
    if not cameras:
        raise UserError(f"scene {scene} has no cameras; put one video per camera into videos/")
    if odd := [c for c in cameras if (c.frames, c.fps) != (cameras[0].frames, cameras[0].fps)]:
        raise UserError(
            f"{odd[0].source} has {odd[0].frames} frames at {odd[0].fps:g} per second and "
            f"{cameras[0].source} {cameras[0].frames} at "
            f"{cameras[0].fps:g}: they were decoded by different clocks; run capture.frames again"
        )
    write_manifest(manifest, Manifest(scene, cameras[0].fps, cameras[0].frames, tuple(cameras)))
    held_out = [c.camera for c in cameras if c.held_out]
    say(
        f"{len(cameras)} cameras, {cameras[0].frames} frames at {cameras[0].fps:g} per "
        f"second; held out: {', '.join(held_out) or 'none'}"
    )
