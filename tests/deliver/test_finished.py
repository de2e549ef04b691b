# SPDX-License-Identifier: Apache-2.0
"""The finished scene in memory equals its files, and broken Gaussians are refused before they are delivered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.deliver.finished import read_finished, require_finite
from studiorecon.errors import UserError
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import PathStep, write_path

from tests.made.scene import FPS, render_options, replace_gaussians, write_scene
from tests.made.steps import call

TAKEN = ("manifest", "model", "background", "provenance", "gaussians", "avatars", "body")


@pytest.fixture
def files(tmp_path: Path, root: Path) -> dict:
    cameras = write_scene(tmp_path, root, people=2, filmed=False)["training"]
    write_path(tmp_path / "render/orbit.json", [PathStep(cameras[0], 1.5, "00")], FPS)
    given = render_options(tmp_path, "orbit", people=2)
    return {name: given[name] for name in TAKEN} | {"paths": [tmp_path / "render/orbit.json"]}


def test_the_marks_of_another_room_are_refused(files: dict) -> None:
    write_npz(files["provenance"], {"provenance": np.zeros(3, np.uint8)})
    with pytest.raises(UserError, match=r"provenance\.npz .*\(3,\)"):
        call(read_finished, **files)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("whose", ["background", "p1"])
def test_a_gaussian_that_is_no_number_is_refused_in_one_sentence(files: dict, whose: str) -> None:
    path = files["background"] if whose == "background" else files["gaussians"][1]
    own = read_ply(path)
    means = own.means_m.copy()
    means[5, 1] = np.nan
    broken = replace(own, means_m=means)
    if whose == "background":
        write_ply(path, broken)
    else:
        replace_gaussians(path, files["avatars"][1], broken)
    with pytest.raises(UserError, match=rf"{path.name} holds 1 Gaussians.*number 5"):
        call(read_finished, **files)


def test_an_infinite_logit_is_an_opacity() -> None:
    zeros = np.zeros((2, 3))
    own = Gaussians(zeros, np.ones((2, 4)), zeros, np.array([np.inf, -np.inf]), np.zeros((2, 1, 3)))
    assert require_finite(own, Path("x.ply")) is own
