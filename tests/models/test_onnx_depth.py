# SPDX-License-Identifier: Apache-2.0
"""Depth networks in ONNX: sizes and outputs of any form, refusals, and upstream's own code, random, where it is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from studiorecon.errors import UserError
from studiorecon.images.sizes import resample_corners
from studiorecon.models.adapters.onnx_depth import DepthNetwork, anything_size, moge_depth, moge_size, resized_cubic
from studiorecon.models.catalogue.registry import find_card

from tests.made.networks import upstream_sources

PICTURE = (np.random.default_rng(3).random((40, 60, 3)) * 255).astype(np.uint8)


def written(path: Path, outputs: dict[str, tuple[int, ...]], sides: tuple = ("h", "w"), given: int = 1) -> Path:
    """A network whose every output is channel 0 of the picture plus 3, in a shape (0 = as the picture)."""
    nodes = [
        helper.make_node("Slice", ["picture", "zero", "one", "axis"], ["red"]),
        helper.make_node("Add", ["red", "three"], ["map"]),
    ]
    held = {"zero": np.array([0]), "one": np.array([1]), "axis": np.array([1]), "three": np.float32([3])}
    for name, shape in outputs.items():
        held[f"{name} shape"] = np.array(shape)
        nodes.append(helper.make_node("Reshape", ["map", f"{name} shape"], [name]))
    number = TensorProto.FLOAT
    pictures = [helper.make_tensor_value_info("picture", number, [1, 3, *sides])]
    pictures += [helper.make_tensor_value_info(f"more {k}", number, [1, 3, 2, 2]) for k in range(given - 1)]
    answers = [helper.make_tensor_value_info(name, number, None) for name in outputs]
    stored = [numpy_helper.from_array(value, name) for name, value in held.items()]
    graph = helper.make_graph(nodes, "stand-in", pictures, answers, stored)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


@pytest.mark.parametrize(
    ("sides", "shape"),
    [(("h", "w"), (1, 1, 518, 532)), (("h", "w"), (1, 518, 532)), ((28, 42), (1, 1, 28, 42)), ((28, 42), (28, 42))],
)
def test_a_map_of_any_shape_comes_at_the_pictures_size(tmp_path: Path, sides: tuple, shape: tuple) -> None:
    across = np.linspace(40, 200, 266, dtype=np.float32)
    picture = np.broadcast_to(across[None, :, None], (259, 266, 3)).astype(np.uint8)
    found = DepthNetwork(written(tmp_path / "mine.onnx", {"disparity": shape}, sides), "mine").depth(picture, None)
    assert found.shape == picture.shape[:2]
    red = (picture[..., 0].astype(np.float32) / 255 - 0.485) / 0.229 + 3
    np.testing.assert_allclose(found[:, 20:-20], red[:, 20:-20], atol=0.05)


def test_a_mask_removes_and_nothing_at_all_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "mine.onnx", {"depth": (1, 1, 28, 42), "mask": (1, 1, 28, 42)}, (28, 42))
    dark = np.zeros_like(PICTURE)  # 3 - 0.485 / 0.229 = 0.88, which the mask keeps
    assert (DepthNetwork(path, "mine").depth(dark, None) > 0).all()
    nodes = [helper.make_node("Mul", ["picture", "zero"], ["map"])]
    picture = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 1, 28, 42])
    answer = helper.make_tensor_value_info("map", TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "blind", [picture], [answer], [numpy_helper.from_array(np.float32([0]), "zero")])
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), tmp_path / "blind.onnx"
    )
    blind = DepthNetwork(tmp_path / "blind.onnx", "blind")
    blind._run = lambda picture: {"map": np.zeros((1, 28, 42), np.float32)}  # type: ignore[method-assign]
    with pytest.raises(UserError, match="sees no surface"):
        blind.depth(PICTURE, None)
    blind._run = lambda picture: {"row": np.zeros((1, 7), np.float32)}  # type: ignore[method-assign]
    with pytest.raises(UserError, match="answers with row"):
        blind.depth(PICTURE, None)


def test_what_is_no_depth_network_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(UserError, match="cannot be read as an ONNX network"):
        DepthNetwork(tmp_path / "text.onnx", "text")
    with pytest.raises(UserError, match="takes picture"):
        DepthNetwork(written(tmp_path / "two.onnx", {"depth": (1, 1, 2, 2)}, (2, 2), given=3), "two")


def test_sizes_are_whole_patches() -> None:
    assert anything_size((1080, 1920)) == (518, 924)
    assert anything_size((1920, 1080)) == (924, 518)
    rows, columns = moge_size((1080, 1920))
    assert rows % 14 == columns % 14 == 0
    assert 2400 < rows * columns / 14**2 < 2600


def test_moges_shift_is_what_projects_its_points() -> None:
    height, width, focal = 60, 90, 1.3
    half = np.hypot(height, width)
    u, v = np.meshgrid((2 * np.arange(width) + 1 - width) / half, (2 * np.arange(height) + 1 - height) / half)
    depth = 2 + 0.5 * np.sin(3 * u) + v**2
    points = np.stack([u * depth / focal, v * depth / focal, depth - 0.7], axis=-1).astype(np.float32)
    mask = u < 0.6
    for given in (focal, None):
        found = moge_depth(points, mask, given)
        np.testing.assert_allclose(found[mask], depth[mask], rtol=2e-3)
        assert not found[~mask].any()


def test_the_networks_of_a_laptop_are_pinned_and_need_no_gpu() -> None:
    for name in ("moge_vits", "moge_vitb", "depth_anything"):
        card = find_card(name)
        assert card.memory.gpu_gb is None
        assert card.runtime.image == "core"
        assert card.terms.commercial == "yes"
        assert all(len(file.sha256) == 64 and "/resolve/" in file.mirrors[0] for file in card.weights)


@pytest.mark.weights
@pytest.mark.filterwarnings("ignore")
def test_moge_as_upstream_runs_it(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    upstream_sources("EasternJournalist+utils3d")
    upstream_sources("microsoft+MoGe")
    from moge.model.v2 import MoGeModel

    torch.manual_seed(0)
    common = {"num_res_blocks": [0] * 5, "resamplers": ["bilinear"] * 4}
    head = {"dim_in": [32] * 5, "dim_res_blocks": [32] * 5, **common}
    network = MoGeModel(
        encoder={"backbone": "dinov2_vits14", "intermediate_layers": [5, 11], "dim_out": 32},
        neck={"dim_in": [34, 2, 2, 2, 2], "dim_out": None, "dim_res_blocks": [32] * 5, **common},
        points_head={**head, "dim_out": [None] * 4 + [3]},
        mask_head={**head, "dim_out": [None] * 4 + [1]},
        scale_head={"dims": [384, 32, 1]},
        remap_output="exp",
    ).eval()
    rows, columns = (side // 14 for side in moge_size((588, 840)))
    picture = cv2.resize(PICTURE, (columns * 14, rows * 14), interpolation=cv2.INTER_CUBIC)
    tensor = torch.from_numpy(picture.astype(np.float32) / 255).permute(2, 0, 1)
    theirs = network.infer(tensor, num_tokens=rows * columns, fov_x=60.0, use_fp16=False)
    network.onnx_compatible_mode = True
    torch.onnx.export(
        network,
        (tensor[None], torch.tensor(rows * columns)),
        tmp_path / "moge.onnx",
        input_names=["image", "num_tokens"],
        output_names=["points", "mask", "metric_scale"],
        opset_version=17,
        dynamo=False,
    )
    focal_px = columns * 14 / 2 / np.tan(np.radians(30))
    depth = DepthNetwork(tmp_path / "moge.onnx", "moge").depth(picture, focal_px)
    mask = theirs["mask"].numpy()
    assert mask.any()
    assert np.mean((depth > 0) == mask) > 0.999
    np.testing.assert_allclose(depth[mask & (depth > 0)], theirs["depth"].numpy()[mask & (depth > 0)], rtol=2e-3)


@pytest.mark.weights
@pytest.mark.filterwarnings("ignore")
def test_depth_anything_as_upstream_runs_it(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("torchvision", reason="torchvision is not installed")
    upstream_sources("DepthAnything+Depth-Anything-V2")
    from depth_anything_v2.dpt import DepthAnythingV2

    torch.manual_seed(0)
    network = DepthAnythingV2("vits", features=32, out_channels=[24, 24, 24, 24]).eval()
    picture = cv2.resize(PICTURE, (300, 200), interpolation=cv2.INTER_CUBIC)
    theirs = network.infer_image(picture[..., ::-1].copy())
    tensor, _ = network.image2tensor(picture[..., ::-1].copy())
    assert tensor.shape[2:] == anything_size(picture.shape)
    shown = (resized_cubic(picture, anything_size(picture.shape)) - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    np.testing.assert_allclose(shown.transpose(2, 0, 1), tensor[0].numpy(), atol=1e-4)
    torch.onnx.export(
        network, (tensor,), tmp_path / "anything.onnx", output_names=["depth"], opset_version=17, dynamo=False
    )
    found = DepthNetwork(tmp_path / "anything.onnx", "Depth Anything").depth(picture, None)
    np.testing.assert_allclose(found, theirs, atol=2e-4 * float(theirs.max()))
    small = np.random.default_rng(0).random((5, 7)).astype(np.float32)
    wide = torch.nn.functional.interpolate(
        torch.from_numpy(small)[None, None], (11, 20), mode="bilinear", align_corners=True
    )
    np.testing.assert_allclose(resample_corners(small, (11, 20)), wide[0, 0].numpy(), atol=1e-3)
