# SPDX-License-Identifier: Apache-2.0
"""enhance: the films that compare."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.enhance import comparison
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.scene.path import PathStep, write_path

from tests.made.enhance_folder import VIEW, Warmer, panning, played
from tests.made.scene import ring


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Folder with six panning pictures and what came of them, as the files of a shot."""
    raw = panning(6)
    write_lossless(tmp_path / "orbit.mkv", raw, 10.0)
    write_lossless(tmp_path / "enhanced.mkv", played(raw, Warmer()), 10.0)
    write_path(tmp_path / "orbit.json", [PathStep(VIEW, float(k), "a") for k in range(6)], 10.0)
    return tmp_path


def test_films_that_compare_show_the_photo_where_there_is_one(film: Path, tmp_path: Path) -> None:
    cameras = ring([0, 90], "cam", wh=(96, 64))
    photos = {
        c.name: [np.full((64, 96, 3), 40 * i + 10 * k, np.uint8) for k in range(3)] for i, c in enumerate(cameras)
    }
    for name, frames in photos.items():
        write_lossless(tmp_path / f"{name}.mkv", frames, 10.0)
    steps = [PathStep(c, float(k), c.name) for c in cameras for k in range(3)]
    write_path(tmp_path / "heldout.json", steps, 10.0)
    options = {
        "render": film / "orbit.mkv",
        "video": film / "enhanced.mkv",
        "videos": [tmp_path / "cam0.mkv", tmp_path / "cam1.mkv"],
    }
    films = {"beside": tmp_path / "beside.mp4", "wipe": tmp_path / "wipe.mp4"}
    comparison.run(shot="heldout", render_path=tmp_path / "heldout.json", **options, **films)
    beside = read_stack(films["beside"]).astype(int)
    assert beside.shape == (6, 64 + 24, 3 * 96 + 8, 3)
    for index, (name, k) in enumerate((c.name, k) for c in cameras for k in range(3)):
        assert abs(beside[index, 30:80, 210:280].mean() - photos[name][k].mean()) < 4
    assert read_stack(films["wipe"]).shape == (6, 64, 96, 3)
    comparison.run(shot="orbit", render_path=film / "orbit.json", **options, **films)
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
