# SPDX-License-Identifier: Apache-2.0
"""What a sentence about a film's description advises is done here, and then the film is planned."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.planning import plan_steps
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep

from tests.made.remedies import follow
from tests.made.scene import FPS, ring, room

CAMERAS = ring([0, 90, 180, 270], "cam")
FRAMES = 9
SCALED = {"fl_x": 100, "w": 10, "h": 10, "frames": [{"transform_matrix": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()}]}
RIGID = {**SCALED, "frames": [{"transform_matrix": np.eye(4).tolist()}]}
KEYS = [{"picture": 0, "camera": "cam0"}, {"picture": 5, "camera": "cam1"}]

# The shot, how many cameras there are (training, held out), where it is said, and the same once that was done.
ROWS: dict[str, tuple[dict[str, Any], tuple[int, int], str, dict[str, Any], tuple[int, int]]] = {
    "unknown kind": ({"kind": "orbits"}, (4, 0), "render/kinds.py read_film_settings", {"kind": "orbit"}, (4, 0)),
    "held-out": ({"kind": "heldout"}, (4, 0), "render/planning.py plan_steps 2", {"kind": "heldout"}, (3, 1)),
    "one camera": ({"kind": "spline"}, (1, 0), "render/keyframes.py from_camera_to_camera",
        {"kind": "spline", "keys": [KEYS[0], KEYS[0] | {"picture": 4}]}, (1, 0)),
    "nothing to go around": ({"kind": "orbit"}, (1, 0), "render/orbit.py orbit_steps", {"kind": "orbit"}, (2, 0)),
    "a lost path": ({"kind": "path", "file": "gone"}, (4, 0), "render/path_file.py path_steps 1",
        {"kind": "path", "file": RIGID}, (4, 0)),
    "one key": ({"kind": "spline", "keys": KEYS[:1]}, (4, 0), "render/keyframes.py read_keys",
        {"kind": "spline", "keys": KEYS}, (4, 0)),
    "nobody's name": ({"kind": "orbit", "target": "p7"}, (4, 0), "render/look_at_targets.py LookAtTargets._of",
        {"kind": "orbit", "target": "p0"}, (4, 0)),
    "no such camera": ({"kind": "oscillate", "camera": "x"}, (4, 0), "render/moves.py camera_named",
        {"kind": "oscillate", "camera": "cam0"}, (4, 0)),
    "too near": ({"kind": "dolly_zoom", "camera": "cam1", "distances": [1.0, 0.01]}, (4, 0),
        "render/moves.py dolly_zoom_steps", {"kind": "dolly_zoom", "camera": "cam1", "distances": [1.0, 0.5]}, (4, 0)),
    "a scaled pose": ({"kind": "path", "file": SCALED}, (4, 0), "render/path_file.py _of_transforms",
        {"kind": "path", "file": RIGID}, (4, 0)),
}  # fmt: skip


def planned(shot: dict[str, Any], counts: tuple[int, int], folder: Path) -> Sequence[PathStep]:
    if isinstance(content := shot.get("file"), dict):
        (folder / "transforms.json").write_text(json.dumps(content))
        shot = shot | {"file": str(folder / "transforms.json")}
    training: list[Camera] = CAMERAS[: counts[0]]
    held_out = CAMERAS[counts[0] : sum(counts)]
    steady = np.tile([0.0, 0.0, 0.95], (FRAMES, 1))
    facing, there = np.tile([1.0, 0.0], (FRAMES, 1)), np.ones(FRAMES, bool)
    subjects = LookAtTargets({"p0": steady}, {"p0": facing}, {"p0": there}, np.array([0, 0, 1.0]), FRAMES, FPS)
    return plan_steps("shot", {"shot": shot}, 0, 0.3, training, held_out, subjects, room(np.random.default_rng(0), 0.4))


@pytest.mark.parametrize("row", ROWS)
def test_a_shot_described_as_advised_is_planned(row: str, tmp_path: Path) -> None:
    shot, counts, place, mended, enough = ROWS[row]
    follow(place, lambda: planned(shot, counts, tmp_path), lambda: planned(mended, enough, tmp_path))
