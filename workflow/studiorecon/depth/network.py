# SPDX-License-Identifier: Apache-2.0
"""``depth.network``: an upstream network's depth of every clean plate, in its own unit, one job for all cameras.

Writes ``depth/<camera>.estimate.exr``: Z in the network's unit, A its confidence. ``depth.aligned`` converts it to
metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.footage.exr import write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import to_bytes
from studiorecon.images.sizes import resample_nearest
from studiorecon.models.catalogue.registry import model as card_of
from studiorecon.models.choices import DepthSource
from studiorecon.models.loading import load
from studiorecon.progress import progress, say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import one_each
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# A principal point further off the middle than this share of the width biases a network that uses a known focal length.
_OFF_CENTRE = 0.05
_SUFFIX = ".estimate.exr"
_NOTHING = np.zeros((1, 1), np.float32)


@dataclass(frozen=True)
class Settings:
    """Which network."""

    source: DepthSource = setting(
        "embedded",
        "embedded (planes), a network aligned to the planes, or precomputed files in any unit.",
        paper="Pi3, then MoGe; U21",
        paper_value="moge",
    )
    reference: Literal["planes", "calibration"] = setting(
        "planes",
        "planes = plane sweep, to which network depth is aligned; calibration = first-frame depth "
        "of calibration.source, depth.source for later frames.",
        paper="Pi3's first frame above confidence 0.1, MoGe later; U21, U22",
        paper_value="calibration",
    )


def estimates(
    source: str, cameras: list[Camera], pictures: list[Integer[np.ndarray, "H W 3"]], weights: Path, device: str
) -> list[tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]]:
    """(H, W) depth (0 = unknown) and confidence of every picture (H, W, 3) uint8, at the picture's own size."""
    if card_of(source).kind == "monocular depth":
        network = load("monocular depth", source, weights, device)
        made = [
            network.depth(picture, camera.focal_px[0]) for camera, picture in zip(cameras, progress(pictures, "plates"))
        ]
        return [(depth, (depth > 0).astype(np.float32)) for depth in made]
    found = load("pose and depth", source, weights, device).reconstruct(pictures, [c.name for c in cameras])
    for camera, seen, residual in zip(cameras, found.cameras, found.focal_residuals_px):
        focal_px = seen.focal_px[0] * camera.wh[0] / seen.wh[0]
        say(
            f"{camera.name}: its own focal length is {focal_px:.0f} px, the calibration's "
            f"{camera.focal_px[0]:.0f} px ({residual:.1f})"
        )
    return [
        (resample_nearest(depth, camera.hw), resample_nearest(sure, camera.hw))
        for camera, depth, sure in zip(cameras, found.depths, found.confidences)
    ]


def run(
    settings: Settings, model: Path, plates: list[Path], weights: Place, device: str, depths: list[Written]
) -> None:
    """Write ``depths`` (EXR, in the network's unit) of the ``plates``; empty for a camera that the model lacks.

    The plates are in the order of the model's cameras.
    """
    cameras = read_model(model.parent)
    one_each(cameras, plates=plates)
    written = {path.name.removesuffix(_SUFFIX): path for path in depths}
    for name in written.keys() - {camera.name for camera in cameras}:
        write_depth(written[name], _NOTHING, _NOTHING)
    card = card_of(settings.source)
    for camera in cameras:
        off = np.abs(np.array(camera.principal_px) / camera.wh - 0.5).max()
        if off > _OFF_CENTRE:
            warn(
                f"{camera.name}: the principal point is {off:.0%} off the image centre, which {card.title} ignores; "
                "its depth will be tilted"
            )
    pictures = [to_bytes(read_plate(plate)[0]) for plate in plates]
    say(f"depth of {len(cameras)} plates by {card.title} ({card.terms.weights}), upstream at {card.runtime.commit}")
    for camera, (depth, sure) in zip(cameras, estimates(settings.source, cameras, pictures, weights, device)):
        say(f"{camera.name}: {np.mean(depth > 0):.0%} known")
        write_depth(written[camera.name], depth, sure)
