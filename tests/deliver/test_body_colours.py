# SPDX-License-Identifier: Apache-2.0
"""Bodies take the colours of the Gaussians trained on them; read back by trimesh and pygltflib."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.model import BodyModel
from studiorecon.deliver.body_colours import body_colours
from studiorecon.deliver.gltf import write_glb
from studiorecon.scene.gaussians import empty, sh_from_rgb
from studiorecon.scene.people import Person

from tests.made.scene import FPS, FRAMES, avatar

RED, BLUE = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.2, 0.7])


@pytest.fixture(scope="module")
def two_coloured(root: Path) -> Avatar:
    """Red above 0.0 m (the body's own y, which is up), blue below, where nothing was measured."""
    made = avatar(BodyModel.load(root / "resources/body.npz"), np.random.default_rng(2), "p0")
    above = made.gaussians.means_m[:, 1] > 0
    rgb = np.where(above[:, None], RED, BLUE)
    return replace(
        made, gaussians=replace(made.gaussians, sh=sh_from_rgb(rgb)[:, None]), provenance=np.where(above, 0, 1)
    )


def test_vertices_take_the_colour_and_the_mark_of_the_gaussians_beside_them(two_coloured: Avatar) -> None:
    found = body_colours(two_coloured)
    assert found is not None
    height_m = two_coloured.model.rest_vertices(two_coloured.betas)[:, 1]
    for there, rgb, mark in ((height_m > 0.25, RED, 0), (height_m < -0.25, BLUE, 1)):
        assert there.sum() > 500
        assert np.abs(found.rgb[there] - rgb).max() < 1e-5
        assert (found.provenance[there] == mark).all()


def test_faint_strays_colour_nothing(two_coloured: Avatar) -> None:
    own = two_coloured.gaussians
    rng = np.random.default_rng(5)
    faint = rng.random(own.count) < 0.25
    sh = np.where(faint[:, None, None], sh_from_rgb(rng.uniform(0, 1, (own.count, 3)))[:, None], own.sh)
    logits = np.where(faint, -12.0, 6.0)
    found = body_colours(replace(two_coloured, gaussians=replace(own, sh=sh, logit_opacities=logits)))
    height_m = two_coloured.model.rest_vertices(two_coloured.betas)[:, 1]
    assert found is not None
    assert np.abs(found.rgb[height_m > 0.25] - RED).max() < 0.02


def test_the_coloured_body_is_read_back_by_others(tmp_path: Path, two_coloured: Avatar) -> None:
    body, colours = two_coloured.model, body_colours(two_coloured)
    joints = body.joints(two_coloured.poses, two_coloured.betas, two_coloured.trans)
    motion = two_coloured.poses, two_coloured.trans, two_coloured.betas, joints, two_coloured.valid
    person = Person("p0", body.identity, FPS, *motion, np.zeros((FRAMES, 24)), True)
    write_glb(tmp_path / "p0.glb", person, body, colours)
    (mesh,) = trimesh.load(tmp_path / "p0.glb", process=False).geometry.values()
    assert len(mesh.vertices) == body.vertex_count
    stored = np.asarray(mesh.visual.vertex_attributes["color"])[:, :3] / 65535
    assert stored == pytest.approx(((colours.rgb + 0.055) / 1.055) ** 2.4, abs=1e-4), "vertex colours are linear"
    assert mesh.vertex_attributes["_PROVENANCE"][:, 0] == pytest.approx(colours.provenance)
    pygltflib = pytest.importorskip("pygltflib", reason="the group test brings pygltflib")
    document = pygltflib.GLTF2().load(str(tmp_path / "p0.glb"))
    assert document.materials[0].pbrMetallicRoughness.baseColorFactor == [1.0] * 4, "colours are not darkened"
    assert len(document.skins[0].joints) == 24
    times = document.accessors[document.animations[0].samplers[0].input]
    assert (times.count, times.max) == (FRAMES, [pytest.approx((FRAMES - 1) / FPS)])
    attributes = document.meshes[0].primitives[0].attributes
    assert attributes.JOINTS_0 is not None
    assert attributes.WEIGHTS_0 is not None


def test_a_person_without_gaussians_has_no_colours(two_coloured: Avatar) -> None:
    bare = replace(
        two_coloured,
        gaussians=empty(0),
        bones=two_coloured.bones[:0],
        weights=two_coloured.weights[:0],
        provenance=two_coloured.provenance[:0],
    )
    assert body_colours(bare) is None
