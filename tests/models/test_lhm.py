# SPDX-License-Identifier: Apache-2.0
"""LHM's ends: photos it can read, its command line with a stand-in, its file in our order, and the choice of the
photo."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.humans import canonical, photo
from studiorecon.models.adapters import lhm
from studiorecon.models.adapters.lhm import command_for, postprocess, preprocess, result_file
from studiorecon.models.loading import load
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.people import write_people


def standing(
    hw: tuple[int, int] = (480, 640), top: int = 40, height: int = 400, width: int = 150
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    mask = np.zeros(hw, bool)
    mask[top : top + height, 200 : 200 + width] = True
    return rng.integers(0, 200, (*hw, 3), dtype=np.uint8), mask


def person(height_m: float = 1.7, bands: int = 4, broken: int = 0) -> Gaussians:
    rng = np.random.default_rng(1)
    count = 500
    means = rng.uniform([-0.5, -height_m / 2, -0.1], [0.5, height_m / 2, 0.1], (count, 3))
    means[:broken] = np.nan
    return Gaussians(
        means,
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full((count, 3), -4.0),
        np.zeros(count),
        rng.normal(0, 1, (count, bands, 3)),
    )


def test_the_person_stands_alone_on_white_and_upright() -> None:
    photo, mask = standing()
    picture = preprocess(photo, mask)
    height, width = picture.shape[:2]
    assert height >= 1.25 * width
    assert width < height, "upstream asserts it"
    own = (picture != 255).any(axis=-1)
    assert own.sum() == mask.sum()
    np.testing.assert_array_equal(picture[own], photo[mask])
    assert not own[0].any()
    assert not own[-1].any()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"top": 80, "height": 400}, "touches the picture's border"),
        ({"top": 100, "height": 200}, "is 200 px high and LHM needs 300"),
        ({"top": 20, "height": 320, "width": 330}, "needs an upright person"),
        ({"top": 20, "height": 0}, "the mask is empty"),
    ],
)
def test_photos_that_upstream_would_skip_are_named(given: dict, sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        preprocess(*standing(**given))


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_upstreams_order_of_harmonics_becomes_ours(tmp_path: Path, bands: int) -> None:
    true = person(bands=bands)
    # As upstream writes: coefficient by coefficient, where the common layout has channel by channel.
    theirs = true.sh.copy()
    theirs[:, 1:] = true.sh[:, 1:].reshape(true.count, 3, bands - 1).transpose(0, 2, 1)
    write_ply(
        tmp_path / "p.ply", Gaussians(true.means_m, true.quaternions, true.log_scales, true.logit_opacities, theirs)
    )
    flat = true.sh[:, 1:].reshape(true.count, -1)
    read = read_ply(tmp_path / "p.ply")
    np.testing.assert_array_equal(read.sh[:, 1:].transpose(0, 2, 1).reshape(true.count, -1), flat)
    np.testing.assert_array_equal(postprocess(read).sh, true.sh)


def test_what_is_no_standing_person_is_refused() -> None:
    assert postprocess(person(broken=3)).count == 497
    with pytest.raises(UserError, match="50 of 500 Gaussians that are no numbers"):
        postprocess(person(broken=50))
    with pytest.raises(UserError, match=r"0\.29 m high along y"):
        postprocess(person(height_m=0.3))


def test_the_program_is_run_where_it_lives_and_its_silence_is_a_sentence(tmp_path: Path) -> None:
    write_ply(tmp_path / "made.ply", person())
    out = tmp_path / "out"
    script = (
        "import os, pathlib, shutil; assert pathlib.Path.cwd() == "
        f"pathlib.Path({str(tmp_path)!r}); os.makedirs({str(out)!r}); "
    )
    copy = f"shutil.copy({str(tmp_path / 'made.ply')!r}, {str(out / 'person.ply')!r})"
    assert result_file([sys.executable, "-c", script + copy], tmp_path, out) == out / "person.ply"
    with pytest.raises(UserError, match=r"status 0: body ratio is too small\); give it another photo"):
        result_file([sys.executable, "-c", "print('body ratio is too small')"], tmp_path, tmp_path / "none")
    command = command_for(Path("p.png"), Path("o"))
    assert command[1:4] == ["-m", "LHM.launch", "infer.human_lrm"]
    assert {"image_input=p.png", "mesh_dump=o/mesh_dump", "export_mesh=True", "motion_seqs_dir=None"} <= set(command)
    with pytest.raises(UserError, match="LHM-1B needs"):
        load("canonical avatar", "lhm", tmp_path, "cpu")


def test_the_best_photo_shows_the_person_whole_alone_and_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = np.zeros((2, 11, 60, 80), np.uint8)
    labels[0, :, 10:30, 10:20] = 1  # small, always good
    labels[1, :, 0:50, 10:30] = 1  # large, but cut off by the border …
    labels[1, 5, 0:5, 10:30] = 0  # … except here
    labels[1, 10, 0:5, 10:30] = 0
    labels[1, 10, 20:40, 30:40] = 2  # beside somebody else
    paths = [tmp_path / f"cam{i}.mkv" for i in range(2)]
    for path, mask in zip(paths, labels):
        write_lossless(path, mask, 24.0)
    assert photo.best_photo(paths, 1) == (1, 5)
    with pytest.raises(UserError, match="no frame shows this person whole"):
        photo.best_photo(paths, 3)

    write_people(tmp_path / "people.tsv", [("p0", 11, "a,b", 1.0, "keypoints")])
    films = [tmp_path / f"film{i}.mkv" for i in range(2)]
    for film in films:
        write_lossless(film, np.full((11, 60, 80, 3), (7, 8, 9), np.uint8), 24.0)
    photo.run("p0", tmp_path / "people.tsv", films, paths, tmp_path / "p0.photo.png")

    class Planted:
        def __init__(self, *_: object) -> None: ...

        def avatar(self, picture: np.ndarray, mask: np.ndarray) -> Gaussians:
            assert mask.sum() == 45 * 20
            assert (picture == (7, 8, 9)).all()
            return person(bands=1)

    monkeypatch.setattr(lhm, "ADAPTER", Planted)
    canonical.run(tmp_path / "p0.photo.png", tmp_path, tmp_path / "p0.canonical.ply")
    assert read_ply(tmp_path / "p0.canonical.ply").count == 500
