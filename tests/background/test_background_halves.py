# SPDX-License-Identifier: Apache-2.0
"""The room's training cut in two for a network that repairs views of it half-way: what goes through the files between,
and that what the network paints is learned."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.background import half, refined, train
from studiorecon.background.half_trained_files import read_half
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.models.protocols import Moment
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import read_path, write_path
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.background import cameras, capture, look, run, settings  # noqa: F401
from tests.made.steps import call

VIEWS = 6


class Painter:
    """Stands in for a network: shows every picture, brighter in red, and remembers which photos it was shown."""

    def __init__(self) -> None:
        self.shown: list[np.ndarray] = []

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        assert image.dtype == np.float32
        assert reference.dtype == np.float32
        self.shown.append(reference)
        return np.clip(image + np.float32([0.3, 0, 0]), 0, 1)


@pytest.fixture(scope="module")
def halved(
    settings: Callable[..., train.Settings], capture: dict, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Any]]:
    """The first half and its views as the stand-in repairs them."""
    tmp_path = tmp_path_factory.mktemp("halved")
    # The loss is absolute: what most pictures say is learned, so these are shown more often than the photos.
    own = settings(refinement={"views": VIEWS}, views_share=0.9)
    capture = capture | {"views": [], "supports": []}
    out = {"half": "half.ply", "provenance": "half.npz", "renders": "half.mkv", "renders_path": "half.json"}
    files = {name: tmp_path / file for name, file in out.items()}
    call(half.run, own, **capture, **files, working=tmp_path / "working")
    painter = Painter()
    patch = pytest.MonkeyPatch()
    patch.setattr(refined, "load", lambda *_, **__: painter)
    refined.run(
        "difix",
        json.dumps({"history": 0}),
        "dis",
        files["renders"],
        files["renders_path"],
        capture["model"],
        capture["plates"],
        [],
        tmp_path,
        "cpu",
        tmp_path / "refined.mkv",
    )
    given = [files["half"], files["provenance"], files["renders_path"], tmp_path / "refined.mkv"]
    yield {"settings": own, "capture": capture, "given": given, "painter": painter, "files": files}
    patch.undo()


def test_views_are_those_of_the_room_half_way_and_photos_the_nearest(halved: dict[str, Any]) -> None:
    steps, _ = read_path(halved["files"]["renders_path"])
    room = read_ply(halved["files"]["half"])
    pictures = read_stack(halved["files"]["renders"], 0, VIEWS)
    for step, picture in zip(steps, pictures, strict=True):
        drawn = Rasteriser(near_m=0.05, threads=1).forward(room, step.camera).rgb
        assert np.abs(np.clip(drawn, 0, 1) * 255 - picture).mean() < 1
    assert len(halved["painter"].shown) == VIEWS
    assert len({photo.tobytes() for photo in halved["painter"].shown}) > 2


def test_every_pixel_of_a_repaired_view_weighs_the_paper_s_share(halved: dict[str, Any]) -> None:
    room, provenance, targets = read_half(halved["given"], 0.7)
    assert len(provenance) == room.count
    assert len(targets) == VIEWS
    assert all((target.weight == np.float32(0.7)).all() for target in targets)


def test_what_the_network_paints_is_learned(halved: dict[str, Any], capture: dict, tmp_path: Path) -> None:
    plain, painted = tmp_path / "plain", tmp_path / "painted"
    run(halved["settings"], halved["capture"], plain)
    marks = run(halved["settings"], halved["capture"], painted, half=halved["given"])
    steps, _ = read_path(halved["files"]["renders_path"])
    drawing = Rasteriser(near_m=0.05, threads=1)
    rooms = [read_ply(folder / "scene.ply") for folder in (plain, painted)]
    assert len(marks) == rooms[1].count
    redder = [
        drawing.forward(rooms[1], s.camera).rgb.mean((0, 1)) - drawing.forward(rooms[0], s.camera).rgb.mean((0, 1))
        for s in steps
    ]
    assert np.mean(redder, axis=0)[0] > 0.03
    assert np.abs(np.mean(redder, axis=0)[1:]).max() < 0.02


def test_the_recursive_module_lets_views_enter_those_after_them(
    halved: dict[str, Any], capture: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the paper's main text refines the views by: repaired views, warped onto the next, are part of its input."""
    inputs: list[np.ndarray] = []

    class Kept(Painter):
        def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
            inputs.append(image)
            return np.clip(image + np.float32([0.1, 0, 0]), 0, 1)

    monkeypatch.setattr(refined, "load", lambda *_, **__: Kept())
    paper = {"strength": 0.3, "moving_strength": 0.3, "error_threshold": 255.0, "check": False, "whole_levels": False}
    looks = halved["files"]["renders"], halved["files"]["renders_path"]
    about = capture["model"], capture["plates"], [], tmp_path, "cpu", tmp_path / "recursive.mkv"
    # Along a path on which neighbours show the same: the views of one place.
    steps, fps = read_path(looks[1])
    still, still_path = tmp_path / "still.mkv", tmp_path / "still.json"
    write_lossless(still, iter([read_stack(looks[0], 0, 1)[0]] * 3), fps)
    write_path(still_path, [steps[0]] * 3, fps)
    refined.run("difix", json.dumps(paper), "dis", still, still_path, *about)
    # Two are asked for the gain first.
    first, second, third = inputs[2:]
    reds = [picture[..., 0].mean() for picture in (first, second, third)]
    assert reds[0] < reds[1] < reds[2], "earlier outputs, redder than the room, enter"
    assert reds[1] - reds[0] == pytest.approx(0.3 * 0.1, abs=0.01)


def test_files_that_do_not_belong_together_are_refused(halved: dict[str, Any], tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", provenance=np.zeros(3, np.uint8))
    with pytest.raises(UserError, match=r"other\.npz .*provenance .*\(3,\)"):
        read_half([halved["given"][0], tmp_path / "other.npz", *halved["given"][2:]], 0.7)


def test_without_views_there_is_no_half(settings: Callable[..., train.Settings], capture: dict, tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("half", "provenance", "renders", "renders_path")}
    with pytest.raises(UserError, match="it needs at least one view"):
        call(half.run, settings(), **capture, **files, working=tmp_path)
