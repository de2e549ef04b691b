# SPDX-License-Identifier: Apache-2.0
"""enhance: the sheet that shows how a picture was made, and the films that compare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.configuration import settings as settings_module
from studiorecon.enhance import comparison
from studiorecon.enhance import sheet as enhance_sheet
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.scene.decisions import write_decisions
from studiorecon.scene.effects import INJECTION
from studiorecon.scene.path import PathStep, write_path

from tests.made.enhance_folder import VIEW, Warmer, panning, played
from tests.made.enhance_limits import PAPER
from tests.made.scene import ring


@pytest.fixture
def film(tmp_path: Path) -> tuple[Path, list[np.ndarray]]:
    """Six panning pictures and what came of them, as the files of a shot."""
    raw = panning(6)
    made = played(raw, Warmer())
    write_lossless(tmp_path / "orbit.mkv", raw, 10.0)
    write_lossless(tmp_path / "enhanced.mkv", made, 10.0)
    write_path(tmp_path / "orbit.json", [PathStep(VIEW, float(k), "a") for k in range(6)], 10.0)
    return tmp_path, made


def test_the_sheet_shows_what_happened(film: tuple[Path, list[np.ndarray]], default_settings: Callable) -> None:
    folder, made = film
    settings = settings_module.load(enhance_sheet.Settings, default_settings("enhance"), "enhance")
    settings = replace(settings, injection=PAPER)
    decisions = folder / "orbit.decisions.json"
    options = {"render": folder / "orbit.mkv", "render_path": folder / "orbit.json", "video": folder / "enhanced.mkv"}
    options["decisions"] = decisions
    write_decisions(decisions, [INJECTION.decide(0.5, (0.4, 0.6), "it flickers")])
    for picture, rows in ((0, 1), (1, 2), (5, 2)):
        image = folder / f"orbit.{picture}.steps.png"
        enhance_sheet.run(settings, shot="orbit", picture=picture, image=image, **options)
        shown = cv2.imread(str(image))[..., ::-1]
        width = 96
        assert shown.shape == (rows * (64 + 22), width * (6 if picture == 5 else 5), 3)
        output = shown[22 : 22 + 64, 3 * width : 4 * width]
        np.testing.assert_array_equal(output, made[picture])
        blended = shown[22 : 22 + 64, 2 * width : 3 * width].astype(float)
        # What this enhancer does to its input is known, so the input on the sheet can be checked: it is the one that
        # was used.
        expected = np.clip(blended + 255 * np.array([0.02, 0.0, -0.01]), 0, 255)
        assert np.abs(expected - output).max() <= 1.01
    with pytest.raises(UserError, match="pictures 0 to 5, not 6"):
        enhance_sheet.run(settings, shot="orbit", picture=6, image=folder / "x.png", **options)
    # Of a film without earlier outputs there is one row.
    write_decisions(decisions, [INJECTION.decide(0.0, (0.0, 0.0), "it does not")])
    enhance_sheet.run(settings, shot="orbit", picture=5, image=folder / "plain.png", **options)
    assert cv2.imread(str(folder / "plain.png")).shape[0] == 64 + 22


def test_flow_is_coloured_by_direction_and_grey_where_it_fails() -> None:
    flow = np.zeros((4, 6, 2), np.float32)
    flow[:, :2, 0], flow[:, 2:4, 0] = 5.0, -5.0
    valid = np.ones((4, 6), bool)
    valid[0] = False
    colours, longest = enhance_sheet.flow_picture(flow, valid)
    assert longest == pytest.approx(5)
    assert (colours[0] == 128).all()
    assert (colours[1:, 4:] == 255).all(), "no motion is white"
    right, left = colours[1, 0].astype(int), colours[1, 2].astype(int)
    assert np.abs(right - left).max() > 200
    assert enhance_sheet.flow_picture(flow, np.zeros((4, 6), bool))[1] == 0.0


def test_films_that_compare_show_the_photo_where_there_is_one(
    film: tuple[Path, list[np.ndarray]], tmp_path: Path
) -> None:
    folder, _ = film
    cameras = ring([0, 90], "cam", wh=(96, 64))
    photos = {
        c.name: [np.full((64, 96, 3), 40 * i + 10 * k, np.uint8) for k in range(3)] for i, c in enumerate(cameras)
    }
    for name, frames in photos.items():
        write_lossless(tmp_path / f"{name}.mkv", frames, 10.0)
    steps = [PathStep(c, float(k), c.name) for c in cameras for k in range(3)]
    write_path(tmp_path / "heldout.json", steps, 10.0)
    options = {
        "render": folder / "orbit.mkv",
        "video": folder / "enhanced.mkv",
        "videos": [tmp_path / "cam0.mkv", tmp_path / "cam1.mkv"],
    }
    films = {"beside": tmp_path / "beside.mp4", "wipe": tmp_path / "wipe.mp4"}
    comparison.run(shot="heldout", render_path=tmp_path / "heldout.json", **options, **films)
    beside = read_stack(films["beside"]).astype(int)
    assert beside.shape == (6, 64 + 24, 3 * 96 + 8, 3)
    for index, (name, k) in enumerate((c.name, k) for c in cameras for k in range(3)):
        assert abs(beside[index, 30:80, 210:280].mean() - photos[name][k].mean()) < 4
    assert read_stack(films["wipe"]).shape == (6, 64, 96, 3)
    comparison.run(shot="orbit", render_path=folder / "orbit.json", **options, **films)
    assert read_stack(films["beside"]).shape == (6, 64 + 24, 2 * 96 + 4, 3), "nobody took photos from an orbit"


def test_a_wipe_shows_both_and_travels() -> None:
    black, white = np.zeros((40, 100, 3), np.uint8), np.full((40, 100, 3), 255, np.uint8)
    picture = comparison.wipe_picture(black, white, 0.3, ("a", "b"))
    assert not picture[39, :28].any()
    assert (picture[39, 32:] == 255).all()
    shares = [comparison.wipe_share(k, 30.0) for k in range(120)]
    assert shares[0] == 0.5
    assert min(shares) > 0.04
    assert max(shares) < 0.96
    assert np.abs(np.diff(shares)).max() < 0.03
