# SPDX-License-Identifier: Apache-2.0
"""A run's numbers as one row of the paper's tables, next to the paper's own rows, which come from other data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from studiorecon.arrays import mean_of_measured
from studiorecon.scene.files import read_table

COLUMNS = ("table", "data", "method", "measure", "value")
METHODS = ("StudioRecon", "MonoFusion", "Dyn-3DGS", "STG")
# measure, heading, digits. The paper does not name its SSIM; methods before it print the zero-padded one.
MEASURES = (
    ("psnr", "PSNR ↑", 2),
    ("ssim", "SSIM ↑", 3),
    ("ssim_3dgs", "SSIM, zero-padded ↑", 3),
    ("lpips", "LPIPS ↓", 3),
    ("flip", "ꟻLIP ↓", 3),
    ("psnr_people", "PSNR, people ↑", 2),
    ("psnr_seen", "PSNR, seen ↑", 2),
    ("psnr_unseen", "PSNR, unseen ↑", 2),
    ("temporal_l1_seen", "temporal L1, seen ↓", 3),
    ("temporal_l1_unseen", "temporal L1, unseen ↓", 3),
    ("warp_rms", "Warp-RMS ↓", 3),
    ("pck_0.05", "PCK@0.05 ↑", 3),
    ("pck_0.1", "PCK@0.1 ↑", 3),
    ("detection_rate", "detection rate ↑", 3),
    ("association_accuracy", "association accuracy ↑", 3),
    ("association_precision", "association precision ↑", 3),
    ("jitter_mm_f2", "jitter, mm/f² ↓", 2),
    ("jitter_deg_f2", "jitter, °/f² ↓", 2),
)


def own_row(metrics: Mapping[str, Any], recognised: Mapping[str, Any], version: str) -> dict[str, float | None]:
    """This run's values by the names above, None where not measured; jitter is the mean over people, all joints."""
    pictures, people = metrics["pictures"].get(version, {}), metrics.get("jitter", {}).values()
    row = {name: pictures.get(name, {}).get("value") for name, _, _ in MEASURES}
    row |= {name: recognised.get(version, {}).get(name) for name in ("pck_0.05", "pck_0.1", "detection_rate")}
    row |= {f"association_{name}": metrics.get("identities", {}).get(name) for name in ("accuracy", "precision")}
    row["jitter_mm_f2"] = mean_of_measured(person["joints_mm_f2"] for person in people)
    row["jitter_deg_f2"] = mean_of_measured(person["pose_deg_f2"] for person in people)
    return row


def paper_rows(path: Path) -> dict[str, dict[str, tuple[float, str]]]:
    """method → measure → (value, the data it is the mean of), from the paper's tables of means."""
    rows: dict[str, dict[str, tuple[float, str]]] = {method: {} for method in METHODS}
    for line in read_table(path, COLUMNS):
        if line["data"].startswith("mean of"):
            rows[line["method"]][line["measure"]] = (float(line["value"]), line["data"])
    return rows


def paper_comparison(
    metrics: Mapping[str, Any],
    recognised: Mapping[str, Any],
    path: Path,
    versions: Sequence[str] = ("raw", "enhanced"),
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of text: one line per measure, this run's versions first, then the paper's methods."""
    own, others = {version: own_row(metrics, recognised, version) for version in versions}, paper_rows(path)
    header = [
        "measure",
        *(f"this run, {version}" for version in versions),
        *(f"{method} (other data)" for method in METHODS),
        "their data",
    ]
    rows = []
    for name, title, digits in MEASURES:
        mine = ["not measured" if row[name] is None else f"{row[name]:.{digits}f}" for row in own.values()]
        theirs = [f"{others[m][name][0]:.{digits}f}" if name in others[m] else "–" for m in METHODS]
        data = sorted({others[method][name][1] for method in METHODS if name in others[method]})
        rows.append([title, *mine, *theirs, ", ".join(data)])
    return header, rows
