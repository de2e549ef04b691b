# SPDX-License-Identifier: Apache-2.0
"""``depth.aligned``: a network's depth, or a file of it, in metres, aligned to the plane stereo of the same picture.

A network's depth is smooth and complete but its scale is unreliable (the paper aligns MoGe to Pi3's first frame;
GEN3C's authors name the mismatch as the first cause of failure). Depth on which both agree counts as measured, the
network's alone as inferred.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.depth.sweep_settings import DefaultConfidence, NearLimit
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.stills import read_image
from studiorecon.geometry.depth_alignment import Alignment, align_depth
from studiorecon.images.sizes import resample_nearest
from studiorecon.progress import say, warn
from studiorecon.scene.user_files import read_npy, read_npz
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

_MILLIMETRES = 1000.0
# A map may differ from the working shape by rounding only.
_SHAPE_TOLERANCE = 0.02
# Half the pixels must be within this factor of the measured depth after alignment, or the two show different scenes.
_WORST_GAP = 0.25


@dataclass(frozen=True)
class Settings(NearLimit, DefaultConfidence):
    """A network's depth counts as measured within ``agree_share`` of the planes' depth, else as inferred."""

    agree_share: float = 0.05


def read_estimate(path: Path) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """(H, W) float32 depth (0 = unknown: NaN, infinite or not positive) and confidence, of an .exr, .npy, .npz or
    16-bit .png (mm)."""
    if not path.is_file():
        raise UserError(f"{path} is missing; depth.precomputed names a folder with <camera>.exr, .npy, .npz or .png")
    if path.suffix == ".exr":
        return read_depth(path)
    if path.suffix == ".png":
        stored = read_image(path, cv2.IMREAD_UNCHANGED)
        if stored.dtype != np.uint16 or stored.ndim != 2:
            raise UserError(f"{path} is not a 16-bit grey picture of millimetres")
        depth = stored.astype(np.float32) / _MILLIMETRES
    else:
        depth = np.squeeze(_numbers(path))
    if depth.ndim != 2:
        raise UserError(f"{path} holds an array of shape {depth.shape}, expected one depth map (H, W)")
    if below := int((depth < 0).sum()):
        warn(f"{path}: {below} of {depth.size} depths are below 0 and count as unknown; write depth, not its inverse")
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    return depth, (depth > 0).astype(np.float32)


def _numbers(path: Path) -> np.ndarray:
    if path.suffix == ".npz":
        held = read_npz(path)
        name = next((n for n in ("depth", "depths", "arr_0") if n in held), None)
        if name is None:
            raise UserError(
                f"{path} holds {', '.join(held) or 'no array'}; depth is looked for as depth, depths or arr_0"
            )
        array = held[name]
    else:
        array = read_npy(path)
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path} holds {array.dtype}, not numbers; save the depth as floats")
    with np.errstate(over="ignore"):  # a double beyond float32 is no depth, and becomes infinite here
        return array.astype(np.float32)


def merge_depths(
    estimate: Float[np.ndarray, "H W"],
    sure: Float[np.ndarray, "H W"],
    planes_m: Float[np.ndarray, "H W"],
    planes_sure: Float[np.ndarray, "H W"],
    found: Alignment,
    settings: Settings,
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Depth in metres and confidence: the planes' own where both agree, elsewhere the network's.

    The network alone has at most ``default_confidence``.
    """
    depth_m = found.apply(estimate, settings.near_m).astype(np.float32)
    known = depth_m > 0
    agree = known & (planes_m > 0) & (np.abs(depth_m - planes_m) <= settings.agree_share * planes_m)
    alone = np.minimum(sure, 1) * settings.default_confidence
    return depth_m, np.where(known, np.where(agree, np.maximum(planes_sure, alone), alone), 0).astype(np.float32)


def run(settings: Settings, camera: str, model: Path, estimate: Path, planes: Path, depth: Written) -> None:
    """Write one camera's depth in metres from ``estimate`` (any unit) and ``planes`` (``depth.refine``'s)."""
    own = next((c for c in read_model(model.parent) if c.name == camera), None)
    if own is None:
        raise UserError(f"camera {camera} is not in {model}")
    given, sure = read_estimate(estimate)
    shape = (given.shape[1] / given.shape[0]) / (own.wh[0] / own.wh[1])
    if abs(shape - 1) > _SHAPE_TOLERANCE:
        raise UserError(
            f"{estimate} is {given.shape[1]}×{given.shape[0]}, another shape than "
            f"camera {camera} ({own.wh[0]}×{own.wh[1]})"
        )
    given, sure = resample_nearest(given, own.hw), resample_nearest(sure, own.hw)
    planes_m, planes_sure = read_depth(planes, own.wh)
    measured = planes_sure > settings.default_confidence
    found = align_depth(given, planes_m, measured, np.random.default_rng(0))
    if found.model == "undetermined":
        raise UserError(
            f"the unit of {estimate.name} is unknown: stereo measures only {int((measured & (given > 0)).sum())} of "
            f"its pixels in camera {camera}; set depth.source to embedded, or bring metric depth maps (depth/ in "
            "the dataset)"
        )
    depth_m, confidence = merge_depths(given, sure, planes_m, planes_sure, found, settings)
    both = measured & (depth_m > 0)
    gap = float(np.median(np.abs(depth_m[both] / planes_m[both] - 1))) if both.any() else 1.0
    if gap > _WORST_GAP:
        raise UserError(
            f"{estimate.name} and stereo in camera {camera} differ by {gap:.0%} in the median: not the same view"
        )
    shift = f" + {found.shift_m:.2f} m" if found.model == "affine" else ""
    say(f"depth of {camera} = {found.scale:.4g} × {estimate.name}{shift}; {gap:.1%} off stereo in the median")
    say(
        f"{np.mean(confidence > settings.default_confidence):.0%} agrees with stereo, "
        f"{np.mean(depth_m == 0):.0%} stays unknown"
    )
    write_depth(depth, depth_m, confidence)
