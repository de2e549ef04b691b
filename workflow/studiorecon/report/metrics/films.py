# SPDX-License-Identifier: Apache-2.0
"""The index in a film at which each camera's own view begins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest
from studiorecon.scene.path import read_path


def first_frames(path: Path, cameras: Sequence[Camera], capture: Manifest) -> dict[str, int]:
    """camera → index of its first picture in a film.

    Raises UserError, naming the file of ``path``, unless the film shows every frame of this capture. A film of other
    cameras, another length or every second frame would silently pair pictures with the wrong photos.
    """
    steps, _ = read_path(path)
    starts: dict[str, int] = {}
    for index, step in enumerate(steps):
        starts.setdefault(step.segment, index)
    for camera in cameras:
        if camera.name not in starts:
            raise UserError(
                f"{path} has no pictures of camera {camera.name}: it belongs to another run; render it again"
            )
        shown = [step.frame for step in steps if step.segment == camera.name]
        if shown != list(range(capture.frames)):
            raise UserError(
                f"{path} shows {len(shown)} pictures of camera {camera.name} and the capture "
                f"has {capture.frames} frames, one each: "
                "it belongs to another run; render it again"
            )
    return starts
