# SPDX-License-Identifier: Apache-2.0
"""Bake ``resources/detector/*.onnx`` from the TFLite files of BlazePose and MediaPipe Hands.

    python resources/bake_detector.py pose_landmark_heavy.tflite pose_landmark_heavy.onnx [OLDER.onnx]

Needs tensorflow-cpu, tf2onnx, onnx and onnxruntime in an environment of their own, never the package's. Weights stay in
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

OPSET = 17


def opened(file: Path) -> tf.lite.Interpreter:
    """TFLite's interpreter of a file, without optimised kernels."""
    plain = tf.lite.experimental.OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES
    network = tf.lite.Interpreter(str(file), experimental_op_resolver_type=plain)
    network.allocate_tensors()
    return network


def original(file: Path, picture: np.ndarray) -> list[np.ndarray]:
    """Outputs on ``picture`` by TFLite's interpreter."""
    network = opened(file)
    network.set_tensor(network.get_input_details()[0]["index"], picture)
    network.invoke()
    return [network.get_tensor(out["index"]).copy() for out in network.get_output_details()]


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
    picture = np.random.default_rng(0).random(opened(source).get_input_details()[0]["shape"]).astype(np.float32)
    expected = original(source, picture)
    model, _ = tf2onnx.convert.from_tflite(str(source), opset=OPSET)
    onnx.save(halved(model), str(target))
    made = answers(target, picture)
    compared(f"{target.name} against {source.name}", made, expected)
    if older:
        compared(f"{target.name} against {older}", made, answers(older, picture))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
