# SPDX-License-Identifier: Apache-2.0
"""render: objects in films, in front of and behind people, hidden while their position is unknown, and in no person's
mask.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.video import read_frame
from studiorecon.masks.loose_objects import subtract_objects
from studiorecon.render import layers as render_layers
from studiorecon.render import shot as render_shot
from studiorecon.render.composite import Composite
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.scene.gaussians import concatenate
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.discs import make_discs
from studiorecon.splatting.rigid_object import RigidObject, write_objects

from tests.made.render_layers import channels_of
from tests.made.scene import FRAMES, WH, avatar, render_options, ring, room, write_scene
from tests.made.steps import call

ABSENT, FILLED = 4, 2


def ball(centres_m: np.ndarray) -> RigidObject:
    """A green ball of 15 cm; its position is unknown in frame 4 and interpolated in frame 2."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = np.arange(len(centres_m))
    known = frames != ABSENT
    gaussians = make_discs(0.15 * normals, normals, np.tile([0.1, 0.9, 0.1], (500, 1)), 0.02, 0.3, 0.95, 0)
    places = np.where(known[:, None], centres_m, np.nan)
    return RigidObject(
        "o0", gaussians, np.full(500, MEASURED, np.uint8), places, known & (frames != FILLED), known, 0.15
    )


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    """Films with and without a ball between one camera and the walking person."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, filmed=False)
    section = default_settings("render")
    section["shots"] = {"heldout": {"kind": "heldout"}}
    settings = settings_module.load(render_shot.Settings, section, "render")
    eye = ring([45], "view")[0].centre_m
    write_objects(
        folder / "objects/objects.npz", [ball(np.tile([0.45 * eye[0], 0.45 * eye[1], 1.25], (FRAMES, 1)))], FRAMES
    )
    for name, objects in (("with", [folder / "objects/objects.npz"]), ("without", [])):
        options = render_options(folder, "heldout")
        options |= {key: folder / name / options[key].name for key in ("video", "truth", "depth", "path", "ledger")}
        call(render_shot.run, settings, **options, objects=objects)
    return folder


def seen(folder: Path, frame: int, kind: str = "heldout.mkv") -> np.ndarray:
    """Pixels of the first held-out camera's film that the ball changes."""
    first, second = (read_frame(folder / name / kind, frame).astype(int) for name in ("with", "without"))
    return np.abs(first - second).reshape(*first.shape[:2], -1).max(axis=-1) > 30


def test_a_thing_is_in_the_film_where_it_is_known_and_nowhere_else(films: Path) -> None:
    where = seen(films, 0)
    assert 100 < where.sum() < 1500
    assert read_frame(films / "with/heldout.mkv", 0)[where].mean(axis=0) == pytest.approx(
        [0.1 * 255, 0.9 * 255, 0.1 * 255], abs=25
    )
    assert not seen(films, ABSENT).any()
    depths = [read_frame(films / name / "heldout.depth.mkv", 0).astype(int)[where] for name in ("with", "without")]
    assert np.median(depths[0]) < np.median(depths[1]) - 300


def test_a_filled_position_is_inferred_a_measured_one_measured(films: Path) -> None:
    core = seen(films, 0)
    assert (read_frame(films / "with/heldout.truth.mkv", 0)[core] == 255).mean() > 0.9
    assert (read_frame(films / "with/heldout.truth.mkv", FILLED)[core] == 128).mean() > 0.9


def test_a_thing_has_its_own_matte(films: Path, default_settings: Callable) -> None:
    section = default_settings("render")
    section["shots"] = {"heldout": {"kind": "heldout"}}
    options = render_options(films, "heldout") | {"path": films / "with/heldout.json"}
    inputs = {
        name: options[name] for name in ("shot", "path", "background", "provenance", "gaussians", "avatars", "body")
    }
    settings = settings_module.load(render_layers.Settings, section, "render")
    call(render_layers.run, settings, **inputs, objects=[films / "objects/objects.npz"], folder=films / "layers")
    core = seen(films, 0)
    first, gone = channels_of(films / "layers/000000.exr"), channels_of(films / f"layers/{ABSENT:06d}.exr")
    assert first["matte.o0"][core].mean() > 0.9
    assert gone["matte.o0"].max() == 0
    assert first["matte.p0"].max() > 0.9
    together = sum(first[name].astype(np.float32) for name in first if name.startswith("matte."))
    np.testing.assert_allclose(together, first["A"].astype(np.float32), atol=4e-3)


def test_people_and_things_hide_each_other_as_in_one_rasterisation(root: Path) -> None:
    rng = np.random.default_rng(1)
    static, person = room(rng), avatar(BodyModel.load(root / "resources/body.npz"), rng, "p0")
    thing = ball(np.linspace([-0.5, 0.3, 1.0], [0.5, 0.3, 1.0], FRAMES))
    camera = ring([80], "c")[0]
    canvas = CompositeRenderer(Composite(static, np.zeros(static.count, np.uint8), [person], objects=[thing]), 0.2)
    for frame in (0, 1.5, ABSENT, 5):
        drawn, _ = canvas.draw(camera, frame, (0, 0, 0))
        alone = Rasteriser(near_m=0.2).forward(concatenate([static, person.posed(frame), thing.posed(frame)]), camera)
        np.testing.assert_allclose(drawn.rgb, alone.rgb, atol=1e-5)


def test_a_things_pixels_are_nobodys() -> None:
    camera = ring([0], "c")[0]
    thing = ball(np.tile([0.6, 0.0, 1.0], (FRAMES, 1)))
    labels, body = np.zeros((WH[1], WH[0]), np.uint8), np.zeros((1, WH[1], WH[0]), np.float32)
    labels[:, :64] = 1
    body[0, :40] = 2.4
    outline = thing.outline(camera, 0, 1.15) > 0
    depth_m = float(np.max(thing.outline(camera, 0)))
    assert depth_m < 2.0
    made = subtract_objects(labels, [thing], body, camera, 0)
    rows, columns = np.indices(labels.shape)
    assert (made[outline & (rows < 40)] == 255).all(), "it is before the body"
    assert (made[outline & (rows >= 40) & (columns < 64)] == 255).all(), "labelled as somebody, where nobody stands"
    assert (made[outline & (rows >= 40) & (columns >= 64)] == 0).all()
    assert (made[~outline] == labels[~outline]).all()
    nearer = subtract_objects(labels, [thing], np.where(body > 0, np.float32(0.8), 0), camera, 0)
    assert (nearer[rows < 40] == labels[rows < 40]).all(), "the body is before it"
    assert (subtract_objects(labels, [thing], body, camera, ABSENT) == labels).all()
    assert (replace(thing, radius_m=5.0).outline(camera, 0) == 0).all(), "the camera is inside it"
    assert thing.provenance.max() < INFERRED
