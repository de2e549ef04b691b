# SPDX-License-Identifier: Apache-2.0
"""Picture measures of one view against its photo, and how they are averaged.

Per frame → mean over frames → mean over cameras, unweighted, each level stored; squared errors are never pooled over frames. What
was not measured is None with a reason, never 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from studiorecon.images.flow import consistent, dis_flow, grey_levels
from studiorecon.images.metrics import psnr, ssim, ssim_3dgs, ssim_map, warp_error
from studiorecon.images.warp import warp

FULL = ("psnr", "ssim", "ssim_3dgs")
TEMPORAL = ("temporal_l1", "warp_square")
REGIONS = ("people", "background", "seen", "unseen")
NAMES = (*FULL, *(f"{measure}_{region}" for region in REGIONS for measure in ("psnr", "ssim")), *TEMPORAL)


def measure_picture(prediction: np.ndarray, photo: np.ndarray, regions: Mapping[str, np.ndarray]) -> dict[str, float | None]:
    """Every picture measure of one frame; ``regions`` are masks (H, W) bool of the photo by name."""
    similarity = ssim_map(prediction, photo)
    values = {"psnr": psnr(prediction, photo), "ssim": ssim(similarity), "ssim_3dgs": ssim_3dgs(similarity)}
    for name, mask in regions.items():
        values[f"psnr_{name}"] = psnr(prediction, photo, mask)
        values[f"ssim_{name}"] = ssim(similarity, mask)
    return values


class Flicker:
    """Temporal measures of a sequence: each picture against the previous one, moved by the flow of the *photos*."""

    def __init__(self, flow_preset: str) -> None:
        self._preset = flow_preset
        self._photo: np.ndarray | None = None
        self._pictures: dict[str, np.ndarray] = {}

    def measure(self, photo: np.ndarray, pictures: Mapping[str, np.ndarray]) -> dict[str, dict[str, float | None]]:
        """``temporal_l1`` and ``warp_square`` of every named uint8 picture; None for the first frame."""
        grey = grey_levels(photo)
        values: dict[str, dict[str, float | None]] = {name: dict.fromkeys(TEMPORAL) for name in pictures}
        if self._photo is not None:
            backward, forward = dis_flow(grey, self._photo, self._preset), dis_flow(self._photo, grey, self._preset)
            valid = consistent(backward, forward)
            for name, picture in pictures.items():
                moved, inside = warp(self._pictures[name].astype(np.float32) / 255, backward)
                found = warp_error(picture, moved, valid & inside)
                if found is not None:
                    values[name] = dict(zip(TEMPORAL, found))
        self._photo, self._pictures = grey, dict(pictures)
        return values


def summary(frames: Mapping[str, Iterable[float | None]], reason: str) -> dict[str, Any]:
    """One measure over cameras: value, per-camera means, raw values per frame, counts of used and skipped frames.

    ``frames`` maps camera → values; ``reason`` is given when nothing at all was measured.
    """
    cameras = {}
    for camera, values in frames.items():
        listed = list(values)
        used = [value for value in listed if value is not None]
        cameras[camera] = {
            "value": float(np.mean(used)) if used else None,
            "used": len(used),
            "skipped": len(listed) - len(used),
            "frames": listed,
        }
    means = [entry["value"] for entry in cameras.values() if entry["value"] is not None]
    return {"value": float(np.mean(means)) if means else None, "reason": None if means else reason, "cameras": cameras}


def unmeasured(reason: str) -> dict[str, Any]:
    """The entry of a measure that could not be taken."""
    return {"value": None, "reason": reason, "cameras": {}}
