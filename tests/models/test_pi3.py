# SPDX-License-Identifier: Apache-2.0
"""Pi3: planted rooms come back through their conventions; logits, squashed pictures, edges and gauges
do no harm."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters import pi3
from studiorecon.models.adapters.pi3 import (
    MULTIPLE_PX,
    PI3,
    PI3X,
    Inset,
    depth_edges,
    fit_focal,
    infer,
    postprocess,
    preprocess,
    sigmoid,
)
from studiorecon.models.loading import load
from studiorecon.scene.camera import Camera

from tests.made.networks import room_views, upstream_sources

WH = (168, 98)
CARDS_BY_NAME = {card.name: card for card in pi3.CARDS}


def points_of(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """(h, w, 3) points in the camera's frame."""
    pixels = np.concatenate([camera.pixel_centres(), np.ones((*camera.hw, 1))], axis=-1)
    return pixels @ np.linalg.inv(camera.intrinsics).T * depth[..., None]


def planted(scale: float, seed: int) -> tuple[list[Camera], list[np.ndarray], np.ndarray, np.ndarray]:
    """The room as a network would tell it: any unit, any frame of reference, world-from-camera poses."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    gauge = np.eye(4)
    gauge[:3, :3], gauge[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.normal(size=3)
    views = room_views(WH)
    poses = []
    for camera, _, _ in views:
        pose = camera.world_from_camera.copy()
        pose[:3, 3] *= scale
        poses.append(gauge @ pose)
    points = np.stack([points_of(c, d * scale) for c, _, d in views])
    return (
        [c for c, _, _ in views],
        [d for _, _, d in views],
        points.astype(np.float32),
        np.stack(poses).astype(np.float32),
    )


@pytest.mark.parametrize("scale", [0.03, 1.0, 40.0])
def test_cameras_depth_and_focal_lengths_come_back_up_to_one_scale(scale: float) -> None:
    cameras, depths, points, poses = planted(scale, 3)
    found = postprocess(
        points,
        np.full(points.shape[:3], 0.9, np.float32),
        poses,
        [Inset(0, 0, WH[1], WH[0])] * 4,
        [c.name for c in cameras],
        PI3,
    )
    np.testing.assert_allclose(found.cameras[0].camera_from_world, np.eye(4), atol=1e-6)
    for true, own, depth, seen, residual in zip(cameras, found.cameras, depths, found.depths, found.focal_residuals_px):
        relative = true.camera_from_world @ cameras[0].world_from_camera
        np.testing.assert_allclose(own.camera_from_world[:3, :3], relative[:3, :3], atol=1e-5)
        np.testing.assert_allclose(own.camera_from_world[:3, 3], relative[:3, 3] * scale, atol=2e-5 * max(scale, 1))
        # Naive, with the first pixel's centre at 0: off by half a pixel, 0.6 % of this focal length.
        assert own.focal_px[0] == pytest.approx(true.focal_px[0], rel=1e-4)
        assert residual < 0.01
        known = seen > 0
        # At this size a grazing floor steps by more than an edge.
        assert known.mean() > 0.6
        np.testing.assert_allclose(seen[known], depth[known] * scale, rtol=1e-4)


def test_confidence_is_a_logit() -> None:
    logits = np.array([-1000.0, -3.0, -2.1, 0.0, 3.0, 1000.0])
    np.testing.assert_allclose(sigmoid(logits), [0, 0.0474, 0.1091, 0.5, 0.9526, 1], atol=1e-4)
    # Naive, conf > 0.1 on logits: throws away everything below a confidence of 0.52.
    assert ((sigmoid(logits) > 0.1) == [False, False, True, True, True, True]).all()


def test_points_beside_jumps_in_depth_are_left_out() -> None:
    depth = np.full((20, 30), 2.0)
    depth[:, 15:] = 3.0
    found = depth_edges(depth)
    assert found[:, 14:16].all()
    assert found.sum() == 40
    assert not depth_edges(np.tile(np.linspace(2, 2.1, 30), (20, 1))).any()


@pytest.mark.parametrize("hws", [[(270, 480)] * 3, [(704, 1280), (1280, 704)], [(100, 100), (480, 640), (1080, 1920)]])
def test_pictures_keep_their_shape_at_multiples_of_14(hws: list[tuple[int, int]]) -> None:
    pictures = [np.zeros((*hw, 3), np.uint8) for hw in hws]
    for picture in pictures:
        picture[-1], picture[:, -1] = 255, 255
    tensor, taken = preprocess(pictures)
    assert tensor.shape[0] == len(hws)
    assert tensor.shape[2] % MULTIPLE_PX == tensor.shape[3] % MULTIPLE_PX == 0
    assert tensor.shape[2] * tensor.shape[3] <= 255_000
    for hw, inset, seen in zip(hws, taken, tensor):
        # Naive: every picture is squashed to the first one's shape, and its intrinsics with it.
        assert abs(np.log((inset.height / inset.width) / (hw[0] / hw[1]))) < 0.02
        # Naive, the rest of the frame at the right and below alone: the network's principal point, in the middle of the
        # frame, then lies far off the picture's, and the focal length is wrong by a third.
        for before, own, side in zip((inset.top, inset.left), (inset.height, inset.width), seen.shape[1:]):
            assert abs(before + own / 2 - side / 2) <= 0.5
        corner = seen[:, inset.top + inset.height - 1, inset.left + inset.width - 1]
        assert (corner > 0.2).all(), "the picture's white last row and column end where it is said to end"


def test_portrait_beside_landscape_keeps_both_focal_lengths() -> None:
    """What a network says that believes in a principal point in the middle of its frame."""
    rng, true_px = np.random.default_rng(0), 450.0
    tensor, taken = preprocess([np.zeros((640, 480, 3), np.uint8), np.zeros((480, 640, 3), np.uint8)])
    height, width = tensor.shape[2:]
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([(u - width / 2) / true_px, (v - height / 2) / true_px, np.ones((height, width))], axis=-1)
    smooth = 3 + 0.2 * np.sin(u / 40 + rng.random()) * np.cos(v / 50)
    points = np.repeat((rays * smooth[..., None])[None], 2, axis=0).astype(np.float32)
    poses, sure = np.repeat(np.eye(4)[None], 2, axis=0), np.full((2, height, width), 0.9, np.float32)
    found = postprocess(points, sure, poses, taken, ["a", "b"], PI3)
    for camera, residual_px in zip(found.cameras, found.focal_residuals_px):
        assert camera.focal_px[0] == pytest.approx(true_px, rel=0.01)
        assert residual_px < 1


def test_focal_length_is_that_of_the_confident_points() -> None:
    camera, _, depth = room_views(WH)[0]
    points = points_of(camera, depth)
    weight = np.ones(camera.hw)
    points[:40] *= np.array([3.0, 1.0, 1.0])
    weight[:40] = 0
    assert fit_focal(points, weight)[0] == pytest.approx(camera.focal_px[0], rel=1e-6)


def test_what_cannot_be_is_refused() -> None:
    cameras, _, points, poses = planted(1.0, 0)
    sure, names, taken = (
        np.full(points.shape[:3], 0.9, np.float32),
        [c.name for c in cameras],
        [Inset(0, 0, WH[1], WH[0])] * 4,
    )
    mirrored = poses.copy()
    mirrored[2, :3, 0] *= -1
    with pytest.raises(UserError, match="no rotation"):
        postprocess(points, sure, mirrored, taken, names, PI3)
    doubtful = sure.copy()
    doubtful[1] = 0.05
    with pytest.raises(UserError, match=r"sure of 0 pixels of camera cam2.*train: \["):
        postprocess(points, doubtful, poses, taken, names, PI3)
    behind = points * np.array([1, 1, -1], np.float32)
    with pytest.raises(UserError, match="sure of 0 pixels of camera cam1"):
        postprocess(behind, sure, poses, taken, names, PI3)


def test_the_call_hands_on_points_probabilities_and_poses() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    requested = []

    def network(pictures: object) -> dict[str, object]:
        requested.append(tuple(pictures.shape))
        return {
            "local_points": torch.ones(1, 2, 14, 28, 3),
            "conf": torch.zeros(1, 2, 14, 28, 1),
            "camera_poses": torch.eye(4).expand(1, 2, 4, 4),
        }

    points, sure, poses = infer(network, np.zeros((2, 3, 14, 28), np.float32), "cpu")
    assert requested == [(1, 2, 3, 14, 28)]
    assert (points.shape, sure.shape, poses.shape) == ((2, 14, 28, 3), (2, 14, 28), (2, 4, 4))
    assert (sure == 0.5).all()


@pytest.mark.weights
@pytest.mark.parametrize("name", ["pi3", "pi3x"])
def test_upstreams_network_with_random_weights_keeps_its_contract(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Upstream's own code, shallower than it is published, from a file of weights to cameras."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    for package in ("einops", "safetensors"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    from safetensors.torch import save_file

    upstream_sources("yyfz+Pi3")
    module = importlib.import_module(f"pi3.models.{name}")
    from pi3.models.dinov2.models.vision_transformer import DinoVisionTransformer

    def shallow(**_: object) -> object:
        return DinoVisionTransformer(
            img_size=518,
            patch_size=14,
            init_values=1.0,
            embed_dim=1024,
            depth=1,
            num_heads=16,
            num_register_tokens=4,
            block_chunks=0,
        )

    monkeypatch.setattr(module, "dinov2_vitl14_reg", shallow)
    published = getattr(module, CARDS_BY_NAME[name].title)

    def made() -> object:
        torch.manual_seed(0)
        network = published()
        network.decoder = network.decoder[:2]
        for decoder in ("point_decoder", "conf_decoder", "camera_decoder"):
            getattr(network, decoder).blocks = getattr(network, decoder).blocks[:1]
        return network

    (tmp_path / name).mkdir()
    save_file(made().state_dict(), tmp_path / name / "model.safetensors")
    monkeypatch.setattr(module, CARDS_BY_NAME[name].title, made)
    monkeypatch.setattr(pi3, "staged_weights", lambda _, folder: folder)  # this file is not what is published
    adapter = load("pose and depth", name, tmp_path, "cpu")
    pictures = np.random.default_rng(0).random((3, 3, 56, 70), dtype=np.float32)
    points, sure, poses = infer(adapter._network, pictures, "cpu")
    assert points.shape == (3, 56, 70, 3)
    assert (points[..., 2] > 0).all()
    assert sure.min() >= 0
    assert sure.max() <= 1
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1, atol=1e-4)
    if name == "pi3x":
        # Everything in its metres: the points in the world are the cameras' own through their poses.
        with torch.inference_mode():
            reported = adapter._network(torch.from_numpy(pictures)[None])
        world = np.einsum("nij,nhwj->nhwi", poses[:, :3, :3], points) + poses[:, None, None, :3, 3]
        np.testing.assert_allclose(world, reported["points"][0].numpy(), rtol=1e-3, atol=1e-3)
        found = postprocess(points, np.ones_like(sure), poses, [Inset(0, 0, 56, 70)] * 3, ["a", "b", "c"], PI3X)
        np.testing.assert_allclose(found.cameras[0].camera_from_world, np.eye(4), atol=1e-6)
        assert all(camera.wh == (70, 56) for camera in found.cameras)
        return
    # A network that has learnt nothing sees edges everywhere, and is not believed.
    with pytest.raises(UserError, match="the network is sure of"):
        postprocess(points, np.ones_like(sure), poses, [Inset(0, 0, 56, 70)] * 3, ["a", "b", "c"], PI3)


@pytest.mark.parametrize("lacks", ["", "decoder.weight"])
def test_pi3x_needs_every_entry_but_those_of_what_is_not_given(
    lacks: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")

    class Pi3X(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.decoder, self.ray_embed = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)

        def disable_multimodal(self) -> None:
            del self.ray_embed

    stored = {name: value for name, value in Pi3X().state_dict().items() if name != lacks}
    for name, module in (
        ("pi3.models.pi3x", SimpleNamespace(Pi3X=Pi3X, __name__="pi3.models.pi3x")),
        ("safetensors.torch", SimpleNamespace(load_file=lambda _: stored, __name__="safetensors.torch")),
    ):
        for part in (name.split(".")[0], name.rpartition(".")[0], name):
            monkeypatch.setitem(sys.modules, part, module)
    monkeypatch.setattr(pi3, "staged_weights", lambda _, folder: folder)  # this file is not what is published
    (tmp_path / "pi3x").mkdir()
    (tmp_path / "pi3x/model.safetensors").touch()
    if not lacks:
        assert not hasattr(load("pose and depth", "pi3x", tmp_path, "cpu")._network, "ray_embed")
        return
    # Naive, strict=False: a file of another network loads, and the rest stays random.
    with pytest.raises(UserError, match=r"pi3x/model\.safetensors holds no weights of Pi3X"):
        load("pose and depth", "pi3x", tmp_path, "cpu")
