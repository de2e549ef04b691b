# SPDX-License-Identifier: Apache-2.0
"""Who leaves every picture and may have come back, by what they wear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.association.returned import returns, tell_returned
from studiorecon.scene.people import Detections

LAYOUT = LAYOUTS["coco17"]
# Where keypoints lie, in heights of the person from the top; who they belong to is drawn about them.
SHAPE = {
    "shoulder": (0.11, 0.2),
    "elbow": (0.14, 0.36),
    "hip": (0.07, 0.52),
    "knee": (0.07, 0.74),
    "ankle": (0.07, 0.96),
}
FRAMES, HEIGHT, WH = 60, 80.0, (160, 120)
RED_AND_BLUE = {"shoulder": (200, 40, 40), "elbow": (190, 50, 40), "hip": (30, 40, 140), "knee": (30, 40, 140)}
GREEN = {"shoulder": (40, 150, 60), "elbow": (40, 150, 60), "hip": (90, 80, 70), "knee": (90, 80, 70)}
DARKER = {name: tuple(round(0.92 * c) for c in colour) for name, colour in RED_AND_BLUE.items()}


def keypoints(x: float) -> np.ndarray:
    found = np.zeros((17, 3))
    for k, name in enumerate(LAYOUT.keypoints):
        side, _, part = name.partition("_")
        if part in SHAPE:
            across, down = SHAPE[part]
            found[k] = x + HEIGHT * across * (1 if side == "left" else -1), 20 + HEIGHT * down, 0.9
    return found


def draw(picture: np.ndarray, points: np.ndarray, clothes: dict[str, tuple[int, int, int]]) -> None:
    for name, below in (("shoulder", "hip"), ("elbow", "hip"), ("hip", "knee"), ("knee", "ankle")):
        places = [points[LAYOUT.index(f"{side}_{name}")] for side in ("left", "right")]
        end = points[LAYOUT.index(f"left_{below}"), 1]
        left, right = (sorted(p[0] for p in places)[k] + sign * 6 for k, sign in ((0, -1), (1, 1)))
        picture[int(places[0][1]) : int(end) + 4, max(int(left), 0) : int(right)] = clothes[name]


def film(
    folder: Path, who: dict[int, tuple[range, float, dict[str, tuple[int, int, int]]]], light: float = 1.0
) -> tuple[Detections, Path]:
    """Detections and film of one camera; track → frames, place and clothes."""
    pictures = np.full((FRAMES, WH[1], WH[0], 3), 128, np.uint8)
    rows = []
    for track, (frames, x, clothes) in who.items():
        for t in frames:
            points = keypoints(x + 0.2 * t)
            draw(pictures[t], points, clothes)
            rows.append((t, track, points))
    noise = np.random.default_rng(0).normal(0, 4, pictures.shape)
    path = folder / f"{light}.mkv"
    write_lossless(path, np.clip(light * pictures + noise, 0, 255).astype(np.uint8), 15.0)
    rows.sort(key=lambda row: row[:2])
    frame, track, points = (np.array(column) for column in zip(*rows))
    return Detections(f"cam{light}", LAYOUT.name, frame, track, points), path


def told(folder: Path, who: dict[int, tuple[range, float, dict[str, tuple[int, int, int]]]]) -> list:
    """By two cameras, of which one has another exposure."""
    views = [film(folder, who, light) for light in (1.0, 0.7)]
    given = [detections for detections, _ in views]
    whose = {(d.camera, track): f"p{track}" for d in given for track in who}
    return returns(given, whose, [path for _, path in views])


def test_who_comes_back_in_the_same_clothes_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = told(
        tmp_path, {0: (range(20), 30, RED_AND_BLUE), 1: (range(60), 80, GREEN), 2: (range(35, 60), 10, DARKER)}
    )
    assert [(one.earlier, one.later, one.left, one.back) for one in found] == [("p0", "p2", 19, 35)]
    tell_returned(found, 15.0)
    assert (
        "p2, who comes in frame 35, wears what p0 wore, who left in frame 19, 1.1 s before" in capsys.readouterr().out
    )


def test_who_comes_in_other_clothes_is_somebody_else(tmp_path: Path) -> None:
    assert not told(tmp_path, {0: (range(20), 30, RED_AND_BLUE), 2: (range(35, 60), 10, GREEN)})


def test_where_two_wear_the_same_nothing_is_said(tmp_path: Path) -> None:
    """Two in one kit are there together; a third may be either."""
    who = {0: (range(20), 30, RED_AND_BLUE), 1: (range(60), 110, RED_AND_BLUE), 2: (range(35, 60), 10, DARKER)}
    assert not told(tmp_path, who)


def test_everybody_comes_back_as_one(tmp_path: Path) -> None:
    who = {k: (range(20 * k, 20 * k + 12), 30, RED_AND_BLUE) for k in range(3)}
    assert [(one.earlier, one.later) for one in told(tmp_path, who)] == [("p0", "p1"), ("p1", "p2")]


def test_pictures_are_read_only_where_somebody_comes_after_somebody(tmp_path: Path) -> None:
    together, _ = film(tmp_path, {0: (range(40), 30, RED_AND_BLUE), 1: (range(39, 60), 80, RED_AND_BLUE)})
    assert returns([together], {(together.camera, k): f"p{k}" for k in range(2)}, [tmp_path / "missing.mkv"]) == []
