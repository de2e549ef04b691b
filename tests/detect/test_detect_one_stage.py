# SPDX-License-Identifier: Apache-2.0
"""A network of the user's own that sees everybody at once: small networks of known answers stand in for RTMO."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper
from studiorecon.detector.blazepose import BlazePose
from studiorecon.detector.one_stage import OneStage, landmark_agreements
from studiorecon.detector.second_network import second_network
from studiorecon.detector.top_down import TopDown
from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.machine.onnx_network import open_network

EDGE, PEOPLE, RADIUS = 256, 2, 5.0
COCO, LANDMARKS = LAYOUTS["coco17"].keypoints, LAYOUTS["blazepose33"].keypoints
SCORES = (0.9, 0.8)


def colours() -> np.ndarray:
    """(2, 17, 3) RGB, one per person and point, none of which is another's with red and blue exchanged."""
    steps = np.linspace(40, 255, 5)
    cube = np.array([[r, g, b] for r in steps for g in steps for b in steps if r > b])
    return cube[: PEOPLE * len(COCO)].reshape(PEOPLE, len(COCO), 3)


def written(
    path: Path, sides: tuple[Any, Any] = (EDGE, EDGE), points: int = 17, scores: tuple[float, ...] = SCORES
) -> Path:
    """A network whose point k of person p is where the square, in BGR, has colour (p, k)."""
    wanted = colours()[:, :points, ::-1].reshape(-1, 3)
    count = PEOPLE * points
    boxes = np.zeros((1, PEOPLE, 5), np.float32)
    boxes[0, :, 4] = scores
    held = {
        "linear": (-2 * wanted)[..., None, None].astype(np.float32),
        "ones": np.ones((count, 3, 1, 1), np.float32),
        "offset": (wanted**2).sum(1)[None, :, None, None].astype(np.float32),
        "width": np.array(-1 / 500, np.float32),
        "flat": np.array([1, count, -1], np.int64),
        "apart": np.array([1, PEOPLE, points, 1], np.int64),
        "edge": np.array(EDGE, np.int64),
        "told": boxes,
    }
    node = helper.make_node
    blur = {"kernel_shape": [9, 9], "pads": [4, 4, 4, 4], "strides": [1, 1]}
    nodes = [
        node("Mul", ["input", "input"], ["squares"]),
        node("Conv", ["squares", "ones"], ["first"]),
        node("Conv", ["input", "linear"], ["second"]),
        node("Add", ["first", "second"], ["sum"]),
        node("Add", ["sum", "offset"], ["distance"]),
        node("Mul", ["distance", "width"], ["exponent"]),
        node("Exp", ["exponent"], ["colour"]),
        # A disc is flat on top; blurred twice, its peak is its middle.
        node("AveragePool", ["colour"], ["blurred"], **blur),
        node("AveragePool", ["blurred"], ["score"], **blur),
        node("Reshape", ["score", "flat"], ["cells"]),
        node("ArgMax", ["cells"], ["where"], axis=2, keepdims=1),
        node("ReduceMax", ["cells"], ["sure"], axes=[2], keepdims=1),
        node("Mod", ["where", "edge"], ["column"]),
        node("Div", ["where", "edge"], ["row"]),
        node("Cast", ["column"], ["x"], to=TensorProto.FLOAT),
        node("Cast", ["row"], ["y"], to=TensorProto.FLOAT),
        node("Reshape", ["x", "apart"], ["xs"]),
        node("Reshape", ["y", "apart"], ["ys"]),
        node("Reshape", ["sure", "apart"], ["scores"]),
        node("Concat", ["xs", "ys", "scores"], ["keypoints"], axis=3),
        node("Identity", ["told"], ["dets"]),
    ]
    free = TensorProto.FLOAT
    given = helper.make_tensor_value_info("input", free, ["batch", 3, *sides])
    answers = [
        helper.make_tensor_value_info("dets", free, ["batch", "people", 5]),
        helper.make_tensor_value_info("keypoints", free, ["batch", "people", points, 3]),
    ]
    stored = [numpy_helper.from_array(value, name) for name, value in held.items()]
    graph = helper.make_graph(nodes, "stand-in", [given], answers, stored)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A picture of two people who stand close to one another, and (2, 17, 2) where their points are."""
    across = np.linspace(0, 2 * np.pi, len(COCO), endpoint=False)
    body = np.column_stack([60 * np.cos(3 * across), 170 * np.sin(across)]) + np.arange(len(COCO))[:, None] * [1.5, 0]
    places = body + np.array([[280.3, 230.7], [355.6, 238.2]])[:, None]
    picture = np.full((480, 640, 3), 20, np.uint8)
    for place, colour in zip(places.reshape(-1, 2), colours().reshape(-1, 3), strict=True):
        centre = np.round((place - 0.5) * 256).astype(int).tolist()
        cv2.circle(picture, centre, round(2.2 * RADIUS * 256), colour.tolist(), -1, cv2.LINE_AA, 8)
    return picture, places


def landmarks_of(points: np.ndarray) -> np.ndarray:
    """(33, 2) BlazePose's landmarks of somebody with COCO's ``points``; those that COCO does not know are at the
    nose."""
    return np.stack([points[COCO.index(name)] if name in COCO else points[0] for name in LANDMARKS])


def test_of_two_people_the_one_who_agrees_with_the_landmarks_counts(tmp_path: Path) -> None:
    network = second_network([written(tmp_path / "stand_in.onnx")], "auto")
    assert isinstance(network, OneStage)
    assert network.layout == "coco17"
    picture, places = scene()
    for truth in places:
        # The landmarks themselves are off by a few pixels.
        reported = truth + np.random.default_rng(1).normal(0, 4, truth.shape)
        found = network.look(picture, landmarks_of(reported))
        scale = 1.6 * np.ptp(landmarks_of(reported), axis=0).max() / EDGE
        off = found[:, :2] - truth
        # Discs hide one another at places.
        assert np.quantile(np.linalg.norm(off, axis=1), 0.8) < 2 * scale, off
        assert np.linalg.norm(np.median(off, axis=0)) < 0.7 * scale
        assert ((found[:, 2] >= 0) & (found[:, 2] <= 1)).all()
        assert np.median(found[:, 2]) > 0.1


def read(path: Path, layout: str) -> OneStage:
    return OneStage(open_network(path, ""), path, layout)


def test_where_nobody_agrees_or_nobody_is_sure_the_landmarks_stand(tmp_path: Path) -> None:
    picture, places = scene()
    elsewhere = landmarks_of(places[0] + [-90.0, 0.0])
    network = read(written(tmp_path / "stand_in.onnx"), "auto")
    assert np.isnan(network.look(picture, elsewhere)).all()
    unsure = read(written(tmp_path / "unsure.onnx", scores=(0.2, 0.1)), "auto")
    assert np.isnan(unsure.look(picture, landmarks_of(places[0]))).all()


def test_beyond_the_picture_it_is_grey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = read(written(tmp_path / "stand_in.onnx"), "auto")
    shown: list[np.ndarray] = []
    looked = network._run

    def noted(square: np.ndarray) -> list[np.ndarray]:
        shown.append(square.copy())
        return looked(square)

    monkeypatch.setattr(network, "_run", noted)
    network.look(np.full((100, 100, 3), 200, np.uint8), np.array([[0.0, 10.0], [40.0, 90.0]] * 17)[:33])
    (square,) = shown
    # The square's side is 128 about (20, 50): 44 of 128 lie to the left of the picture, 14 above it and below.
    assert (square[:, : 44 * EDGE // 128 - 1] == 114).all()
    assert (square[: 14 * EDGE // 128 - 1] == 114).all()
    assert (square[EDGE // 2, 44 * EDGE // 128 + 2 :] == 200).all()


def test_agreement_is_a_share_of_the_body() -> None:
    body = np.array([[0.0, 0.0], [0.0, 100.0]])
    off = np.array([0.0, 10.0, 50.0])[:, None, None] * [1.0, 0.0]
    np.testing.assert_allclose(landmark_agreements(body + off, body), [1, np.exp(-1), np.exp(-25)])
    np.testing.assert_allclose(landmark_agreements(10 * (body + off), 10 * body), landmark_agreements(body + off, body))
    assert landmark_agreements(np.zeros((2, 0, 2)), np.zeros((0, 2))).tolist() == [0, 0]


def test_it_stands_behind_the_detector_like_any_other(root: Path, tmp_path: Path) -> None:
    folder = root / "resources/detector"
    second = second_network([written(tmp_path / "stand_in.onnx")], "coco17")
    looked = BlazePose(folder / "pose_landmark_full.onnx", second)
    assert {LANDMARKS[own] for own, _ in looked._shared} == set(COCO)


@pytest.mark.parametrize(
    ("sides", "points", "layout", "why"),
    [
        ((256, 192), 17, "auto", "must take a square"),
        ((9000, 9000), 17, "auto", "must take a square"),
        ((EDGE, EDGE), 11, "auto", "layout is known"),
        ((EDGE, EDGE), 17, "halpe26", "halpe26 has 26"),
    ],
)
def test_what_is_no_such_network_is_refused(
    tmp_path: Path, sides: tuple[Any, Any], points: int, layout: str, why: str
) -> None:
    path = written(tmp_path / "stand_in.onnx", sides, points)
    with pytest.raises(UserError, match=why):
        second_network([path], layout)
    with pytest.raises(UserError, match="must return heat maps"):
        TopDown(open_network(path := written(tmp_path / "square.onnx"), ""), path, "auto")


def test_the_file_is_opened_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be hundreds of megabytes."""
    path, begun = written(tmp_path / "stand_in.onnx"), []
    session = onnxruntime.InferenceSession

    def counted(*about: Any, **more: Any) -> Any:
        begun.append(about[0])
        return session(*about, **more)

    monkeypatch.setattr(onnxruntime, "InferenceSession", counted)
    assert isinstance(second_network([path], "auto"), OneStage)
    assert begun == [str(path)]
