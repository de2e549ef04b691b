# SPDX-License-Identifier: Apache-2.0
"""``people.lift``: one camera's pelvises at the scene's depth, the paper's position of a person (Eq. S1).

Depth of the first moment is from the network that estimated the cameras. Every later frame's is from a monocular
network, aligned to the first one's metres by one alignment per camera: people walk through single frames' fits, and
depth that fluctuates from frame to frame would move everybody (U22, D06).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames
from studiorecon.geometry.depth_alignment import Alignment, align_depth, shared_alignment
from studiorecon.geometry.lifting import SURFACE_TO_PELVIS_M, lift_pelvis
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.models.catalogue.registry import find_card as card_of
from studiorecon.models.loading import load
from studiorecon.progress import progress, say
from studiorecon.rig.first_depth import first_moment
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, read_detections, write_detections
from studiorecon.scene.spool import Slot, Spool
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

_HIPS = ("left_hip", "right_hip")
# A person's clothes and shadow reach this share of their height beyond their keypoints.
_WIDER = 0.15
_INSTEAD = "set people.association.position to rays"
# Half the still pixels must be within this factor after alignment, or the two show different scenes.
_WORST_GAP = 0.25
_NEAR_M = 0.1


@dataclass(frozen=True)
class Lifting:
    """Conversion of a person's pixel to a position.

    Attributes:
        patch_px: side of the square in which the depth is read (paper: the pixel's own).
    """

    surface_to_joint_m: float = setting(
        SURFACE_TO_PELVIS_M,
        "Distance from the visible surface to the pelvis, along the ray; for association.position scene.",
        unit="m",
        minimum=0,
        maximum=0.5,
        paper="0, Eq. S1; U26",
        paper_value=0.0,
    )
    patch_px: int = 1


@dataclass(frozen=True)
class Settings:
    """How people are lifted."""

    lift: Lifting = setting(Lifting(), "Places of people by the scene's depth.")


def pelvis_pixels(seen: Detections) -> Float[np.ndarray, "D 2"]:
    """Pixel of each detection's pelvis: its body's own, else the middle of its hips; NaN where neither is known."""
    layout = LAYOUTS[seen.layout]
    pixels = np.full((len(seen.frame), 2), np.nan)
    if set(_HIPS) <= set(layout.keypoints):
        hips = seen.keypoints[:, [layout.index(name) for name in _HIPS]]
        both = (hips[..., 2] > 0).all(-1)
        pixels[both] = hips[both, :, :2].mean(1)
    if seen.pelvis is not None:
        own = np.isfinite(seen.pelvis[:, :2]).all(-1)
        pixels[own] = seen.pelvis[own, :2]
    return pixels


def static_pixels(hw: tuple[int, int], people: Num[np.ndarray, "P K 3"]) -> Bool[np.ndarray, "H W"]:
    """Outside of the boxes around people's keypoints, widened for clothes and shadows."""
    out = np.ones(hw, bool)
    for points in people:
        known = points[points[:, 2] > 0, :2]
        if len(known):
            margin = _WIDER * float(np.ptp(known[:, 1]))
            (left, top), (right, bottom) = known.min(0) - margin, known.max(0) + margin
            out[max(int(top), 0) : max(int(bottom) + 1, 0), max(int(left), 0) : max(int(right) + 1, 0)] = False
    return out


def align_to_first(
    predicted: Mapping[int, Float[np.ndarray, "H W"]], first_m: Float[np.ndarray, "H W"], seen: Detections
) -> Alignment:
    """The one alignment of a monocular network's depth maps by frame to the first moment's depth in metres.

    Every frame is fitted on pixels without people in it and at the first moment; the camera is static, so its frames
    share one scale and shift.
    """
    rng, nobody = np.random.default_rng(0), static_pixels(first_m.shape, seen.keypoints[seen.frame == 0])
    fits = [
        align_depth(depth, first_m, nobody & static_pixels(first_m.shape, seen.keypoints[seen.frame == frame]), rng)
        for frame, depth in ((frame, predicted[frame]) for frame in sorted(predicted))
    ]
    return shared_alignment(fits)


def lift_detections(
    seen: Detections,
    predicted: Mapping[int, Float[np.ndarray, "H W"]],
    first_m: Float[np.ndarray, "H W"],
    alignment: Alignment,
    camera: Camera,
    lifting: Lifting,
) -> Detections:
    """The detections with their pelvises (u, v, z in metres) at the scene's depth, NaN where that is unknown.

    ``predicted``: depth maps by frame, of every frame with detections; ``first_m``: frame 0's own in metres.
    """
    pixels = pelvis_pixels(seen)
    pelvis = np.full((len(seen.frame), 3), np.nan)
    for frame in np.unique(seen.frame):
        rows = np.flatnonzero(seen.frame == frame)
        depth_m = alignment.apply(predicted[int(frame)], _NEAR_M)
        if frame == 0:
            depth_m = np.where(first_m > 0, first_m, depth_m)
        points_m, valid = lift_pelvis(
            depth_m,
            np.ones(camera.hw, bool),
            pixels[rows],
            camera,
            surface_to_joint_m=lifting.surface_to_joint_m,
            patch_px=lifting.patch_px,
            near_m=_NEAR_M,
        )
        where, z_m = camera.project(points_m[valid])
        pelvis[rows[valid]] = np.column_stack([where, z_m])
    return replace(seen, pelvis=pelvis)


class DepthMaps(Mapping[int, np.ndarray]):
    """Depth maps (H, W) by frame, in a file in ``folder`` until the process ends."""

    def __init__(self, folder: Path) -> None:
        self._spool, self._slots = Spool(folder), dict[int, Slot]()

    def put(self, frame: int, depth: Float[np.ndarray, "H W"]) -> None:
        """Add one frame's."""
        self._slots[frame] = self._spool.put(depth)

    def __getitem__(self, frame: int) -> Float[np.ndarray, "H W"]:
        return self._spool.get(self._slots[frame])

    def __iter__(self) -> Iterator[int]:
        return iter(self._slots)

    def __len__(self) -> int:
        return len(self._slots)


def run(
    settings: Settings,
    camera: str,
    model: Path,
    video: Path,
    detections: Path,
    first: Path,
    found: Path,
    network: str,
    weights: Place,
    device: str,
    lifted_detections: Written,
) -> None:
    """Write one camera's ``detections`` with pelvises at the scene's depth.

    ``first``: depth (EXR, metres of the model ``found``) of the first moment; ``network``: a monocular one for the
    later frames of ``video``. Depth maps of all frames with people are in a temporary file: 4 bytes a pixel.
    """
    cameras = read_model(model.parent)
    own = camera_named(cameras, camera, model)
    seen, (first_m, _) = read_detections(detections), first_moment(first, found, cameras, own, _INSTEAD)
    if not len(seen.frame):
        write_detections(lifted_detections, replace(seen, pelvis=np.zeros((0, 3))))
        return
    wanted, last = set(seen.frame.tolist()), int(seen.frame.max()) + 1
    monocular = load("monocular depth", network, weights, device)
    predicted = DepthMaps(lifted_detections.parent)
    for t, picture in enumerate(progress(read_frames(video, 0, last), f"depth of {camera}", total=last)):
        if t in wanted:
            predicted.put(t, monocular.depth(picture, own.focal_px[0]))
    title, alignment = card_of(network).title, align_to_first(predicted, first_m, seen)
    if alignment.model == "undetermined":
        raise UserError(
            f"the unit of {title} in camera {camera} is unknown: none of {len(predicted)} frames has enough pixels "
            f"without people and with depth of the first moment; {_INSTEAD}"
        )
    gaps = [_gap(alignment.apply(depth, _NEAR_M), first_m) for depth in predicted.values()]
    if not (gap := float(np.median(gaps))) <= _WORST_GAP:
        raise UserError(
            f"{title} and the first moment's depth differ by {gap:.0%} (median) in camera {camera}, so their views "
            f"differ; {_INSTEAD}"
        )
    result = lift_detections(seen, predicted, first_m, alignment, own, settings.lift)
    known = int(np.isfinite(result.pelvis[:, 2]).sum()) if result.pelvis is not None else 0
    say(
        f"camera {camera}: metres = {alignment.scale:.4g} × {title} + {alignment.shift_m:.2f}, one alignment for "
        f"{len(predicted)} frames, {gap:.1%} off the first moment's depth; {known} of {len(seen.frame)} pelvises "
        "lifted; the depth of the others is unknown"
    )
    write_detections(lifted_detections, result)


def _gap(depth_m: np.ndarray, first_m: np.ndarray) -> float:
    both = (depth_m > 0) & (first_m > 0)
    return float(np.median(np.abs(depth_m[both] / first_m[both] - 1))) if both.any() else float("inf")
