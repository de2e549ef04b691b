# SPDX-License-Identifier: Apache-2.0
"""enhance: cuts, clips that stand still, and any folder of pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon import __main__ as command_line
from studiorecon.configuration import settings as settings_module
from studiorecon.enhance import folder as enhance_folder
from studiorecon.enhance.backends import Unchanged
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.recursive.sequence import is_still
from studiorecon.scene.path import PathStep

from tests.made.enhance_folder import VIEW, panning, played, write_pictures


def test_a_cut_starts_the_injection_anew(capsys: pytest.CaptureFixture) -> None:
    first, second = panning(5, 3), panning(5, 4)
    together, alone = played(first + second, Unchanged()), played(second, Unchanged())
    for a, b in zip(together[5:], alone, strict=True):
        np.testing.assert_array_equal(a, b)
    assert "picture 5 of segment a follows a cut" in "".join(capsys.readouterr())
    played(first, Unchanged())
    assert "cut" not in "".join(capsys.readouterr()), "panning is no cut"


def test_pictures_of_two_sizes_are_refused() -> None:
    pictures = [*panning(2), np.zeros((32, 48, 3), np.uint8)]
    with pytest.raises(UserError, match="picture 2 of segment a is 48x32 and the one before it 96x64"):
        played(pictures, Unchanged())


def test_only_clips_without_motion_stand_still() -> None:
    steps = [PathStep(VIEW, 0.0, "a")] * 2 + [PathStep(VIEW, 0.0, "b")] * 2
    a, b = np.full((64, 96, 3), 50, np.uint8), np.full((64, 96, 3), 90, np.uint8)
    assert is_still(steps, [a, a, b, b]), "another segment is another clip"
    assert not is_still(steps, [a, b, b, b])
    assert is_still(steps[:1], [a])


@pytest.fixture
def settings(default_settings: Callable) -> enhance_folder.Settings:
    section = default_settings("enhance")
    return settings_module.load(enhance_folder.Settings, {**section, "enhancer": "none"}, "enhance")


def read(folder: Path) -> list[np.ndarray]:
    return [cv2.imread(str(p))[..., ::-1] for p in sorted(folder.glob("*.png"))]


def test_any_folder_is_steadied(tmp_path: Path, settings: enhance_folder.Settings) -> None:
    pictures = panning(8)
    source = write_pictures(tmp_path / "renders", pictures)
    enhance_folder.run(settings, source, None, tmp_path / "whole")
    whole = read(tmp_path / "whole")
    assert len(whole) == 8
    np.testing.assert_array_equal(whole[0], pictures[0])
    assert any((a != b).any() for a, b in zip(whole[1:], pictures[1:]))
    write_lossless(tmp_path / "renders.mkv", pictures, 10.0)
    enhance_folder.run(settings, tmp_path / "renders.mkv", None, tmp_path / "film")
    np.testing.assert_array_equal(np.stack(whole), np.stack(read(tmp_path / "film")))


def test_a_still_folder_comes_out_as_it_went_in(
    tmp_path: Path, settings: enhance_folder.Settings, capsys: pytest.CaptureFixture
) -> None:
    picture = panning(1)[0]
    enhance_folder.run(settings, write_pictures(tmp_path / "renders", [picture] * 4), None, tmp_path / "out")
    np.testing.assert_array_equal(np.stack(read(tmp_path / "out")), np.stack([picture] * 4))
    assert "does not move" in "".join(capsys.readouterr())


def test_folders_that_do_not_do_are_refused_by_name(tmp_path: Path, settings: enhance_folder.Settings) -> None:
    source = write_pictures(tmp_path / "renders", panning(4))
    two = write_pictures(tmp_path / "photos", panning(2))
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="2 references for 4 pictures"):
        enhance_folder.run(settings, source, two, tmp_path / "out")
    with pytest.raises(UserError, match="holds no pictures"):
        enhance_folder.run(settings, tmp_path / "empty", None, tmp_path / "out")
    with pytest.raises(UserError, match="neither a folder of pictures nor a video"):
        enhance_folder.run(settings, tmp_path / "nowhere", None, tmp_path / "out")
    with pytest.raises(UserError, match="needs cameras, depth"):
        enhance_folder.run(replace(settings, enhancer="residual"), source, None, tmp_path / "out")
    (source / "frame0002.png").write_bytes(b"broken")
    with pytest.raises(UserError, match=r"frame0002\.png is not a readable picture"):
        enhance_folder.run(settings, source, None, tmp_path / "out")


def test_by_hand_the_settings_come_from_a_configuration_file(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture
) -> None:
    text = (root / "config/config.yaml").read_text().replace("  enhancer: residual", "  enhancer: none")
    (tmp_path / "mine.yaml").write_text(text)
    source = write_pictures(tmp_path / "renders", panning(3))
    options = ["enhance.folder", "--pictures", str(source), "--output", str(tmp_path / "out")]
    assert command_line.main([*options, "--settings", str(tmp_path / "mine.yaml")]) == 0
    assert len(read(tmp_path / "out")) == 3
    assert command_line.main([*options, "--settings", str(tmp_path / "other.yaml")]) == 1
    assert "other.yaml is missing" in capsys.readouterr().err
