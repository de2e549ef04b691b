# SPDX-License-Identifier: Apache-2.0
"""The rotation and translation of every camera by refinement, for the report and the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float


def pose_and_lens_changes(
    given: Sequence[Camera], refined: Sequence[Camera], radial: Float[np.ndarray, " V"]
) -> list[dict[str, Any]]:
    """A row for each camera: its turn and move, the change of its focal length, and its ``radial`` term."""
    changes = []
    for old, new, k1 in zip(given, refined, np.broadcast_to(radial, len(given))):
        turned = new.camera_from_world[:3, :3] @ old.camera_from_world[:3, :3].T
        degrees = float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(turned - np.eye(3)) / np.sqrt(8)))))
        moved_m = float(np.linalg.norm(new.centre_m - old.centre_m))
        longer = new.focal_px[0] / old.focal_px[0] - 1
        changes.append(
            {
                "camera": old.name,
                "turned_deg": degrees,
                "moved_m": moved_m,
                "focal_longer": longer,
                "radial_k1": float(k1),
            }
        )
    return changes


def changes_since_refinement(
    given: Sequence[Camera], refined: Sequence[Camera], report: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """The same, with the radial terms of an earlier refinement in ``report``."""
    radial = [change["radial_k1"] for change in report.get("changes", [])] or [0.0] * len(given)
    return pose_and_lens_changes(given, refined, np.array(radial))
