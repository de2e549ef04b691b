# SPDX-License-Identifier: Apache-2.0
"""Statistics of a film, picture by picture: provenance, and where the path leaves the filmed space (``.tsv``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.render.composite import TRUTH_LEVELS, Composite, is_blocked
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_table
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

LEDGER_COLUMNS = ("picture", "segment", "frame", "measured", "inferred", "invented", "angle_deg", "near")


@dataclass(frozen=True)
class PictureStatistics:
    """One picture of a film.

    Attributes:
        measured, inferred, invented: shares of the picture, together 1.
        angle_deg: angle at the scene's centre to the nearest training camera; a large one shows unfilmed sides.
        near: the thing that the camera is in or touches: ``background``, a person's id, or empty.
    """

    picture: int
    segment: str
    frame: float
    measured: float
    inferred: float
    invented: float
    angle_deg: float
    near: str


def provenance_shares(truth: Integer[np.ndarray, "H W"]) -> tuple[float, float, float]:
    """Measured, inferred and invented share of a truth map (H, W) uint8."""
    counted = np.bincount(truth.ravel(), minlength=256)[TRUTH_LEVELS] / truth.size
    return float(counted[0]), float(counted[1]), float(counted[2])


def angles_deg(
    steps: Sequence[PathStep], training: Sequence[Camera], centre_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " pictures"]:
    """Angle at the centre between each picture's camera and the nearest training camera, by atan2 (I13)."""
    eyes = np.array([step.camera.centre_m for step in steps]) - centre_m
    filmed = np.array([camera.centre_m for camera in training]) - centre_m
    across = np.linalg.norm(np.cross(eyes[:, None], filmed[None]), axis=-1)
    return np.degrees(np.arctan2(across, eyes @ filmed.T).min(axis=1))


def nearby_obstacles(steps: Sequence[PathStep], scene: Composite, clearance_m: float) -> list[str]:
    """Per picture, the obstacle closer to the camera than ``clearance_m``: a person at that time, or the room."""
    eyes = np.array([step.camera.centre_m for step in steps])
    in_room = is_blocked(eyes, scene.background, clearance_m)
    names = []
    for step, eye, room in zip(steps, eyes, in_room):
        reached = [
            p.person
            for p in scene.people
            if np.linalg.norm(p.joints_m(step.frame) - eye, axis=1).min() < max(clearance_m, 0.2)
        ]
        names.append(reached[0] if reached else "background" if room else "")
    return names


def write_ledger(path: Path, entries: Sequence[PictureStatistics]) -> None:
    """Write a ledger as a table."""
    write_table(
        path,
        LEDGER_COLUMNS,
        [
            (
                e.picture,
                e.segment,
                f"{e.frame:g}",
                f"{e.measured:.4f}",
                f"{e.inferred:.4f}",
                f"{e.invented:.4f}",
                f"{e.angle_deg:.1f}",
                e.near,
            )
            for e in entries
        ],
    )
