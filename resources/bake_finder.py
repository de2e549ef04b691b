# SPDX-License-Identifier: Apache-2.0
"""Bake ``resources/detector/movenet_multipose.onnx`` from MoveNet's TensorFlow.js graph.

    python resources/bake_finder.py movenet-multipose.json movenet_multipose.onnx [PICTURE OUTPUTS.npz]

Needs tensorflow-cpu, tf2onnx, onnx and onnxruntime in an environment of their own, never the package's. Only the
convolutions become ONNX: six maps, a quarter of the picture's size. ``studiorecon.detector.movenet`` reads people off
them, because the graph itself stops at six. Prints the largest difference of each map to the graph on a random picture;
OUTPUTS takes PICTURE, shrunk, and the six people that the graph reads off it, for the tests.
"""

from __future__ import annotations

import base64
import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import tensorflow as tf
from bake_detector import OPSET, halved
from google.protobuf import json_format
from onnx import helper, numpy_helper

# Heads of the graph, and what the maps are called here.
MAPS = {
    "center_0/conv2d_4/BiasAdd": "centre",
    "box_scale_0/conv2d_5/BiasAdd": "box_size",
    "box_offset_0/conv2d_6/BiasAdd": "box_middle",
    "kpt_regress_0/conv2d_8/BiasAdd": "guess",
    "kpt_heatmap_0/conv2d_7/BiasAdd": "heat",
    "kpt_offset_0/conv2d_9/BiasAdd": "offset",
}
PREFIX = "StatefulPartitionedCall/"
# Size of the test's picture.
TEST_HW = 128, 224


class Converter:
    """The part of the graph above the maps, node by node."""

    def __init__(self, nodes: dict[str, dict], weights: dict[str, np.ndarray]) -> None:
        self.nodes, self.weights = nodes, weights
        self.made: dict[str, str] = {}
        self.onnx_nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []

    def constant(self, name: str, array: np.ndarray) -> str:
        self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def add(self, operator: str, inputs: list[str], name: str, **attributes: object) -> str:
        self.onnx_nodes.append(helper.make_node(operator, inputs, [name], name=name, **attributes))
        return name

    def value(self, name: str) -> str:
        """The ONNX name of what a node of the graph gives, channels before rows."""
        if name not in self.made:
            node = self.nodes[name]
            self.made[name] = getattr(self, node["op"].strip("_"))(name, node)
        return self.made[name]

    def Placeholder(self, name: str, node: dict) -> str:
        return self.add("Transpose", ["picture"], f"{name}_channels", perm=[0, 3, 1, 2])

    def Cast(self, name: str, node: dict) -> str:
        return self.value(node["input"][0])

    def _of_two(self, operator: str, name: str, node: dict) -> str:
        first, second = node["input"]
        if second in self.weights or self.nodes[second]["op"] in ("Const", "Reshape"):
            array = self.array(second).astype(np.float32)
            array = array.reshape(1, -1, 1, 1) if array.size > 1 else array.reshape(())
            return self.add(operator, [self.value(first), self.constant(f"{name}_by", array)], name)
        return self.add(operator, [self.value(first), self.value(second)], name)

    def array(self, name: str) -> np.ndarray:
        return self.weights[name] if name in self.weights else self.array(self.nodes[name]["input"][0])

    def Sub(self, name: str, node: dict) -> str:
        return self._of_two("Sub", name, node)

    def Mul(self, name: str, node: dict) -> str:
        return self._of_two("Mul", name, node)

    def AddV2(self, name: str, node: dict) -> str:
        return self._of_two("Add", name, node)

    def _convolution(self, name: str, node: dict, kernel: np.ndarray, group: int) -> str:
        edge, stride = kernel.shape[2], int(node["attr"]["strides"]["list"]["i"][1])
        # TensorFlow's SAME for sizes that the stride divides.
        low = 0 if edge == 1 else 2 - stride
        pads = [low, low, edge - 1 - low if edge > 1 and stride > 1 else low, 0]
        pads[3] = pads[2]
        inputs = [self.value(node["input"][0]), self.constant(f"{name}_kernel", kernel.astype(np.float32))]
        if len(node["input"]) > 2:
            inputs.append(self.constant(f"{name}_bias", self.array(node["input"][2]).astype(np.float32)))
        fused = [base64.b64decode(s).decode() for s in node["attr"].get("fused_ops", {}).get("list", {}).get("s", [])]
        out = self.add("Conv", inputs, name, group=group, pads=pads, strides=[stride, stride])
        if "Relu" in fused:
            return self.add("Relu", [out], f"{name}_relu")
        if "Relu6" in fused:
            bounds = [self.constant(f"{name}_{k}", np.array(v, np.float32)) for k, v in (("low", 0), ("high", 6))]
            return self.add("Clip", [out, *bounds], f"{name}_relu6")
        return out

    def FusedConv2D(self, name: str, node: dict) -> str:
        return self._convolution(name, node, self.array(node["input"][1]).transpose(3, 2, 0, 1), 1)

    def DepthwiseConv2dNative(self, name: str, node: dict) -> str:
        kernel = self.array(node["input"][1])
        return self._convolution(name, node, kernel.transpose(2, 3, 0, 1), kernel.shape[2])

    FusedDepthwiseConv2dNative = DepthwiseConv2dNative

    def ResizeBilinear(self, name: str, node: dict) -> str:
        scales = self.constant(f"{name}_scales", np.array([1, 1, 2, 2], np.float32))
        mode = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
        return self.add("Resize", [self.value(node["input"][0]), "", scales], name, **mode)


