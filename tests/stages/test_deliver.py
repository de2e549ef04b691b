# SPDX-License-Identifier: Apache-2.0
"""deliver: what is exported can be read back, is described, and nothing stale stays."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studiorecon import settings as settings_module
from studiorecon.deliver import export
from studiorecon.errors import Refusal
from studiorecon.images.video import write_watchable
from studiorecon.scene.colmap import read_model
from studiorecon.scene.files import read_json
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.people import Person, write_person

from tests.stages.made_scene import FPS, FRAMES, render_options, write_scene


@pytest.fixture
def settings(default_settings: Callable) -> export.Settings:
    return settings_module.load(export.Settings, default_settings("deliver", still_frame=2), "deliver")


def options(folder: Path, people: int) -> dict:
    fits = [folder / f"people/p{i}.npz" for i in range(people)]
    for fit in fits:
        person = Person(
            fit.stem, "any", FPS, np.zeros((FRAMES, 72)), np.zeros((FRAMES, 3)), np.zeros(10), np.zeros((FRAMES, 24, 3)),
            np.ones(FRAMES, bool), np.zeros((FRAMES, 24)), True,
        )  # fmt: skip
        write_person(fit, person)
    write_watchable(folder / "enhance/orbit.mp4", [np.zeros((32, 32, 3), np.uint8)] * 2, FPS)
    render = render_options(folder, "orbit", people)
    return {
        **{name: render[name] for name in ("manifest", "model", "background", "gaussians", "avatars", "body")},
        "scene": "made",
        "fits": fits,
        "films": [folder / "enhance/orbit.mp4"],
        "contents": folder / "deliver/manifest.json",
    }


def test_everything_delivered_can_be_read_and_matches_its_digest(tmp_path: Path, root: Path, settings: export.Settings) -> None:
    cameras = write_scene(tmp_path, root, people=2, filmed=False)
    export.run(settings, **options(tmp_path, 2))
    folder = tmp_path / "deliver"
    files = read_json(folder / "manifest.json")["files"]
    on_disk = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}
    assert set(files) == on_disk
    for name, entry in files.items():
        data = (folder / name).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry["bytes"], entry["sha256"])
    background, people = read_ply(folder / "background.ply"), [read_ply(folder / f"people/p{i}.ply") for i in range(2)]
    assert read_ply(folder / "still.ply").count == background.count + sum(p.count for p in people)
    assert people[0].means_m.mean(axis=0)[2] == pytest.approx(1.0, abs=0.3), "the person stands on the floor of the world"
    assert [c.name for c in read_model(folder / "cameras")] == [c.name for c in cameras["training"]]
    for name in on_disk - {"README.txt"}:
        assert name.split("/")[0] in (folder / "README.txt").read_text()


def test_what_an_earlier_export_left_is_removed(tmp_path: Path, root: Path, settings: export.Settings) -> None:
    write_scene(tmp_path, root, people=1, filmed=False)
    chosen = options(tmp_path, 1)
    export.run(settings, **chosen)
    export.run(settings, **{**chosen, "gaussians": [], "avatars": [], "fits": [], "body": None})
    folder = tmp_path / "deliver"
    assert not list(folder.rglob("p0.*"))
    assert not (folder / "still.ply").exists()
    text = (folder / "README.txt").read_text()
    assert "0 people" in text
    assert "bodies/" not in text.split("What is not here")[0]


def test_a_still_beyond_the_end_shows_the_last_frame(tmp_path: Path, root: Path, default_settings: Callable) -> None:
    write_scene(tmp_path, root, people=1, filmed=False)
    late = settings_module.load(export.Settings, default_settings("deliver", still_frame=500), "deliver")
    export.run(late, **options(tmp_path, 1))
    assert read_json(tmp_path / "deliver/manifest.json")["still_frame"] == FRAMES - 1


def test_a_missing_film_is_named(tmp_path: Path, root: Path, settings: export.Settings) -> None:
    write_scene(tmp_path, root, people=0, filmed=False)
    chosen = options(tmp_path, 0)
    chosen["films"][0].unlink()
    with pytest.raises(Refusal, match=r"orbit\.mp4"):
        export.run(settings, **chosen)
