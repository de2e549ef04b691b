# SPDX-License-Identifier: Apache-2.0
"""``depth.network``: what an upstream network says about the depth of every clean plate, in its own unit, one job for all cameras.

Writes ``depth/<camera>.estimate.exr``: Z in the network's unit, A its confidence. ``depth.aligned`` makes metres of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.exr import write_depth
from studiorecon.images.stills import read_plate
from studiorecon.images.video import to_bytes
from studiorecon.models.moge import Moge
from studiorecon.models.pi3 import Pi3
from studiorecon.models.registry import model as registered
from studiorecon.models.sizes import nearest
from studiorecon.progress import progress, say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.colmap import read_model

# A principal point further off the middle than this share of the width bends what a network makes of a known focal length.
_OFF_CENTRE = 0.05


@dataclass(frozen=True)
class Settings:
    """Which network; see config.yaml."""

    source: Literal["embedded", "moge", "moge3", "pi3", "pi3x", "mapanything", "precomputed"]


def estimates(
    source: str, cameras: list[Camera], pictures: list[np.ndarray], weights: Path, device: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(H, W) depth (0 = unknown) and confidence of every picture (H, W, 3) uint8, at the picture's own size."""
    if source in ("moge", "moge3"):
        network = Moge(source, weights, device)
        made = [network.depth(picture, camera.focal_px[0]) for camera, picture in zip(cameras, progress(pictures, "plates"))]
        return [(depth, (depth > 0).astype(np.float32)) for depth in made]
    found = Pi3(source, weights, device).reconstruct(pictures, [c.name for c in cameras])
    for camera, seen, residual in zip(cameras, found.cameras, found.focal_residuals_px):
        focal_px = seen.focal_px[0] * camera.wh[0] / seen.wh[0]
        say(f"{camera.name}: its own focal length is {focal_px:.0f} px, the calibration's {camera.focal_px[0]:.0f} px ({residual:.1f})")
    return [(nearest(depth, camera.hw), nearest(sure, camera.hw)) for camera, depth, sure in zip(cameras, found.depths, found.confidences)]


def run(settings: Settings, model: Path, plates: list[Path], weights: Path, device: str, depths: list[Path]) -> None:
    """Write ``depths`` (EXR, in the network's unit) of the ``plates``, both in the order of the model's cameras."""
    cameras = read_model(model.parent)
    if not len(cameras) == len(plates) == len(depths):
        raise Refusal(f"{len(plates)} plates and {len(depths)} depth maps for {len(cameras)} cameras of {model}; each camera needs both")
    entry = registered(settings.source)
    for camera in cameras:
        off = np.abs(np.array(camera.principal_px) / camera.wh - 0.5).max()
        if off > _OFF_CENTRE:
            warn(f"{camera.name}: the principal point is {off:.0%} off the middle, which {entry.title} does not know; its depth will lean")
    pictures = [to_bytes(read_plate(plate)[0]) for plate in plates]
    say(f"depth of {len(cameras)} plates by {entry.title} ({entry.terms.weights}), upstream at {entry.runtime.commit}")
    for path, (depth, sure) in zip(depths, estimates(settings.source, cameras, pictures, weights, device)):
        say(f"{path.name}: {np.mean(depth > 0):.0%} known")
        write_depth(path, depth, sure)
