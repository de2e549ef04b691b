# SPDX-License-Identifier: Apache-2.0
"""deliver.player from files to a page: its inputs, outputs and refusals; without a browser."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.deliver import player
from studiorecon.scene.factors import write_factors
from studiorecon.scene.files import write_npz
from studiorecon.scene.path import PathStep, write_path

from tests.made.player import PARTS
from tests.made.scene import FPS, FRAMES, WH, render_options, write_scene
from tests.made.steps import call

TAKEN = ("manifest", "model", "background", "provenance", "gaussians", "avatars", "body")


@pytest.fixture
def files(tmp_path: Path, root: Path) -> dict:
    cameras = write_scene(tmp_path, root, people=1)
    write_path(tmp_path / "render/orbit.json", [PathStep(c, 1.0, "00") for c in cameras["held_out"]], FPS)
    given = render_options(tmp_path, "orbit")
    return {name: given[name] for name in TAKEN} | {
        "objects": [],
        "paths": [tmp_path / "render/orbit.json"],
        "videos": [tmp_path / f"capture/{camera.name}.mkv" for camera in cameras["training"]],
        "exposure": [],
        "shade": [],
        "parts": PARTS,
        "page": tmp_path / "deliver/player.html",
        "poster": tmp_path / "deliver/player.jpg",
    }


def test_a_page_and_its_poster_come_out_and_the_same_bytes_again(files: dict, capsys: pytest.CaptureFixture) -> None:
    call(player.run, **files)
    reported = capsys.readouterr().out
    assert "people cast no shadows here" in reported
    assert f"1 people and 0 things over {FRAMES} frames" in reported
    page = files["page"].read_bytes()
    assert page.startswith(b"<!doctype html>")
    assert b"<!--" not in page, "every part of the page is filled in"
    poster = cv2.imread(str(files["poster"]))
    assert poster is not None
    assert poster.shape[1] / poster.shape[0] == pytest.approx(WH[0] / WH[1], abs=0.01)
    call(player.run, **files)
    assert files["page"].read_bytes() == page


def test_exposures_and_shadows_come_along(files: dict, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    write_factors(tmp_path / "gains.json", {"cam1": np.array([[0.8, 0.9, 1.0]])})
    at, factors = np.array([3, 5]), np.full((2, 2), 0.5)
    write_npz(tmp_path / "shade.npz", {"at": at, "times": np.array([0, FRAMES - 1]), "factors": factors})
    call(player.run, **files | {"exposure": [tmp_path / "gains.json"], "shade": [tmp_path / "shade.npz"]})
    assert "cast no shadows" not in capsys.readouterr().out
    text = files["page"].read_text(encoding="utf-8")
    assert text.count('"exposure":') == 1
    assert '"shade":' in text
