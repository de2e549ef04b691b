# SPDX-License-Identifier: Apache-2.0
"""Folders of pictures, scores and finished scenes that lead to a sentence: done as it advises, they are compared."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import studiorecon
from studiorecon.footage.video import write_lossless
from studiorecon.report.metrics.films import first_frames
from studiorecon.report.metrics.truth import read_truth
from studiorecon.report.score import score
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.path import PathStep, write_path
from studiorecon.sweep.page import run as show_sweep

from tests.made.remedies import follow_row
from tests.made.scene import FPS, FRAMES, ring
from tests.package.test_results import results

Call = Callable[[Path], Any]
SCORE, FOLDERS = "report/score.py", "report/metrics/folders.py"
ROOT = Path(__file__).resolve().parents[2]


def films(*names: str, folder: str = "renders", frames: int = 3, wh: tuple[int, int] = (64, 48)) -> Call:
    def write(at: Path) -> None:
        for name in names:
            write_lossless(at / f"{folder}/{name}.mkv", [np.zeros((wh[1], wh[0], 3), np.uint8)] * frames, 10.0)

    return write


def scores(renders: Call, masks: Call | None = None, one: str = "renders") -> Call:
    def call(at: Path) -> None:
        films("a", folder="truth")(at)
        renders(at)
        if masks is not None:
            masks(at)
        score(at / one, at / "truth", None if masks is None else at / "masks")

    return call


def two_versions(at: Path) -> None:
    films("a")(at)
    shutil.copy(at / "renders/a.mkv", at / "renders/a.avi")


def film_path(frames: int, name: str = "cam0") -> Call:
    def call(at: Path) -> None:
        results(at, ROOT, 0)
        camera = ring([0], "cam")[0]
        write_path(at / "held.json", [PathStep(camera, float(f), name) for f in range(frames)], FPS)
        first_frames(at / "held.json", [camera], read_manifest(at / "capture/manifest.json"))

    return call


def loaded(at: Path) -> Any:
    return studiorecon.load(results(at / "x", ROOT, 1))


def drawn(frame: float, without: tuple[str, ...] = ()) -> Call:
    def call(at: Path) -> None:
        scene = loaded(at)
        studiorecon.draw(scene, scene.cameras[0], frame, without)

    return call


MASKED = scores(films("a"), films("a", folder="masks"))
# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    (f"{SCORE} score 1", scores(films("b")), scores(films("a"))),
    (f"{SCORE} score 2", scores(films("a"), films("b", folder="masks")), MASKED, scores(films("a"))),
    (f"{SCORE} score_camera.together 1", scores(films("a", frames=5)), scores(films("a", frames=3))),
    (f"{SCORE} score_camera.together 2", scores(films("a", wh=(32, 24))), scores(films("a"))),
    (f"{FOLDERS} cameras_in 1", scores(films("a"), one="gone"), scores(films("a"))),
    (f"{FOLDERS} cameras_in 2", scores(lambda at: (at / "renders").mkdir()), scores(films("a"))),
    (f"{FOLDERS} _lossless", scores(two_versions),
     scores(lambda at: (two_versions(at), films("camera", folder="truth")(at)), one="renders/a.mkv")),
    ("report/metrics/truth.py read_truth", lambda at: read_truth(at / "gone", 0), MASKED),
    ("report/metrics/films.py first_frames 1", film_path(FRAMES, "x"), film_path(FRAMES)),
    ("report/metrics/films.py first_frames 2", film_path(FRAMES - 1), film_path(FRAMES)),
    ("results.py load", lambda at: studiorecon.load(at / "gone"), loaded),
    ("results.py draw 1", drawn(0, ("p7",)), drawn(0, ("p0",)), drawn(0, ("room",))),
    ("results.py draw 2", drawn(99), drawn(0), drawn(FRAMES - 1)),
    ("body/model.py BodyModel.load", lambda at: studiorecon.load(results(at / "x", ROOT, 1), body=at / "gone.npz"),
     loaded),
    ("sweep/page.py run 1", lambda at: show_sweep([], at / "a.html", at / "a.csv"), lambda _: None),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_results_made_again_as_advised_are_compared(row: int, tmp_path: Path) -> None:
    follow_row(ROWS[row], tmp_path)
