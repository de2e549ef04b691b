# SPDX-License-Identifier: Apache-2.0
"""The rotation and translation of every camera by refinement, for the report and the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.rig.moved_cameras import pose_changes
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float


def pose_and_lens_changes(
    given: Sequence[Camera], refined: Sequence[Camera], radial: Float[np.ndarray, " V"]
) -> list[dict[str, Any]]:
    """A row for each camera: its turn and move, the change of its focal length, and its ``radial`` term."""
    degrees, metres = pose_changes(refined, given)
    return [
        {
            "camera": old.name,
            "turned_deg": float(turned),
            "moved_m": float(moved),
            "focal_longer": new.focal_px[0] / old.focal_px[0] - 1,
            "radial_k1": float(k1),
        }
        for old, new, turned, moved, k1 in zip(given, refined, degrees, metres, radial, strict=True)
    ]


def changes_since_refinement(
    given: Sequence[Camera], refined: Sequence[Camera], report: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """The same, with the radial terms of an earlier refinement in ``report``."""
    radial = [change["radial_k1"] for change in report.get("changes", [])] or [0.0] * len(given)
    return pose_and_lens_changes(given, refined, np.array(radial))
