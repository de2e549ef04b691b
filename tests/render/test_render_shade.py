# SPDX-License-Identifier: Apache-2.0
"""render.shade: the shadows of films, as a file for other renderers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.render import shade as render_shade
from studiorecon.render.room_light import Lamps, Light, write_light
from studiorecon.render.shot import read_composite
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.scene_files import SceneFiles

from tests.made.scene import FRAMES, render_options, write_scene
from tests.made.steps import call

LAMP_M = np.array([-1.2, 0.9, 2.6])


def lamp(kept: bool) -> Light:
    lamps = Lamps(LAMP_M[None], np.array([[0, 0, -1.0]]), np.array([0.3]))
    usual = lamps.falloff(np.zeros((1, 3)))[0]
    return Light(kept, "made", lamps, np.array([0.6]), usual, 0.0, 0.0, 0.1, 0.0, {"error": 0.01})


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, root: Path) -> dict:
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, people=1, filmed=False)
    given = render_options(folder, "orbit")
    named = {name: given[name] for name in ("manifest", "background", "provenance", "gaussians", "avatars", "body")}
    return named | {"light": folder / "room.light.json", "shade": folder / "room.shade.npz", "objects": []}


def shaded(files: dict, kept: bool) -> dict[str, np.ndarray]:
    write_light(files["light"], lamp(kept))
    call(render_shade.run, **files)
    with np.load(files["shade"]) as data:
        return dict(data)


def test_the_shade_is_the_one_of_films(files: dict) -> None:
    found = shaded(files, True)
    assert found["times"].tolist() == list(range(FRAMES))
    assert found["factors"].shape == (FRAMES, len(found["at"]))
    assert found["factors"].min() < 0.9
    scene = SceneFiles(*(files[name] for name in ("background", "provenance", "gaussians", "avatars", "body")))
    composite = read_composite(scene, "orbit", {}, [files["light"]])
    assert composite.shading is not None
    means = read_ply(files["background"]).means_m[found["at"]]
    for frame in (0, FRAMES - 1):
        assert np.abs(found["factors"][frame] - composite.shading.factor(float(frame))).max() < 1e-3
        # The darkest place of the floor is next to the person.
        person = composite.people[0].joints_m(float(frame))[0]
        darkest = means[found["factors"][frame].argmin()]
        assert np.linalg.norm((darkest - person)[:2]) < 1.5


def test_a_light_that_was_not_kept_shades_nobody(files: dict) -> None:
    found = shaded(files, False)
    assert len(found["at"]) == 0
    assert found["factors"].shape == (FRAMES, 0)
