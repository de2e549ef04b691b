# SPDX-License-Identifier: Apache-2.0
"""A camera path: camera and time for every frame of a film or a set of views."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studiorecon.scene.camera import CAMERA, Camera
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ListOf, frame_rate, real, record, text
from studiorecon.scene.step_files import read

_PATH = {"fps": frame_rate(), "steps": ListOf({"camera": CAMERA, "frame": real(low=0), "segment": text()})}


@dataclass(frozen=True)
class PathStep:
    """One picture of a path.

    Attributes:
        camera: the camera that takes the picture.
        frame: 0-based working frame that is shown (fractions between frames are allowed).
        segment: name of the part of the path this picture belongs to (``"00"``, or a camera name for ``heldout``).
    """

    camera: Camera
    frame: float
    segment: str


def write_path(path: Path, steps: list[PathStep], fps: float) -> None:
    write_json(
        path,
        {"fps": fps, "steps": [{"camera": s.camera.as_json(), "frame": s.frame, "segment": s.segment} for s in steps]},
    )


def read_path(path: Path) -> tuple[list[PathStep], float]:
    """The steps and the frame rate of a path file; raises UserError as ``step_files.read`` does."""
    value: dict[str, Any] = read(path, _PATH)
    steps = [PathStep(record(Camera, s["camera"]), float(s["frame"]), s["segment"]) for s in value["steps"]]
    return steps, float(value["fps"])
