# SPDX-License-Identifier: Apache-2.0
"""MoGe's ends: infinite depth, field of view, and upstream's own network, tiny and random, where its sources are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters.moge import fov_deg, infer, postprocess, preprocess
from studiorecon.models.loading import load

from tests.made.networks import upstream_sources


def test_infinite_depth_becomes_unknown() -> None:
    depth = np.array([[1.0, np.inf, 3.0], [-2.0, 0.0, 5.0]], np.float32)
    mask = np.array([[True, True, False], [True, True, True]])
    # Naive: +inf goes on and becomes a wall at GEN3C's cut of 100, or a median that is infinite.
    np.testing.assert_array_equal(postprocess(depth, mask), [[1, 0, 0], [0, 0, 5]])


@pytest.mark.parametrize(
    ("depth", "sentence"),
    [
        (np.full((3, 4), np.inf), "sees no surface"),
        (np.full((3, 4), np.nan), "12 depths that are no numbers"),
        (np.ones((1, 3, 4)), "adapter follows another version"),
    ],
)
def test_nothing_or_nonsense_is_a_sentence(depth: np.ndarray, sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        postprocess(depth.astype(np.float32), np.ones((3, 4), bool))


def test_picture_and_field_of_view_are_what_upstream_reads() -> None:
    picture = np.zeros((6, 8, 3), np.uint8)
    picture[..., 0] = 255
    tensor = preprocess(picture)
    assert tensor.shape == (3, 6, 8)
    assert tensor.dtype == np.float32
    assert (tensor[0] == 1).all()
    # Degrees, of the width: a focal length of half the width sees a right angle.
    assert fov_deg(640.0, 1280) == pytest.approx(90.0)
    assert fov_deg(1000.0, 1280) == pytest.approx(65.238, abs=1e-3)


@pytest.mark.weights
@pytest.mark.filterwarnings("ignore:In CPU autocast")
def test_upstreams_network_with_random_weights(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("utils3d", reason="utils3d is not installed")
    upstream_sources("microsoft+MoGe")
    from moge.model.v2 import MoGeModel

    torch.manual_seed(0)
    common = {"num_res_blocks": [0] * 5, "resamplers": ["bilinear"] * 4}
    head = {"dim_in": [32] * 5, "dim_res_blocks": [32] * 5, **common}
    settings = {
        "encoder": {"backbone": "dinov2_vits14", "intermediate_layers": [5, 11], "dim_out": 32},
        "neck": {"dim_in": [34, 2, 2, 2, 2], "dim_out": None, "dim_res_blocks": [32] * 5, **common},
        "points_head": {**head, "dim_out": [None] * 4 + [3]},
        "mask_head": {**head, "dim_out": [None] * 4 + [1]},
        "scale_head": {"dims": [384, 32, 1]},
        "remap_output": "exp",
    }
    (tmp_path / "moge").mkdir()
    torch.save(
        {"model_config": settings, "model": MoGeModel(**settings).state_dict()}, tmp_path / "moge/moge-2-vitl-normal.pt"
    )
    network = load("monocular depth", "moge", tmp_path, "cpu")._network
    picture = np.random.default_rng(0).random((70, 98, 3), dtype=np.float32)
    depth, mask = infer(network, preprocess(picture), 60.0, "cpu", num_tokens=48)
    assert depth.shape == mask.shape == (70, 98)
    assert np.isinf(depth[~mask]).all()
    assert np.isfinite(depth[mask]).all()
