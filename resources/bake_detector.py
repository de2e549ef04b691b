# SPDX-License-Identifier: Apache-2.0
"""Bake ``resources/detector/*.onnx`` from BlazePose's TFLite files.

    python resources/bake_detector.py pose_detection.tflite resources/detector/pose_detection.onnx [OLDER.onnx]
    (and the landmarks' likewise)

Needs tensorflow-cpu, tf2onnx, onnx and onnxruntime in an environment of their own, never the package's. The detector
stores 38 tensors sparsely, which ONNX cannot: they are made dense by TFLite's own interpreter first. Weights stay in
half precision, as in the original, and are cast when the network is loaded. Prints the largest difference to the
original on one random picture, and that to an older file where one is named.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import tensorflow as tf
import tf2onnx
from tensorflow.core.framework import tensor_pb2
from tensorflow.python.framework import tensor_util
from tf2onnx import tflite_utils
from tf2onnx.handler import tfl_op

OPSET = 17


class DenseTensors:
    """Stands in for TensorFlow's tensor_util while tf2onnx reads a file: sparse constants come back dense, in the
    file's order."""

    def __init__(self, dense: list[np.ndarray]) -> None:
        self.waiting = list(dense)

    def MakeNdarray(self, tensor: tensor_pb2.TensorProto) -> np.ndarray:
        """The tensor's array; the next dense one where the stored bytes are too few for its shape."""
        shape = [d.size for d in tensor.tensor_shape.dim]
        whole = int(np.prod(shape, initial=1)) * tf.dtypes.as_dtype(tensor.dtype).size
        if not tensor.tensor_content or len(tensor.tensor_content) == whole:
            return tensor_util.MakeNdarray(tensor)
        array = self.waiting.pop(0)
        if list(array.shape) != shape:
            raise ValueError(f"a sparse tensor of shape {shape} meets a dense one of {array.shape}")
        return array

    def __getattr__(self, name: str) -> object:
        return getattr(tensor_util, name)


@tfl_op("TFL_DENSIFY", onnx_op="Identity")
class Densify:
    """What has been made dense needs no operator any more."""

    @classmethod
    def version_1(cls, ctx: object, node: object, **options: object) -> None:
        """Nothing to do."""


def original(file: Path, picture: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(outputs on ``picture``, dense forms of the sparse tensors in the file's order) by TFLite's interpreter."""
    plain = tf.lite.experimental.OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES
    network = tf.lite.Interpreter(
        str(file), experimental_op_resolver_type=plain, experimental_preserve_all_tensors=True
    )
    network.allocate_tensors()
    network.set_tensor(network.get_input_details()[0]["index"], picture)
    network.invoke()
    made_dense = {op["inputs"][0]: op["outputs"][0] for op in network._get_ops_details() if op["op_name"] == "DENSIFY"}
    dense = [network.get_tensor(made_dense[index]).copy() for index in sorted(made_dense)]
    return [network.get_tensor(out["index"]).copy() for out in network.get_output_details()], dense


def halved(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with every weight that half precision holds exactly stored so, and cast when it is loaded."""
    kept, casts = [], []
    for tensor in model.graph.initializer:
        array = onnx.numpy_helper.to_array(tensor)
        if (
            array.dtype == np.float32
            and array.size > 64
            and np.array_equal(array.astype(np.float16).astype(np.float32), array)
        ):
            kept.append(onnx.numpy_helper.from_array(array.astype(np.float16), f"{tensor.name}_half"))
            casts.append(
                onnx.helper.make_node("Cast", [f"{tensor.name}_half"], [tensor.name], to=onnx.TensorProto.FLOAT)
            )
        else:
            kept.append(tensor)
    nodes = [*casts, *model.graph.node]
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(kept)
    model.graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model


def answers(file: Path, picture: np.ndarray) -> list[np.ndarray]:
    """What an ONNX file gives on ``picture``."""
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    return session.run(None, {session.get_inputs()[0].name: picture})


def compared(name: str, ours: list[np.ndarray], theirs: list[np.ndarray]) -> None:
    """Print by how much each of ``ours`` differs from that of ``theirs`` with its shape."""
    for mine in ours:
        gaps = [float(np.abs(mine - other).max()) for other in theirs if other.shape == mine.shape]
        print(f"{name} {mine.shape}: off by {min(gaps):.2g} of {np.abs(mine).max():.3g}")


def main(source: Path, target: Path, older: Path | None = None) -> None:
    """Convert, halve, write and compare."""
    edge = 224 if "detection" in source.name else 256
    picture = np.random.default_rng(0).random((1, edge, edge, 3)).astype(np.float32)
    expected, dense = original(source, picture)
    tflite_utils.tensor_util = DenseTensors(dense)
    model, _ = tf2onnx.convert.from_tflite(str(source), opset=OPSET)
    onnx.save(halved(model), str(target))
    made = answers(target, picture)
    compared(f"{target.name} against {source.name}", made, expected)
    if older:
        compared(f"{target.name} against {older}", made, answers(older, picture))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
