# SPDX-License-Identifier: Apache-2.0
"""Somebody who was never there: cut out of a photo, made a person of by a network, and put into a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack
from studiorecon.humans import canonical, stranger
from studiorecon.images.encoded import write_png
from studiorecon.models.adapters import lhm
from studiorecon.render import shot as render_shot
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.scene.replacement_photos import photos_of_strangers

from tests.made.scene import render_options, write_scene
from tests.made.steps import call

NETWORKS = ("movenet_multipose.onnx", "pose_landmark_heavy.onnx")


@pytest.fixture(scope="module")
def networks(root: Path) -> list[Path]:
    return [root / "resources/detector" / name for name in NETWORKS]


def test_a_photo_with_alpha_becomes_a_performer_in_a_film(
    tmp_path: Path, root: Path, networks: list[Path], default_settings: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photo → cut → LHM (planted) → canonical .ply → film: the three steps on each other's files."""
    write_scene(tmp_path, root, people=1, filmed=False)
    own = read_avatar(
        tmp_path / "humans/p0.ply", tmp_path / "humans/p0.npz", BodyModel.load(root / "resources/body.npz")
    )
    rng = np.random.default_rng(1)
    photo = rng.integers(0, 255, (90, 60, 4), dtype=np.uint8)
    photo[..., 3] = 0
    photo[20:80, 20:40] = (30, 220, 30, 255)
    write_png(tmp_path / "anna.png", photo)

    class Planted:
        def __init__(self, *_: object) -> None: ...

        def avatar(self, picture: np.ndarray, mask: np.ndarray) -> Gaussians:
            """The performer's build in the mean colour of whoever the mask cuts out."""
            assert mask.sum() == 60 * 20
            colour = picture[mask].mean(axis=0) / 255
            sh = np.zeros_like(own.gaussians.sh)
            sh[:, 0] = (colour - 0.5) / SH_C0
            # LHM's own middle lies elsewhere.
            return replace(own.gaussians, sh=sh, means_m=own.gaussians.means_m + np.float32([0, 0.3, 0]))

    monkeypatch.setattr(lhm, "ADAPTER", Planted)
    cut, made = tmp_path / "stranger_anna.photo.png", tmp_path / "stranger_anna.canonical.ply"
    stranger.run("stranger_anna", tmp_path / "anna.png", networks, cut)
    canonical.run(cut, tmp_path, made)
    section = default_settings("render")
    films, orbit = [], section["shots"]["orbit"]
    for wanted in ({}, {"p0": "photos/anna.png"}):
        section["shots"] = {"guest": {**orbit, "frames": 2, "replace": wanted}}
        options = render_options(tmp_path, "guest")
        call(
            render_shot.run, settings_module.load(render_shot.Settings, section, "render"), **options, stand_ins=[made]
        )
        films.append((read_stack(options["video"]).astype(int), read_stack(options["truth"])))
    (plain, _), (guest, truth) = films
    there = np.abs(guest - plain).max(axis=-1) > 60
    assert there.sum() > 200
    assert (truth[there] == 0).mean() > 0.9, "nobody filmed that"
    assert (guest[there][:, 1] > guest[there][:, [0, 2]].max(axis=1)).mean() > 0.9, "in the photo's green"


def test_an_outline_follows_the_colours_where_the_detector_is_coarse() -> None:
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[0:300, 0:200]
    person = ((rows - 150) / 110) ** 2 + ((columns - 100) / 45) ** 2 < 1
    picture = np.where(person[..., None], (180, 60, 50), (70, 90, 130)) + rng.normal(0, 12, (300, 200, 3))
    picture = np.clip(picture, 0, 255).astype(np.uint8)
    # As coarse as a mask of 128 cells over a region: blurred by many pixels, and half a limb off.
    coarse = cv2.GaussianBlur(np.roll(person, 6, axis=1).astype(np.float32), (0, 0), 10)
    found = stranger.segment_person(picture, coarse)
    before = ((coarse > 0.5) & person).sum() / ((coarse > 0.5) | person).sum()
    assert before < 0.9
    assert (found & person).sum() / (found | person).sum() > 0.97


def test_photos_that_show_nobody_or_cut_nobody_out_are_refused(tmp_path: Path, networks: list[Path]) -> None:
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8), (0, 0), 2)
    write_png(tmp_path / "wall.png", noise)
    with pytest.raises(UserError, match=r"wall\.png shows no person"):
        stranger.run("stranger_wall", tmp_path / "wall.png", networks, tmp_path / "cut.png")
    write_png(tmp_path / "whole.png", np.dstack([noise, np.full((240, 320), 255, np.uint8)]))
    with pytest.raises(UserError, match="has an alpha channel without a person"):
        stranger.run("stranger_whole", tmp_path / "whole.png", networks, tmp_path / "cut.png")
    assert not (tmp_path / "cut.png").exists()


def test_two_strangers_of_one_name_are_refused() -> None:
    assert photos_of_strangers(["p1", "nobody", "a/anna.png", "her.ply", "a/anna.png"]) == {
        "stranger_anna": "a/anna.png"
    }
    with pytest.raises(UserError, match=r"a/anna\.png and b/anna\.jpg: rename one"):
        photos_of_strangers(["a/anna.png", "b/anna.jpg"])


@pytest.mark.real
@pytest.mark.slow
def test_a_man_in_a_gym_is_cut_out_of_a_picture(real_data: Path, networks: list[Path], tmp_path: Path) -> None:
    """A frame of footage as a photo: three people are seen, and the one in front is meant."""
    footage = cv2.VideoCapture(str(real_data / "pose2sim_balancing/single/videos/cam01.mp4"))
    footage.set(cv2.CAP_PROP_POS_FRAMES, 40)
    frame = footage.read()[1]
    write_png(tmp_path / "he.png", frame[..., ::-1])
    stranger.run("stranger_he", tmp_path / "he.png", networks, tmp_path / "cut.png")
    own = cv2.imread(str(tmp_path / "cut.png"), cv2.IMREAD_UNCHANGED)[..., 3] > 0
    pieces, _, sizes, _ = cv2.connectedComponentsWithStats(own.astype(np.uint8))
    # One whole man of about 800 px, as tall as he is in the picture, and skin and shorts alone.
    assert sizes[1:, cv2.CC_STAT_AREA].max() > 0.99 * own.sum()
    assert 760 < np.ptp(np.flatnonzero(own.any(axis=1))) < 850
    assert 0.25 < own.sum() / (np.ptp(np.flatnonzero(own.any(1))) * np.ptp(np.flatnonzero(own.any(0)))) < 0.5
    assert pieces > 1
