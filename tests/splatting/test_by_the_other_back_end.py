# SPDX-License-Identifier: Apache-2.0
"""What films and people are drawn and learned with, through gsplat's back end with float64 autograd in gsplat's place,
against the CPU's kernels."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.render import composite_renderer as render_canvas
from studiorecon.render.composite import Composite
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.splatting.cuda.rasterise import GsplatRasteriser

from tests.made.gsplat_stand_in import rasterization
from tests.made.humans import body, made
from tests.made.scene import avatar, ring, room

__all__ = ["body", "made"]


def gsplat(device: str, near_m: float, threads: int = 1) -> GsplatRasteriser:
    """In the place of ``splatting.device.rasteriser``."""
    return GsplatRasteriser(near_m=near_m, place="cpu", function=rasterization)


def test_a_film_s_pictures_and_layers(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    static = room(rng, 0.2).take(np.arange(203))  # not a whole number of blocks
    scene = Composite(static, rng.integers(0, 3, static.count).astype(np.uint8), [avatar(body, rng, "p0")])
    by_cpu, camera = CompositeRenderer(scene, 0.2), ring([30], "cam", wh=(40, 32))[0]
    monkeypatch.setattr(render_canvas, "rasteriser", gsplat)
    by_gsplat = CompositeRenderer(scene, 0.2, "cuda")
    for frame in (1.5,):
        (wanted, wanted_shares), (found, found_shares) = (
            c.draw(camera, frame, (0.1, 0.2, 0.3)) for c in (by_cpu, by_gsplat)
        )
        assert wanted.alpha.max() > 0.9
        for name in ("rgb", "alpha"):
            assert np.abs(getattr(found, name) - getattr(wanted, name)).mean() < 1e-5, name
        assert np.abs(found_shares - wanted_shares).mean() < 1e-5
        seen = wanted.alpha > 0.1
        np.testing.assert_allclose(found.depth_m[seen], wanted.depth_m[seen], rtol=1e-3)
    wanted_layers, found_layers = (c.layers(camera, 1.0) for c in (by_cpu, by_gsplat))
    assert wanted_layers.mattes[..., 1].max() > 0.5, "the person is seen"
    assert np.abs(found_layers.mattes - wanted_layers.mattes).mean() < 1e-5
    normals = [layers.rendering.normals for layers in (found_layers, wanted_layers)]
    assert np.abs(normals[0] - normals[1])[wanted_layers.rendering.alpha > 0.5].mean() < 1e-3
