# SPDX-License-Identifier: Apache-2.0
"""What came of one run: its metrics in brief, or the sentence that says why there are none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.images.metrics import mean_of
from studiorecon.scene.files import read_json

NOTHING_MEASURED = "no picture was compared with a photo"
_PICTURES = (
    "psnr",
    "ssim",
    "ssim_3dgs",
    "psnr_people",
    "psnr_background",
    "psnr_seen",
    "psnr_unseen",
    "warp_rms",
    "temporal_l1",
    "lpips",
    "flip",
)
# What two results must share to be comparable, as in report.compare.
_SCORED = ("masks", "libraries", "code", "settings")


@dataclass(frozen=True)
class Outcome:
    """Metrics, their intervals, PSNR per camera and frame, the worst of them; ``sentence`` is empty unless the run
    failed."""

    sentence: str = ""
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    intervals: Mapping[str, Sequence[float] | None] = field(default_factory=dict)
    frames: Mapping[str, Sequence[float | None]] = field(default_factory=dict)
    worst: Mapping[str, Any] = field(default_factory=dict)
    scored: Mapping[str, Any] | None = None


def outcome(path: Path) -> Outcome:
    """The brief of a run's ``metrics.json``. A PSNR that is not a finite number is a failure, not a low score."""
    try:
        metrics = read_json(path)
    except UserError as refusal:
        return Outcome(sentence=str(refusal))
    pictures = metrics["pictures"]["enhanced" if "enhanced" in metrics["pictures"] else "raw"]
    if not pictures["psnr"]["cameras"]:
        return Outcome(sentence=NOTHING_MEASURED)
    if not _is_number(pictures["psnr"]["value"]):
        return Outcome(sentence=f"PSNR at the held-out cameras is not a number ({pictures['psnr']['reason'] or 'NaN'})")
    frames = {camera: entry["frames"] for camera, entry in pictures["psnr"]["cameras"].items()}
    jitter = metrics["jitter"].values()
    people = metrics["bodies"]["people"].values()
    brief = {name: pictures.get(name, {}).get("value") for name in _PICTURES} | {
        "psnr_raw": metrics["pictures"].get("raw", {}).get("psnr", {}).get("value"),
        "joints_mm": metrics["bodies"]["mpjpe_world_mm"],
        "jitter_mm_f2": mean_of(person["joints_mm_f2"] for person in jitter),
        "association_accuracy": metrics["identities"].get("accuracy"),
        "people_missed": float(len(metrics["bodies"]["missed"])) if people or metrics["bodies"]["missed"] else None,
    }
    return Outcome(
        metrics={name: value if _is_number(value) else None for name, value in brief.items()},
        intervals={name: pictures.get(name, {}).get("interval") for name in _PICTURES},
        frames=frames,
        worst=worst(pictures["psnr"]["cameras"]),
        scored={name: metrics["provenance"][name] for name in _SCORED},
    )


def worst(cameras: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The camera and the single frame with the lowest PSNR; a cheap run may win on average and lose one of them."""
    by_camera = {camera: entry["value"] for camera, entry in cameras.items() if _is_number(entry["value"])}
    by_frame = {
        (c, t): value for c, entry in cameras.items() for t, value in enumerate(entry["frames"]) if _is_number(value)
    }
    if not by_camera or not by_frame:
        return {}
    camera, (frame_camera, frame) = min(by_camera, key=by_camera.__getitem__), min(by_frame, key=by_frame.__getitem__)
    return {
        "camera": camera,
        "camera_psnr": by_camera[camera],
        "frame_camera": frame_camera,
        "frame": frame,
        "frame_psnr": by_frame[frame_camera, frame],
    }


def why_it_failed(output: str, folder: Path, limit_minutes: float | None) -> str:
    """One sentence: the last line of the first failed job's log, else Snakemake's own last word."""
    if limit_minutes is not None:
        return f"stopped after {limit_minutes:g} minutes (sweep_minutes)"
    for block in output.split("Error in rule ")[1:]:
        rule = re.match(r"\w+", block)
        log = re.search(r"log: ([^\s(]+)", block)
        lines = _lines(folder / log.group(1)) if log else []
        if rule and lines:
            return f"{rule.group(0)}: {lines[-1]}"
    said = [line.strip() for line in output.splitlines() if line.strip()]
    return said[-1] if said else "Snakemake said nothing"


def _lines(path: Path) -> list[str]:
    return (
        [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
        if path.is_file()
        else []
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
