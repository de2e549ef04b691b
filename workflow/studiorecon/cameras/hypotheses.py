# SPDX-License-Identifier: Apache-2.0
"""Were the poses meant the other way round? People decide: under the right convention their rays meet, in front of the cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from studiorecon.cameras.correspondences import observe
from studiorecon.errors import Refusal
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

_CLEARLY = 1.5
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_HYPOTHESES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as read": lambda pose: pose,
    "poses are world-from-camera": np.linalg.inv,
    "axes are OpenGL's": lambda pose: _FLIP @ pose,
    "world-from-camera with OpenGL axes": lambda pose: _FLIP @ np.linalg.inv(pose),
}


def check_conventions(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float
) -> list[dict[str, Any]]:
    """Every reading of the poses with its score: agreement of people's rays, per detection that could agree.

    Raises Refusal when another reading clearly beats the one that was used.
    """
    table = []
    for name, change in _HYPOTHESES.items():
        seen, graph = observe(detections, [replace(c, camera_from_world=change(c.camera_from_world)) for c in cameras], frames, gate_m)
        table.append({"hypothesis": name, "score": seen.affinity / max(len(graph.view), 1)})
    best = max(table, key=lambda row: row["score"])
    if best["hypothesis"] != "as read" and best["score"] > 0.3 and best["score"] > _CLEARLY * table[0]["score"]:
        raise Refusal(
            f"the calibration fits the people only if its {best['hypothesis']} (agreement {best['score']:.2f}, against "
            f"{table[0]['score']:.2f} as its format defines it): convert it to its format's convention, or export it again"
        )
    return table
