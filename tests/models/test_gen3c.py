# SPDX-License-Identifier: Apache-2.0
"""GEN3C without its network: what it is asked, that a wrong request is caught before a GPU is, and what is made of its
chunks."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import interpolate_cameras
from studiorecon.models.adapters import gen3c
from studiorecon.models.adapters.gen3c import depth_scale, generate_chunks, order_key_frames, postprocess, preprocess
from studiorecon.models.adapters.gen3c_request import CHUNK, check_evidence, check_form, evidence, splat
from studiorecon.models.catalogue.card import Card
from studiorecon.models.protocols import KeyFrame
from studiorecon.scene.camera import Camera
from studiorecon.views.generate import read_request

from tests.made.networks import room_views, upstream_sources

HW = (88, 160)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gen3c, "HW", HW)


def key_frames(depth_factor: float = 1.0) -> list[KeyFrame]:
    return [
        KeyFrame(c, rgb, (depth * depth_factor).astype(np.float32), depth > 0)
        for c, rgb, depth in room_views((HW[1], HW[0]))
    ]


def way(frames: list[KeyFrame], length: int = CHUNK) -> list[Camera]:
    views, _ = interpolate_cameras(
        frames[0].camera, frames[1].camera, length, np.zeros(3), rotations="look_at", clearance=1.0
    )
    return [frames[0].camera, *views[1:]]


@pytest.fixture
def request_of_room(small: None) -> dict[str, np.ndarray]:
    frames = key_frames()
    return preprocess(frames, way(frames))


def test_conventions_of_a_request(request_of_room: dict[str, np.ndarray]) -> None:
    frames = key_frames()
    first, camera = request_of_room, frames[0].camera
    # Naive: half-pixel centres kept, colours in [0, 1], world-from-camera poses.
    np.testing.assert_allclose(first["K_key_frames"][0][:2, 2] + 0.5, camera.principal_px, atol=1e-5)
    np.testing.assert_allclose(first["w2cs_key_frames"][0], camera.camera_from_world, atol=1e-6)
    np.testing.assert_allclose((first["images_key_frames"][0].transpose(1, 2, 0) + 1) / 2, frames[0].rgb, atol=1e-6)
    assert first["scene_scale"] == 1
    assert {name: value.dtype for name, value in first.items() if name != "scene_scale"} == dict.fromkeys(
        set(first) - {"scene_scale"}, np.float32
    )
    check_form(first)


@pytest.mark.parametrize(
    ("factor", "median"), [(0.01, 1.0), (1.0, None), (200.0, 10.0)], ids=["tiny scene", "room", "field"]
)
def test_scale_brings_depth_where_the_network_expects_it_and_moves_poses_with_it(
    small: None, factor: float, median: float | None
) -> None:
    frames = [replace(k, camera=_scaled(k.camera, factor)) for k in key_frames(factor)]
    made = preprocess(frames, [frames[0].camera] * CHUNK)
    known = made["depth_key_frames"][made["mask_key_frames"] > 0]
    assert 1 - 1e-5 <= np.median(known) <= 10 + 1e-5
    assert known.max() <= 100
    if median is not None:
        assert np.median(known) == pytest.approx(median, rel=1e-3)
    # A point is where it was, times the scale: depth and poses agree after it.
    assert evidence(made, samples=1).depth_agreement < 0.01


def _scaled(camera: Camera, factor: float) -> Camera:
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= factor
    return replace(camera, camera_from_world=pose)


def test_a_far_wall_never_reaches_the_cut_at_100() -> None:
    depth = np.full((10, 10), 5.0)
    depth[0, 0] = 400.0
    assert depth_scale([depth]) * 400 == pytest.approx(100)
    with pytest.raises(UserError, match="no key frame has a pixel with known depth"):
        depth_scale([np.zeros((3, 3)), np.full((3, 3), np.inf)])


def test_infinite_and_masked_depth_become_zero_with_mask_zero(small: None) -> None:
    frames = key_frames()
    depth = frames[0].depth_m.copy()
    depth[:10], depth[10:20] = np.inf, np.nan
    usable = frames[0].usable.copy()
    usable[20:30] = False
    frames[0] = replace(frames[0], depth_m=depth, usable=usable)
    made = preprocess(frames, way(frames))
    # Naive: upstream turns NaN and +inf into a wall at 100.
    assert not made["depth_key_frames"][0, 0, :30].any()
    assert not made["mask_key_frames"][0, 0, :30].any()
    assert made["mask_key_frames"][0, 0, 30:].all()


def test_the_key_frame_the_path_starts_at_comes_first(small: None) -> None:
    frames = key_frames()
    turned = [frames[2], frames[1], frames[0], frames[3]]
    assert order_key_frames(turned, frames[0].camera) == [2, 0, 1, 3]
    made = preprocess(turned, way(frames))
    np.testing.assert_array_equal(made["w2cs_all"][0], made["w2cs_key_frames"][0])
    with pytest.raises(UserError, match=r"starts .* off the nearest key frame"):
        preprocess(frames, [*way(frames)[1:], frames[1].camera])


@pytest.mark.parametrize("length", [1, 120, 122, 240])
def test_only_120_n_plus_1_frames_are_requested(small: None, length: int) -> None:
    frames = key_frames()
    with pytest.raises(UserError, match="121, 241, 361"):
        preprocess(frames, [frames[0].camera] * length)


def test_a_sound_request_reproduces_its_key_frames_and_fills_its_path(request_of_room: dict[str, np.ndarray]) -> None:
    found = evidence(request_of_room, samples=3)
    assert found.own_error_levels < 0.5
    assert found.depth_agreement < 0.01
    assert found.coverage.min() > 0.5
    check_evidence(found)


def spoil_poses(made: dict[str, np.ndarray]) -> None:
    for name in ("w2cs_key_frames", "w2cs_all"):
        made[name] = np.linalg.inv(made[name].astype(np.float64)).astype(np.float32)


def spoil_depth(made: dict[str, np.ndarray]) -> None:
    made["depth_key_frames"] = made["depth_key_frames"] * np.float32(1.4)


def spoil_one_camera(made: dict[str, np.ndarray]) -> None:
    made["w2cs_key_frames"] = made["w2cs_key_frames"][[0, 2, 1, 3]]


@pytest.mark.parametrize("spoil", [spoil_poses, spoil_depth, spoil_one_camera])
def test_contradictions_between_depth_and_poses_are_caught(
    request_of_room: dict[str, np.ndarray], spoil: Callable
) -> None:
    spoil(request_of_room)
    with pytest.raises(UserError, match=r"disagree about depth|of the path the key frames show"):
        check_evidence(evidence(request_of_room, samples=3))


def test_a_path_into_the_unseen_is_caught(request_of_room: dict[str, np.ndarray]) -> None:
    away = request_of_room["w2cs_all"].copy()
    away[60:, :3, :3] = np.diag([-1.0, 1.0, -1.0]) @ away[60:, :3, :3]
    away[60:, :3, 3] = 50
    request_of_room["w2cs_all"] = away.astype(np.float32)
    with pytest.raises(UserError, match=r"at frame (60|120) of the path the key frames show 0 %"):
        check_evidence(evidence(request_of_room, samples=3))


@pytest.mark.parametrize(
    ("field", "change", "sentence"),
    [
        ("K_key_frames", None, "lacks K_key_frames"),
        ("depth_key_frames", lambda v: v[:, 0], "depth of the GEN3C request has shape"),
        ("images_key_frames", lambda v: v * 127, r"expected \[−1, 1\]"),
        ("images_key_frames", lambda v: (v + 1) / 2, r"expected \[−1, 1\]"),
        ("depth_key_frames", lambda v: np.where(v > 3, np.inf, v), "no numbers"),
        ("w2cs_all", lambda v: v * 2, "no rotation"),
        ("w2cs_all", lambda v: v[::-1], "does not start at its first key frame"),
        ("Ks_all", lambda v: v * 1.1, "other intrinsics"),
        ("mask_key_frames", np.zeros_like, "the mask must not be empty"),
        ("depth_key_frames", lambda v: v * 50, r"must be in \(0, 100\]"),
    ],
)
def test_a_malformed_request_is_one_sentence(
    request_of_room: dict[str, np.ndarray], field: str, change: Callable | None, sentence: str
) -> None:
    if change is None:
        del request_of_room[field]
    else:
        request_of_room[field] = change(request_of_room[field])
    with pytest.raises(ValueError, match=sentence):
        check_form(request_of_room)


def test_requests_survive_the_disk_and_broken_files_are_named(
    request_of_room: dict[str, np.ndarray], tmp_path: Path
) -> None:
    np.savez(tmp_path / "00.npz", **request_of_room)
    again = read_request(tmp_path / "00.npz")
    assert set(again) == set(request_of_room)
    (tmp_path / "01.npz").write_bytes(b"PK no")
    with pytest.raises(UserError, match=r"01\.npz is not a readable .npz .*delete it"):
        read_request(tmp_path / "01.npz")


def test_chunks_share_a_frame_and_each_starts_with_the_last_of_the_one_before(small: None) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    frames = key_frames()
    made = preprocess(frames, [*way(frames), *way(frames, 240)[1:][:120]])
    assert len(made["w2cs_all"]) == 241
    seeds, targets = [], []

    def render_cache(poses: object, lenses: object) -> tuple[object, object]:
        targets.append(poses.shape[1])
        return poses, lenses

    def generate(**given: object) -> tuple[np.ndarray, str]:
        seeds.append(given["image_path"])
        film = np.random.default_rng(len(seeds)).integers(0, 256, (CHUNK, *HW, 3), dtype=np.uint8)
        return film, ""

    parts = list(generate_chunks(generate, SimpleNamespace(render_cache=render_cache), made, "cpu"))
    assert [len(p) for p in parts] == [121, 120]
    assert targets == [121, 121]
    assert tuple(seeds[0].shape) == (1, 3, 1, *HW)
    torch.testing.assert_close(seeds[0][0, :, 0], torch.from_numpy(made["images_key_frames"][0]))
    back = ((seeds[1][0, :, 0].permute(1, 2, 0) + 1) * 127.5).round().numpy().astype(np.uint8)
    np.testing.assert_array_equal(back, parts[0][-1])


def test_a_film_without_content_or_of_another_size_is_refused(small: None) -> None:
    film = np.random.default_rng(0).integers(0, 256, (3, *HW, 3), dtype=np.uint8)
    assert postprocess(film, 3) is film
    film[1] = 7
    with pytest.raises(UserError, match="one colour at frame 1"):
        postprocess(film, 3)
    with pytest.raises(UserError, match="use upstream at db2ffe1"):
        postprocess(film[..., :2], 3)


@pytest.mark.parametrize(("offload", "wanted"), [(True, None), (False, 80.0)])
def test_without_offload_the_gpu_must_hold_everything(
    offload: bool, wanted: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    requested = []

    def device(card: Card, where: str, needed: float | None) -> None:
        requested.append(needed)
        raise UserError("no GPU here")

    for name in ("staged_weights", "import_upstream", "attribute"):
        monkeypatch.setattr(gen3c, name, lambda *about: about[-1] if isinstance(about[-1], Path) else about)
    monkeypatch.setattr(gen3c, "torch_device", device)
    how = {"steps": 1, "guidance": 1.0, "seed": 0, "filter_points_threshold": 0.05, "foreground_masking": True}
    with pytest.raises(UserError, match="no GPU here"):
        gen3c.Gen3c(gen3c.CARD, tmp_path, "cuda", offload=offload, **how)
    assert requested == [wanted]


@pytest.mark.weights
def test_upstreams_own_cache_renders_our_request_as_our_check_does(
    small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("einops", reason="einops is not installed")
    upstream_sources("nv-tlabs+GEN3C")
    # NVIDIA Warp only serves foreground masking, which is off.
    if find_spec("warp") is None:
        monkeypatch.setitem(sys.modules, "warp", SimpleNamespace())
    from cosmos_predict1.diffusion.inference.cache_3d import Cache3D_BufferSelector

    frames = key_frames()
    made = preprocess(frames, way(frames))
    cache = gen3c.warp_cache(partial(Cache3D_BufferSelector, filter_points_threshold=1.0), made, "cpu")
    targets = torch.from_numpy(made["w2cs_all"][[0, 40]])[None], torch.from_numpy(made["Ks_all"][[0, 40]])[None]
    pixels, masks = cache.render_cache(*targets)
    assert tuple(pixels.shape[:3]) == (1, 2, 2)
    errors = np.abs(pixels[0, 0].numpy() - made["images_key_frames"][0]) * (masks[0, 0].numpy() > 0)
    # At silhouettes upstream's splats mix both sides; everywhere else the picture comes back as it went in.
    assert np.percentile(errors, 95, axis=(1, 2, 3)).min() < 1e-4
    ours, depth = splat(
        made["images_key_frames"][0],
        made["depth_key_frames"][0, 0],
        made["mask_key_frames"][0, 0],
        (made["K_key_frames"][0], made["w2cs_key_frames"][0]),
        (made["Ks_all"][40], made["w2cs_all"][40]),
    )
    chosen = max(range(2), key=lambda k: float(((pixels[0, 1, k].numpy() - ours) ** 2)[:, depth > 0].mean()) * -1)
    both = (depth > 0) & (masks[0, 1, chosen, 0].numpy() > 0)
    assert both.mean() > 0.5
    assert np.median(np.abs(pixels[0, 1, chosen].numpy() - ours)[:, both]) < 0.02


@pytest.mark.weights
def test_upstreams_foreground_masking_takes_our_request_and_hides_points(
    small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("einops", reason="einops is not installed")
    warp = pytest.importorskip("warp", reason="warp-lang is not installed")
    upstream_sources("nv-tlabs+GEN3C")
    launch = warp.launch
    # Upstream names cuda:0 whatever the tensors' device is.
    monkeypatch.setattr(warp, "launch", lambda *given, **named: launch(*given, **{**named, "device": "cpu"}))
    from cosmos_predict1.diffusion.inference.cache_3d import Cache3D_BufferSelector

    frames = key_frames()
    made = preprocess(frames, way(frames))
    targets = torch.from_numpy(made["w2cs_all"][[0, 40]])[None], torch.from_numpy(made["Ks_all"][[0, 40]])[None]
    shown = []
    for masked in (False, True):
        selector = partial(Cache3D_BufferSelector, filter_points_threshold=0.05, foreground_masking=masked)
        shown.append(gen3c.warp_cache(selector, made, "cpu").render_cache(*targets)[1].numpy() > 0)
    assert 0.1 < shown[1].mean() < shown[0].mean()
    assert not (shown[1] & ~shown[0]).any()
