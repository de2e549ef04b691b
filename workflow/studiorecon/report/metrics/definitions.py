# SPDX-License-Identifier: Apache-2.0
"""The meaning of every printed number (unit, direction, variant, mask, library), and when two may be compared."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from studiorecon import code
from studiorecon.report.metrics.measures import FLIP_EVERY

PROTOCOL = (
    "held-out cameras; 8-bit pictures; mean over frames, then over cameras, "
    "unweighted, never pooled; intervals of 95 % by "
    "bootstrap over blocks of frames"
)
SEEN_BY = (
    "; {} estimated the cameras from the first picture of every camera, held-out ones included, "
    "because nothing else gives their poses"
)
NO_LPIPS = "report.lpips is none: the weights of its network are not part of this project"
_NETS = {"none": "AlexNet", "alex": "AlexNet", "vgg": "VGG16"}
_SSIM = (
    "11×11 Gaussian, σ 1.5, K 0.01/0.03, range 1, population covariance, per channel, float64, variances clamped at 0"
)
_REGIONS = {
    "people": "{people}, undilated",
    "background": "outside the {people}",
    "seen": "surfaces of the room that a training camera sees at that time, by the {depth}, within seen_tolerance",
    "unseen": "surfaces of the room that no training camera sees at that time",
    "people_seen": "pixels of people whose surface a training camera sees at that time, by the {depth} of that frame",
    "people_unseen": "pixels of people whose surface no training camera sees at that time",
}
_TRUE = {"people": "true person mask of the photo", "depth": "true depth"}
_ESTIMATED = {"people": "outline of the fitted bodies", "depth": "run's own depth"}
_CHANGE = (
    "O(t) − warp(O(t−1), F(t→t−1)), mean over channels; DIS flow of the true video; pixels where the flow leads back"
)


def definitions(net: str, estimated: bool = False) -> dict[str, dict[str, str]]:
    """measure → definition, unit, better (up or down), mask, library.

    ``net`` is what LPIPS was measured with; ``estimated``: regions come from the run's own depth and bodies.
    """
    regions = {name: mask.format(**(_ESTIMATED if estimated else _TRUE)) for name, mask in _REGIONS.items()}
    ours, with_flow = "studiorecon, exact", f"studiorecon; DIS flow of OpenCV {cv2.__version__}"
    found = {
        "psnr": _entry(
            "10 log10(1/MSE), MSE over H·W·3, range 1; identical pictures count 100 dB", "dB", "up", "none", ours
        ),
        "ssim": _entry(f"{_SSIM}; mean over windows inside the picture", "", "up", "none", ours),
        "ssim_3dgs": _entry(
            f"{_SSIM}; zero padding, mean over the whole picture, as the 3DGS lineage", "", "up", "none", ours
        ),
        "temporal_l1": _entry(f"mean absolute value of {_CHANGE}", "", "down", "none", with_flow),
        "warp_rms": _entry(
            f"root of the mean square of {_CHANGE}: what papers call Warp-L2", "", "down", "none", with_flow
        ),
        "flicker_excess": _entry(
            "temporal_l1 minus that of the photos on the same pixels", "", "down", "none", with_flow
        ),
    }
    for region, mask in regions.items():
        found[f"psnr_{region}"] = _entry(
            "10 log10(1/MSE), MSE over the mask's pixels; at least 256", "dB", "up", mask, ours
        )
        found[f"ssim_{region}"] = _entry(f"{_SSIM}; windows wholly inside the mask (eroded 5 px)", "", "up", mask, ours)
    for region in ("seen", "unseen"):
        found[f"temporal_l1_{region}"] = _entry(
            f"mean absolute value of {_CHANGE}", "", "down", regions[region], with_flow
        )
    for region in ("seen", "people_seen"):
        found[f"share_{region}"] = _entry("share of seen among seen and unseen pixels", "", "up", regions[region], ours)
    found["flip"] = _entry(
        f"mean LDR-ꟻLIP, 67 pixels per degree; of one frame in {FLIP_EVERY}", "", "down", "none", "flip-evaluator"
    )
    found["lpips"] = _entry(f"LPIPS 0.1, {_NETS[net]}, inputs in [−1, 1], float32", "", "down", "none", _library(net))
    return found


def _library(net: str) -> str:
    if net == "none":
        return "not measured"
    import torch

    return f"studiorecon on torch {torch.__version__}"


def provenance(settings: Mapping[str, Any], masks: str) -> dict[str, Any]:
    """The conditions that must agree before two results may be compared: libraries, code, settings, source of masks."""
    return {
        "code": code.digest("report.metrics.measures"),
        "revision": _revision(),
        "settings": dict(settings),
        "masks": masks,
        "libraries": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "numba": numba.__version__,
            "opencv": cv2.__version__,
        },
    }


def _entry(definition: str, unit: str, better: str, mask: str, library: str) -> dict[str, str]:
    return {"definition": definition, "unit": unit, "better": better, "mask": mask, "library": library}


def _revision() -> str | None:
    """The commit of the code; None where it is not in a repository, as inside an image."""
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return None
    return commit.stdout.strip() or None
