# SPDX-License-Identifier: Apache-2.0
"""``depth.network``: an upstream network's depth of every clean plate, in its own unit, one job for all cameras.

Writes ``depth/<camera>.estimate.exr``: Z in the network's unit, A its confidence. ``depth.refine`` converts it to
metres and lets it compete with planes and furniture.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.footage.exr import write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import to_bytes
from studiorecon.images.sizes import resample_nearest
from studiorecon.models.catalogue.registry import find_card as card_of
from studiorecon.models.choices import DepthSource
from studiorecon.models.loading import load
from studiorecon.progress import progress, say, warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import require_one_each
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

    from studiorecon.models.protocols import MonocularDepth

# A principal point further off the middle than this share of the width biases a network that uses a known focal length.
_OFF_CENTRE = 0.05
_SUFFIX = ".estimate.exr"
_OF_ONE_PICTURE = ("monocular depth", "inverse depth")
_NOTHING = np.zeros((1, 1), np.float32)


@dataclass(frozen=True)
class Settings:
    """Which network."""

    source: DepthSource = setting(
        "embedded",
        "embedded (room box and furniture from photos), a network that competes with them, onnx (your own: "
        "depth.network), or precomputed files in any unit.",
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


def estimate_depths(
    source: str,
    cameras: list[Camera],
    pictures: list[Integer[np.ndarray, "H W 3"]],
    own: list[Path],
    weights: Path,
    device: str,
) -> list[tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]]:
    """Depth (0 = unknown) and confidence of every uint8 picture, at its own size; ``own``: the user's network
    (onnx)."""
    if own or card_of(source).kind in _OF_ONE_PICTURE:
        network = _network_of_one_picture(source, own, weights, device)
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


def _network_of_one_picture(source: str, own: list[Path], weights: Path, device: str) -> MonocularDepth:
    if own:
        # By name, as ``models.loading`` does: the module counts only in runs that use it.
        adapter = importlib.import_module("studiorecon.models.adapters.onnx_depth")
        return cast("MonocularDepth", adapter.DepthNetwork(own[0], own[0].name))
    if card_of(source).kind == "inverse depth":
        return load("inverse depth", source, weights, device)
    return load("monocular depth", source, weights, device)


def run(
    settings: Settings,
    model: Path,
    plates: list[Path],
    network: list[Path],
    weights: Place,
    device: str,
    depths: list[Written],
) -> None:
    """Write ``depths`` (EXR, in the network's unit) of the ``plates``; empty for a camera that the model lacks.

    The plates are in the order of the model's cameras. ``network`` is the user's own, for source onnx.
    """
    cameras = read_model(model.parent)
    require_one_each(cameras, plates=plates)
    written = {path.name.removesuffix(_SUFFIX): path for path in depths}
    for name in written.keys() - {camera.name for camera in cameras}:
        write_depth(written[name], _NOTHING, _NOTHING)
    title = network[0].name if network else card_of(settings.source).title
    for camera in cameras:
        off = np.abs(np.array(camera.principal_px) / camera.wh - 0.5).max()
        if off > _OFF_CENTRE:
            warn(
                f"{camera.name}: the principal point is {off:.0%} off the image centre, which {title} ignores; "
                "its depth will be tilted"
            )
    pictures = [to_bytes(read_plate(plate)[0]) for plate in plates]
    if network:
        say(f"depth of {len(cameras)} plates by {title}")
    else:
        card = card_of(settings.source)
        say(f"depth of {len(cameras)} plates by {title} ({card.terms.weights}), upstream at {card.runtime.commit}")
    for camera, (depth, sure) in zip(
        cameras, estimate_depths(settings.source, cameras, pictures, network, weights, device)
    ):
        say(f"{camera.name}: {np.mean(depth > 0):.0%} known")
        write_depth(written[camera.name], depth, sure)
