# SPDX-License-Identifier: Apache-2.0
"""``studiorecon.load``: a finished scene as arrays, whole or with a sentence about who is missing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import studiorecon
from studiorecon.errors import UserError
from studiorecon.footage.video import read_frame, to_bytes
from studiorecon.scene.decisions import Decision, write_decisions
from studiorecon.scene.files import read_json, write_json, write_npz
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import PathStep, write_path
from studiorecon.scene.people import write_people
from studiorecon.splatting.rigid_object import RigidObject, write_objects

from tests.made.scene import FPS, FRAMES, write_scene


def results(folder: Path, root: Path, people: int) -> Path:
    """``results/made`` of a small scene: who is listed, one film, and one loose thing that the survey asked for."""
    cameras = write_scene(folder, root, people, filmed=False)
    if people:
        listed = [(f"p{i}", FRAMES, "cam0,cam1", 1.0, "keypoints") for i in range(people)]
        write_people(folder / "people/people.tsv", listed)
    write_path(folder / "render/orbit.json", [PathStep(cameras["training"][0], 1.5, "00")] * 3, FPS)
    (folder / "render/orbit.mkv").write_bytes(b"film")
    (folder / "render/room.light.json").write_text("{}")
    ball = read_ply(folder / "background/scene.ply").take(np.arange(20))
    centres = np.tile([0.1, 0.2, 0.3], (FRAMES, 1))
    known = np.ones(FRAMES, bool)
    write_objects(
        folder / "objects/objects.npz",
        [RigidObject("o0", ball, np.zeros(20, np.uint8), centres, known, known, 0.1)],
        FRAMES,
    )
    verdict(folder, "on")
    return folder


def verdict(folder: Path, messages: str) -> None:
    decided = Decision("dynamic_objects", "", 1.0, None, 0.5, "on" if messages == "on" else "off", "")
    write_decisions(folder / "survey/decisions.json", [decided])


@pytest.mark.parametrize("people", [0, 2])
def test_a_scene_is_read_whole(tmp_path: Path, root: Path, people: int) -> None:
    scene = studiorecon.load(str(results(tmp_path, root, people)))
    assert (scene.name, scene.capture.fps, scene.capture.frames) == ("made", FPS, FRAMES)
    assert [c.name for c in scene.cameras] == ["cam0", "cam1", "cam2", "cam3"]
    assert scene.provenance.shape == (scene.room.count,)
    assert set(scene.provenance.tolist()) == {0, 1, 2}
    assert [p.person for p in scene.people] == [f"p{i}" for i in range(people)]
    assert [step.frame for step in scene.paths["orbit"]] == [1.5] * 3
    assert list(scene.paths) == ["orbit"], "the light is no film"
    assert [thing.posed(2.5).count for thing in scene.things] == [20]
    for person in scene.people:
        assert person.poses.shape == (FRAMES, 72)
        assert np.abs(person.posed(0).means_m.mean(axis=0)[:2] - person.trans[0, :2]).max() < 0.3


def test_things_that_the_survey_no_longer_asks_for_are_not_read(tmp_path: Path, root: Path) -> None:
    folder = results(tmp_path, root, 0)
    assert [thing.person for thing in studiorecon.load(folder).things] == ["o0"]
    verdict(folder, "off")
    assert not studiorecon.load(folder).things


def test_who_has_no_gaussians_is_said_and_left_out(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture, caplog: pytest.LogCaptureFixture
) -> None:
    folder = results(tmp_path, root, 3)
    (folder / "humans/p1.ply").unlink()
    with caplog.at_level("INFO", "studiorecon"):
        scene = studiorecon.load(folder)
    assert [p.person for p in scene.people] == ["p0", "p2"]
    assert "p1 of scene made has no Gaussians" in caplog.text + capsys.readouterr().out


def test_what_does_not_belong_together_is_refused(tmp_path: Path, root: Path) -> None:
    with pytest.raises(UserError, match="holds no finished scene"):
        studiorecon.load(tmp_path / "nowhere")
    folder = results(tmp_path, root, 1)
    with pytest.raises(UserError, match=r"body model .*nobody\.npz is missing"):
        studiorecon.load(folder, body=tmp_path / "nobody.npz")
    manifest = read_json(folder / "capture/manifest.json")
    write_json(folder / "capture/manifest.json", {**manifest, "frames": 2})
    with pytest.raises(UserError, match=r"manifest\.json .*has 6 frames .*the scene 2"):
        studiorecon.load(folder)
    write_json(folder / "capture/manifest.json", manifest)
    write_npz(folder / "background/provenance.npz", {"provenance": np.zeros(3, np.uint8)})
    with pytest.raises(UserError, match=r"provenance\.npz .*\(3,\)"):
        studiorecon.load(folder)


def test_the_readme_s_lines_run(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    written = re.search(r"```python\n(import studiorecon\n.*?)```", (root / "README.md").read_text(), re.DOTALL)
    assert written
    results(tmp_path / "results/demo", root, 1)
    monkeypatch.chdir(tmp_path)
    exec(compile(written.group(1), "README.md", "exec"), {})
    assert f"({FRAMES}, 72)" in capsys.readouterr().out


def test_a_picture_of_the_scene_is_what_its_cameras_filmed(tmp_path: Path, root: Path) -> None:
    folder = results(tmp_path, root, 2)
    write_scene(folder, root, 2)
    scene = studiorecon.load(folder)
    camera = scene.cameras[1]
    drawn = studiorecon.draw(scene, camera, 2, without=["o0"])
    filmed = read_frame(folder / f"capture/{camera.name}.mkv", 2)
    np.testing.assert_array_equal(to_bytes(drawn.rgb), filmed)
    assert drawn.depth_m.shape == drawn.alpha.shape == filmed.shape[:2]
    alone = studiorecon.draw(scene, camera, 2, without=["o0", "p0", "room"], background_rgb=(1.0, 1.0, 1.0))
    assert 0 < float((alone.alpha > 0.5).mean()) < 0.3, "one person"
    np.testing.assert_array_equal(alone.rgb[alone.alpha == 0], 1.0)
    between = studiorecon.draw(scene, camera, 1.5).rgb
    assert np.abs(between - drawn.rgb).max() > 0.1, "somebody moves, and the thing is there"


@pytest.mark.parametrize(
    ("frame", "without", "words"),
    [(99, [], "frames 0 to"), (-1, [], "frames 0 to"), (0, ["p7"], "has no p7; it has room, p0")],
)
def test_what_is_not_there_cannot_be_drawn(
    tmp_path: Path, root: Path, frame: float, without: list[str], words: str
) -> None:
    scene = studiorecon.load(results(tmp_path, root, 1))
    with pytest.raises(UserError, match=words):
        studiorecon.draw(scene, scene.cameras[0], frame, without)
