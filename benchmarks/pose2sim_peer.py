# SPDX-License-Identifier: Apache-2.0
"""Pose2Sim (PyPI, BSD-3) on the same keypoints and calibration, in an environment of its own; never part of this
project."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np

_RUN = """
import json, sys
from Pose2Sim.triangulation import triangulate_all
triangulate_all(json.loads(sys.argv[1]))
"""


def pose2sim_points(
    python: Path, calibration: Path, keypoints: Path, cameras: list[str], folder: Path
) -> dict[str, np.ndarray]:
    """Keypoint name → (T, 3) metres in the calibration's world, NaN unknown; its demo's settings, no filter, no
    filling, all frames.

    ``python`` is the interpreter of an environment that has the package ``pose2sim``. Raises CalledProcessError when it
    fails.
    """
    (folder / "calibration").mkdir(parents=True)
    shutil.copy(calibration, folder / "calibration")
    for name in cameras:
        (folder / "pose" / f"{name}_json").mkdir(parents=True)
        for file in sorted((keypoints / name).glob("*.json")):
            shutil.copy(file, folder / "pose" / f"{name}_json")
    config = {
        "project": {"project_dir": str(folder), "multi_person": False, "frame_rate": 60, "frame_range": "all"},
        "pose": {"pose_model": "BODY_25B"},
        "triangulation": dict.fromkeys(("remove_incomplete_frames", "show_interp_indices", "make_c3d"), False)
        | {
            "reproj_error_threshold_triangulation": 15,
            "likelihood_threshold_triangulation": 0.3,
            "undistort_points": True,
        }
        | {"min_cameras_for_triangulation": 2, "min_chunk_size": 1, "sections_to_keep": "all", "handle_LR_swap": False}
        | {"interpolation": "none", "interp_if_gap_smaller_than": 0, "fill_large_gaps_with": "nan"}
        | {"max_distance_m": 1.0, "max_unseen_frames": 100},
    }
    subprocess.run(
        [str(python), "-c", _RUN, json.dumps(config)], check=True, capture_output=True, text=True, cwd=folder
    )
    return read_trc(next((folder / "pose-3d").glob("*.trc")))


def read_trc(path: Path) -> dict[str, np.ndarray]:
    """Marker → (T, 3) metres with z up: a .trc has y up, (x, y, z) = (Y, Z, X) of the calibration's world."""
    lines = path.read_text(encoding="utf-8").splitlines()
    names = [n for n in lines[3].split("\t")[2:] if n]
    rows = [line.split("\t")[2:] for line in lines[5:] if line.strip()]
    values = np.array(
        [[float(v) if v.strip() else np.nan for v in (row + [""] * 3 * len(names))[: 3 * len(names)]] for row in rows]
    )
    points = values.reshape(len(rows), len(names), 3)[..., [2, 0, 1]]
    return {
        n: np.where(np.abs(points[:, i]).sum(-1, keepdims=True) > 0, points[:, i], np.nan) for i, n in enumerate(names)
    }
