# SPDX-License-Identifier: Apache-2.0
"""The poses of synthesised views: between every two neighbouring training cameras, in segments that share their ends.

Writes ``views/path.json`` (``scene.path``): segments "00", "01", … of ``views_per_segment`` + 1 views each, all at
frame 0. The survey decides which of them are made.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import axis_miss_rad, gaps_around, interpolate_cameras, scene_centre
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.names import segment_name
from studiorecon.scene.path import PathStep, write_path
from studiorecon.signature import Written


@dataclass(frozen=True)
class Settings:
    """Number of views and shape of the path."""

    views_per_segment: int = setting(
        12,
        "New views between neighbouring cameras.",
        minimum=1,
        maximum=10000,
        paper="120 (L = 481), appendix A; U17",
        paper_value=120,
    )
    rotations: Literal["slerp", "look_at"] = setting(
        "slerp",
        "slerp between the cameras; look_at = every view faces the scene centre.",
        paper="slerp",
        paper_value="slerp",
    )
    clearance: float = setting(
        1.0,
        "Minimum distance to the scene centre, as a share of the nearer camera's; closer paths become arcs.",
        minimum=0,
        maximum=1,
        paper="0; U19",
        paper_value=0.0,
    )


def plan_views(cameras: list[Camera], settings: Settings) -> tuple[list[PathStep], list[str]]:
    """All steps in the order of the path, and sentences on choices that had to be made."""
    centre_m, gaps = scene_centre(cameras), gaps_around(cameras)
    notes = [
        f"the scene's centre is ({centre_m[0]:.2f}, {centre_m[1]:.2f}, {centre_m[2]:.2f}) m; cameras in order "
        + ", ".join(cameras[gap.first].name for gap in gaps)
    ]
    steps = []
    for number, gap in enumerate(gaps):
        name, start, end = segment_name(number), cameras[gap.first], cameras[gap.second]
        views, bent = interpolate_cameras(
            start,
            end,
            settings.views_per_segment + 1,
            centre_m,
            rotations=settings.rotations,
            clearance=settings.clearance,
        )
        if bent:
            notes.append(
                f"segment {name} ({start.name} to {end.name}) follows an arc: the straight line passes too near the "
                "scene's centre"
            )
        steps += [PathStep(replace(view, name=f"{name}.{k:04d}"), 0.0, name) for k, view in enumerate(views)]
    if steps:
        miss = max(axis_miss_rad(step.camera, centre_m) for step in steps)
        notes.append(f"{len(gaps)} segments; the optical axis leaves the centre by at most {np.degrees(miss):.0f}°")
    return steps, notes


def run(settings: Settings, model: Path, manifest: Path, path: Written) -> None:
    """Plan the views between the training cameras."""
    cameras = read_model(model.parent)
    if not cameras:
        raise UserError(f"{model} holds no cameras; train: [...] in capture.yaml names those to reconstruct from")
    steps, notes = plan_views(cameras, settings)
    for note in notes:
        say(note)
    write_path(path, steps, read_manifest(manifest).fps)
