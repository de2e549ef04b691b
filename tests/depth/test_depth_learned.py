# SPDX-License-Identifier: Apache-2.0
"""A network's depth: its calibration, its certainty in a scene, and whom it beats."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from studiorecon.depth.depth_edges import depth_edge_pixels, edge_sigma, sharpen_depth
from studiorecon.depth.fusion import NetworkTerm, label_with_network
from studiorecon.depth.learned import LearnedDepth, calibrate
from studiorecon.depth.stereo.photo_cost import Surface
from studiorecon.depth.stereo.plates import Picture

from tests.made.bent_depth import bent
from tests.made.networks import room_views

WH = (192, 108)


def view(k: int = 0) -> tuple[Picture, np.ndarray, np.ndarray]:
    """A picture, its true depth, and that of floor and walls alone."""
    camera, rgb, truth = room_views(WH)[k]
    box = cv2.morphologyEx(truth.astype(np.float32), cv2.MORPH_CLOSE, np.ones((61, 61)))
    return Picture(camera, rgb.astype(np.float32), np.ones(camera.hw, bool)), truth, box


def learned(estimate: np.ndarray, output: str = "auto", measured: np.ndarray | None = None) -> LearnedDepth:
    picture, truth, box = view()
    everywhere = np.ones(truth.shape, bool) if measured is None else measured
    found = calibrate(estimate, truth, everywhere, box, np.zeros_like(everywhere), picture.rgb, output)  # type: ignore[arg-type]
    assert found is not None
    return found[1]


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("stated", [False, True])
def test_a_bent_network_in_any_unit_ends_in_metres(inverse: bool, stated: bool) -> None:
    _, truth, _ = view()
    numbers = bent(truth, np.random.default_rng(5), inverse=inverse)
    found = learned(numbers, ("inverse" if inverse else "affine") if stated else "auto")
    off = np.abs(np.log(found.depth_m / truth))
    assert np.median(off) < 0.005, "the field follows a bend over half a picture"
    # It never claims less error than the room itself has, here half a per cent.
    assert 0.005 <= np.median(found.sigma) < 0.01


def test_metres_keep_their_zero_and_nothing_measured_determines_nothing() -> None:
    picture, truth, box = view()
    found = learned((truth / 1.3).astype(np.float32), "metric")
    np.testing.assert_allclose(np.median(found.depth_m / truth), 1, atol=0.01)
    nowhere = np.zeros(truth.shape, bool)
    assert calibrate(truth.astype(np.float32), truth, nowhere, box, nowhere, picture.rgb, "auto") is None


def test_a_network_that_is_wrong_about_everything_knows_little() -> None:
    truth = view()[1]
    other = bent(view(2)[1][:, ::-1], np.random.default_rng(0))
    right, wrong = learned(bent(truth, np.random.default_rng(0))), learned(other)
    near = 0.7 * truth
    assert np.median(wrong.misfit(near)) < 0.7 * np.median(right.misfit(near))
    assert np.median(wrong.sigma) > 2 * np.median(right.sigma)


def test_blurred_edges_return_to_the_photos() -> None:
    depth = np.full((90, 160), 4.0, np.float32)
    depth[30:70, 60:110] = 2.0
    rgb = np.where(depth[..., None] > 3, np.float32(0.8), np.float32(0.2)) * np.ones(3, np.float32)
    blurred = 1 / cv2.GaussianBlur(1 / depth, (0, 0), 1.0)
    assert np.abs(blurred / depth - 1).max() > 0.3
    np.testing.assert_allclose(sharpen_depth(blurred, rgb), depth, rtol=0.03)
    # There the network may show either surface; away from edges a blur changes nothing.
    sigma = edge_sigma(blurred)
    assert sigma[50, 60] == pytest.approx(np.log(2) / np.sqrt(12), rel=0.1)
    assert sigma[50, 85] == 0 == sigma[10, 10]
    # A crease is no edge.
    crease = 1 / np.broadcast_to(np.maximum(0.2, np.linspace(0, 0.5, 90))[:, None], (90, 160))
    assert not depth_edge_pixels(crease.astype(np.float32))[5:-5].any()


def labelled(wall_cost: float, network_m: float, sigma: float, outliers: float) -> int:
    """The label that a flat scene gets: 0 a wall at 4 m, 1 furniture (nowhere), 2 the network's surface."""
    picture, _, _ = view()
    shape = picture.camera.hw
    full = np.ones(shape, np.float32)
    walls = Surface(4 * full, wall_cost * full, np.full(shape, wall_cost < 0.3))
    nothing = Surface(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, bool))
    messages = np.full(shape, network_m, np.float32)
    network = Surface(messages, np.full(shape, 0.5, np.float32), np.zeros(shape, bool))
    belief = LearnedDepth(messages, np.full(shape, sigma, np.float32), outliers)
    everywhere = np.ones(shape, bool)
    (label,) = np.unique(label_with_network(picture, walls, nothing, network, belief, everywhere, NetworkTerm()))
    return int(label)


def test_the_network_speaks_where_nobody_else_does_and_loses_where_photos_contradict_it() -> None:
    assert labelled(0.3, 3.0, 0.02, 0.1) == 2
    assert labelled(0.3, 3.98, 0.02, 0.1) == 0, "a wall that it agrees with is more precise"
    assert labelled(0.0, 3.0, 0.02, 0.9) == 0
    assert labelled(0.3, 3.0, 0.3, 0.1) == 0, "one that is unsure by a third"
    assert labelled(0.3, 3.0, 0.02, 0.95) == 0, "one that missed the objects that are known"
