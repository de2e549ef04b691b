# SPDX-License-Identifier: Apache-2.0
"""A network of the user's own behind BlazePose: small networks of known answers stand in for RTMPose and ViTPose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from studiorecon.detector.blazepose import BlazePose, Landmarks
from studiorecon.detector.crops import Region
from studiorecon.detector.second_network import second_network
from studiorecon.detector.top_down import TopDown, choose_crop, points_from_heat_maps, points_from_simcc
from studiorecon.detector.tracking import keypoints_with_confidence
from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.machine.onnx_network import open_network

WH = (192, 256)
COCO = LAYOUTS["coco17"].keypoints
_MEAN, _DEVIATION = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])


def colours(count: int) -> np.ndarray:
    """(K, 3) colours far from one another: a cube's places, black left out."""
    steps = np.linspace(0, 255, 6)
    cube = np.array([[r, g, b] for r in steps for g in steps for b in steps])[1:]
    return cube[:: len(cube) // count][:count]


def written(path: Path, points: int, rows_of_scores: bool, sides: tuple[Any, Any] = (256, 192), **kind: Any) -> Path:
    """A network whose point k is where the crop has colour k: score exp(-distance² / 2000), in a heat map of a quarter
    of the crop's size or as its largest per column and per row, twice as many as pixels."""
    wanted = (colours(points) - _MEAN) / _DEVIATION
    # |c - w|² in raw colours = sum of deviation² (c² - 2 c w + w²) in normalised ones.
    weight = (_DEVIATION**2)[None]
    constant = {
        "square": np.repeat(weight, points, 0)[..., None, None],
        "linear": (-2 * weight * wanted)[..., None, None],
        "offset": (weight * wanted**2).sum(1)[None, :, None, None],
        "width": np.array(-1 / 2000),
    }
    held = [numpy_helper.from_array(v.astype(np.float32), name) for name, v in constant.items()]
    node = helper.make_node
    blur = {"kernel_shape": [21, 21], "pads": [10, 10, 10, 10], "strides": [1, 1]}
    nodes = [
        node("Mul", ["picture", "picture"], ["squares"]),
        node("Conv", ["squares", "square"], ["first"]),
        node("Conv", ["picture", "linear"], ["second"]),
        node("Add", ["first", "second"], ["sum"]),
        node("Add", ["sum", "offset"], ["apart"]),
        node("Mul", ["apart", "width"], ["exponent"]),
        node("Exp", ["exponent"], ["colour"]),
        # A disc is flat on top; blurred twice, its peak is its middle.
        node("AveragePool", ["colour"], ["blurred"], **blur),
        node("AveragePool", ["blurred"], ["score"], **blur),
    ]
    free = TensorProto.FLOAT
    if rows_of_scores:
        doubled = numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "doubled")
        nodes += [
            node("Resize", ["score", "", "doubled"], ["fine"], mode="linear"),
            node("ReduceMax", ["fine"], ["simcc_x"], axes=[2], keepdims=0),
            node("ReduceMax", ["fine"], ["simcc_y"], axes=[3], keepdims=0),
        ]
        held.append(doubled)
        outputs = [helper.make_tensor_value_info(name, free, None) for name in ("simcc_x", "simcc_y")]
    else:
        nodes.append(node("AveragePool", ["score"], ["heat"], kernel_shape=[4, 4], strides=[4, 4]))
        outputs = [helper.make_tensor_value_info("heat", free, None)]
    given = helper.make_tensor_value_info("picture", kind.get("type", free), ["batch", kind.get("channels", 3), *sides])
    graph = helper.make_graph(nodes, "stand-in", [given], outputs, held)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def painted(points: int, wh: tuple[int, int], radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A picture with a disc of colour k at each of (K, 2) places, which lie within its middle."""
    places = np.random.default_rng(5).uniform([0.3 * wh[0], 0.2 * wh[1]], [0.6 * wh[0], 0.8 * wh[1]], (400, 2))
    kept: list[np.ndarray] = []
    for place in places:
        if len(kept) < points and all(np.linalg.norm(place - other) > 2.5 * radius for other in kept):
            kept.append(place)
    assert len(kept) == points
    picture = np.zeros((wh[1], wh[0], 3), np.uint8)
    for place, colour in zip(kept, colours(points), strict=True):
        centre = np.round((place - 0.5) * 256).astype(int).tolist()
        cv2.circle(picture, centre, round(radius * 256), colour.tolist(), -1, cv2.LINE_AA, 8)
    return picture, np.array(kept)


def read(path: Path, layout: str) -> TopDown:
    return TopDown(open_network(path, "set detect.network to a readable file"), path, layout)


@pytest.mark.parametrize("rows_of_scores", [False, True], ids=["heat maps", "SimCC"])
@pytest.mark.parametrize("wh", [(640, 480), (2400, 1800)])
def test_points_come_back_in_pixels_of_the_picture(tmp_path: Path, rows_of_scores: bool, wh: tuple[int, int]) -> None:
    network = read(written(tmp_path / "stand_in.onnx", 17, rows_of_scores), "auto")
    assert (network.layout, network.wh) == ("coco17", WH)
    picture, places = painted(17, wh, 0.02 * wh[1])
    found = network.look(picture, places)
    # Pixels of the picture per pixel of the crop.
    scale = choose_crop(places, WH).scale
    assert np.linalg.norm(found[:, :2] - places, axis=1).max() < 3 * scale
    assert np.linalg.norm((found[:, :2] - places).mean(0)) < 0.5 * scale
    assert found[:, 2].min() > 0.02


def test_a_heat_map_s_peak_is_found_between_cells() -> None:
    rng = np.random.default_rng(2)
    truth = rng.uniform([20, 20], [170, 230], (30, 2))
    cells = (truth - 0.5) * (np.array([48, 64]) - 1) / (np.array(WH) - 1)
    y, x = np.mgrid[0:64, 0:48]
    heat = np.exp(-((x - cells[:, 0, None, None]) ** 2 + (y - cells[:, 1, None, None]) ** 2) / (2 * 2.0**2))
    np.testing.assert_allclose(points_from_heat_maps(0.8 * heat, WH)[:, :2], truth, atol=1e-6)
    assert points_from_heat_maps(np.zeros((1, 64, 48)), WH)[0, 2] == 0


def test_rows_of_scores_are_read_by_their_bins() -> None:
    columns, rows = np.zeros((2, 384)), np.zeros((2, 512))
    columns[0, 101], rows[0, 400], columns[1, 0], rows[1, 511] = 0.9, 0.7, 0.2, 0.4
    np.testing.assert_allclose(points_from_simcc(columns, rows, WH), [[51.0, 200.5, 0.7], [0.5, 256.0, 0.2]])


def test_a_crop_holds_everybody_s_head_whatever_their_shape() -> None:
    for low, high in (((100, 100), (200, 400)), ((100, 100), (900, 300)), ((5, 5), (5, 5))):
        crop = choose_crop(np.array([low, high], float), WH)
        half = crop.scale * np.array(WH) / 2
        assert (crop.centre - half <= low).all()
        assert (crop.centre + half >= high).all()


def test_where_both_know_a_point_the_better_network_says_where_it_is(root: Path, tmp_path: Path) -> None:
    region = Region(np.array([50.0, 50.0]), 80.0, 0.0)
    better = np.full((33, 3), np.nan)
    better[0], better[15] = [30, 40, 0.6], [-5, 10, 0.9]
    keypoints = np.column_stack([np.full((33, 2), 20.0), np.full(33, 0.5)])
    seen = Landmarks(keypoints, 0.9, np.zeros((33, 3)), np.zeros((128, 128), np.uint8), region, region, better)
    worth = {"visibility": [0.0, 1.0], "confidence": [0.0, 0.4]}
    found = keypoints_with_confidence(seen, (100, 100), worth)
    np.testing.assert_allclose(found[0], [30, 40, 0.6])
    np.testing.assert_allclose(found[1], [20, 20, 0.2])
    assert np.isnan(found[15, :2]).all()
    assert found[15, 2] == 0
    folder = root / "resources/detector"
    second = second_network([written(tmp_path / "stand_in.onnx", 17, True)], "coco17")
    assert second is not None
    looked = BlazePose(folder / "pose_landmark_full.onnx", second)
    assert second_network([], "auto") is None
    names = LAYOUTS["blazepose33"].keypoints
    assert {names[own] for own, _ in looked._shared} == set(COCO)


@pytest.mark.parametrize(
    ("points", "layout", "sides", "kind", "why"),
    [
        (25, "auto", (256, 192), {}, "may be body_25 or body_25b"),
        (21, "auto", (256, 192), {}, "layout is known"),
        (17, "halpe26", (256, 192), {}, "halpe26 has 26"),
        (17, "auto", ("height", "width"), {}, "export it again"),
        (17, "auto", (256, 9000), {}, "export it again"),
    ],
)
def test_what_is_no_such_network_is_refused(
    tmp_path: Path, points: int, layout: str, sides: tuple[Any, Any], kind: dict[str, Any], why: str
) -> None:
    path = written(tmp_path / "stand_in.onnx", points, False, sides, **kind)
    with pytest.raises(UserError, match=why):
        read(path, layout)


def test_files_that_are_none_are_refused(root: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="missing"):
        read(tmp_path / "nowhere.onnx", "auto")
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(UserError, match="cannot be read as an ONNX network"):
        read(tmp_path / "text.onnx", "auto")
    with pytest.raises(UserError, match="export it again"):
        read(root / "resources/detector/pose_landmark_full.onnx", "auto")


def test_25_points_are_read_as_stated(tmp_path: Path) -> None:
    assert read(written(tmp_path / "stand_in.onnx", 25, True), "body_25b").layout == "body_25b"