def read_graph(file: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """The graph's description and its weights."""
    described = json.loads(file.read_text())
    raw, offset, weights = file.with_suffix(".bin").read_bytes(), 0, {}
    for one in (w for group in described["weightsManifest"] for w in group["weights"]):
        kind = np.dtype(one.get("quantization", one)["dtype"])
        count = int(np.prod(one["shape"]))
        stored = np.frombuffer(raw, kind, count, offset).reshape(one["shape"])
        weights[one["name"]] = stored.astype(one["dtype"])
        offset += stored.nbytes
    return described["modelTopology"], weights


def original(topology: dict, weights: dict[str, np.ndarray], picture: np.ndarray, names: list[str]) -> list[np.ndarray]:
    """What TensorFlow itself makes of the graph for ``names`` of its nodes."""
    graph = tf.compat.v1.GraphDef()
    for node in topology["node"]:
        if node["op"] == "Const":
            array = weights[node["name"]]
            made = graph.node.add(name=node["name"], op="Const")
            made.attr["dtype"].type = tf.as_dtype(array.dtype).as_datatype_enum
            made.attr["value"].tensor.CopyFrom(tf.make_tensor_proto(array))
        elif node["op"] == "Placeholder":
            made = graph.node.add(name=node["name"], op="Placeholder")
            made.attr["dtype"].type = tf.int32.as_datatype_enum
        else:
            for step in unfused(node):
                json_format.ParseDict(step, graph.node.add())
    with tf.Graph().as_default() as made_graph:
        tf.import_graph_def(graph, name="")
        with tf.compat.v1.Session(graph=made_graph) as session:
            return session.run([f"{name}:0" for name in names], {"input:0": picture})


def unfused(node: dict) -> list[dict]:
    """The node, or the convolution, bias and activation that TensorFlow.js has in one and TensorFlow in three."""
    if "fused_ops" not in node.get("attr", {}):
        return [node]
    operator = "Conv2D" if node["op"] == "_FusedConv2D" else "DepthwiseConv2dNative"
    kept = {k: v for k, v in node["attr"].items() if k in ("T", "strides", "padding", "data_format", "dilations")}
    kind = {"T": node["attr"]["T"]}
    activations = [base64.b64decode(s).decode() for s in node["attr"]["fused_ops"]["list"]["s"][1:]]
    steps = [
        {"op": operator, "attr": kept, "input": node["input"][:2]},
        {"op": "BiasAdd", "attr": kind, "input": ["", node["input"][2]]},
        *({"op": activation, "attr": kind, "input": [""]} for activation in activations),
    ]
    for k, step in enumerate(steps):
        step["name"] = node["name"] if k == len(steps) - 1 else f"{node['name']}_{k}"
        if k:
            step["input"] = [steps[k - 1]["name"], *step["input"][1:]]
    return steps


def main(source: Path, target: Path, photo: Path | None = None, outputs: Path | None = None) -> None:
    """Convert, halve, write and compare."""
    topology, weights = read_graph(source)
    nodes = {node["name"]: node for node in topology["node"]}
    heads = {next(n for n in nodes if n.endswith(end)): name for end, name in MAPS.items()}
    converter = Converter(nodes, weights)
    given = helper.make_tensor_value_info("picture", onnx.TensorProto.FLOAT, [1, "height", "width", 3])
    results = []
    for head, name in heads.items():
        converter.add("Transpose", [converter.value(head)], name, perm=[0, 2, 3, 1])
        channels = len(weights[nodes[head]["input"][2]])
        results.append(helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, "rows", "columns", channels]))
    graph = helper.make_graph(converter.onnx_nodes, "movenet_multipose", [given], results, converter.initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
    onnx.save(halved(model), str(target))
    session = onnxruntime.InferenceSession(str(target), providers=["CPUExecutionProvider"])
    picture = np.random.default_rng(0).integers(0, 256, (1, 192, 320, 3))
    theirs = original(topology, weights, picture, list(heads))
    for name, ours, own in zip(MAPS.values(), session.run(None, {"picture": picture.astype(np.float32)}), theirs):
        print(f"{name} {ours.shape}: off by {np.abs(ours - own).max():.2g} of {np.abs(own).max():.3g}")
    if photo and outputs:
        shrunk = tf.image.resize(tf.image.decode_image(photo.read_bytes()), TEST_HW, "area").numpy()
        picture = np.rint(shrunk).astype(np.int32)[None]
        (people,) = original(topology, weights, picture, ["Identity"])
        np.savez_compressed(outputs, picture=picture[0].astype(np.uint8), people=people[0])
        print(people[0, :, -1])


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
