# SPDX-License-Identifier: Apache-2.0
"""Pi3, Pi3X (Wang et al. 2025) and MapAnything (Keetha et al. 2025): cameras and depth of a few pictures of one moment.

All give world-from-camera poses and points in the camera's frame, OpenCV axes. Pi3 has neither unit nor frame of reference, and its
confidence is a logit. None says a focal length that is safe to use (upstream squashes pictures to multiples of 14): it is fitted here,
at half-pixel centres, to the network's own points.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.models.preflight import attribute, device, finite, staged, upstream
from studiorecon.models.protocols import Reconstruction
from studiorecon.models.registry import model
from studiorecon.models.sizes import as_float, resampled
from studiorecon.scene.camera import Camera

MULTIPLE_PX = 14
BUDGET_PX = 255_000
"""Pixels per picture that upstream's own loader allows."""
CONFIDENT = 0.1
"""Least confidence of a point (paper, section on view synthesis), of the sigmoid."""
EDGE = 0.03
"""Relative jump in depth between neighbours beside which a point mixes two surfaces (upstream: rtol)."""
_LEAST_POINTS = 100
_LOWER = "give it fewer or smaller pictures, or a calibration (cameras.source: files) and depth.source: embedded"
_FILES = {"pi3": "pi3/model.safetensors", "pi3x": "pi3x/model.safetensors"}


def pre(pictures: Sequence[np.ndarray]) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """(N, 3, h, w) float32 RGB in [0, 1], sides multiples of 14, and the size (h, w) that each picture takes in its upper left corner.

    Pictures keep their shape: one that is shaped otherwise than the frame has its border repeated beside it, never squashed.
    """
    shapes = np.array([p.shape[:2] for p in pictures], dtype=np.float64)
    aspect = float(np.exp(np.mean(np.log(shapes[:, 1] / shapes[:, 0]))))
    height = np.sqrt(BUDGET_PX / aspect)
    frame = [max(MULTIPLE_PX, int(side // MULTIPLE_PX) * MULTIPLE_PX) for side in (height, height * aspect)]
    tensors, taken = [], []
    for picture in pictures:
        scale = min(side / own for side, own in zip(frame, picture.shape[:2]))
        size = (min(round(picture.shape[0] * scale), frame[0]), min(round(picture.shape[1] * scale), frame[1]))
        inside = np.pad(resampled(as_float(picture), size), ((0, frame[0] - size[0]), (0, frame[1] - size[1]), (0, 0)), mode="edge")
        tensors.append(np.clip(inside, 0, 1).transpose(2, 0, 1))
        taken.append(size)
    return np.stack(tensors), taken


def probability(logits: np.ndarray) -> np.ndarray:
    """Sigmoid that does not overflow."""
    small = np.exp(-np.abs(logits.astype(np.float64)))
    return np.where(logits >= 0, 1 / (1 + small), small / (1 + small)).astype(np.float32)


def edges(depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: a neighbour (of eight) lies nearer or farther by more than ``EDGE`` of this depth."""
    around = np.pad(depth, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, (3, 3))
    return windows.max(axis=(2, 3)) - windows.min(axis=(2, 3)) > EDGE * np.abs(depth)


def focal(points: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """Focal length in pixels that carries (h, w, 3) camera-frame points to their own pixels, principal point in the middle.

    Weighted least squares over both axes; and the median distance in pixels between a point's pixel and its projection.
    """
    height, width = weight.shape
    u = (np.arange(width) + 0.5 - width / 2)[None].repeat(height, 0)[weight > 0]
    v = (np.arange(height) + 0.5 - height / 2)[:, None].repeat(width, 1)[weight > 0]
    x, y = ((points[..., k] / points[..., 2])[weight > 0].astype(np.float64) for k in (0, 1))
    share = weight[weight > 0].astype(np.float64)
    best = float((share * (u * x + v * y)).sum() / (share * (x * x + y * y)).sum())
    return best, float(np.median(np.hypot(best * x - u, best * y - v)))


def post(
    points: np.ndarray, confidence: np.ndarray, poses: np.ndarray, taken: Sequence[tuple[int, int]], names: Sequence[str], metric: bool
) -> Reconstruction:
    """Cameras and depth from (N, h, w, 3) points in camera frames, (N, h, w) confidence in [0, 1] and (N, 4, 4) world-from-camera poses.

    The first camera becomes the world's origin. Depth beside edges or of low confidence is 0. Raises Refusal for poses that are no
    rotations, a camera without confident points, or one whose points lie behind it.
    """
    turned = poses[:, :3, :3].astype(np.float64)
    if np.abs(turned @ turned.transpose(0, 2, 1) - np.eye(3)).max() > 1e-2 or (np.linalg.det(turned) < 0).any():
        raise Refusal("the network returned a pose that is no rotation; use upstream at the pin in the table of models")
    first = np.linalg.inv(poses[0].astype(np.float64))
    cameras, depths, kept, residuals = [], [], [], []
    for own, sure, pose, (height, width), name in zip(points, confidence, poses, taken, names):
        own, sure = own[:height, :width], sure[:height, :width]
        depth = own[..., 2]
        usable = (sure > CONFIDENT) & (depth > 0) & ~edges(depth)
        if usable.sum() < _LEAST_POINTS:
            raise Refusal(
                f"the network is sure of {int(usable.sum())} pixels of camera {name}: its picture shares nothing with the others; leave it "
                "out with train: [...] in capture.yaml"
            )
        length, residual = focal(own, np.where(usable, sure, 0))
        intrinsics = np.array([[length, 0, width / 2], [0, length, height / 2], [0, 0, 1.0]])
        cameras.append(Camera(name, (width, height), intrinsics, _rigid(np.linalg.inv(first @ pose.astype(np.float64)))))
        depths.append(np.where(usable, depth, 0).astype(np.float32))
        kept.append(np.where(usable, sure, 0).astype(np.float32))
        residuals.append(residual)
    return Reconstruction(cameras, depths, kept, residuals, metric)


def _rigid(pose: np.ndarray) -> np.ndarray:
    """The pose with its rotation made exactly orthogonal: networks return float32, or bfloat16 at worst."""
    left, _, right = np.linalg.svd(pose[:3, :3])
    rigid = np.eye(4)
    rigid[:3, :3], rigid[:3, 3] = left @ right, pose[:3, 3]
    return rigid


class Pi3:
    """Pi3 (``pi3``), Pi3X (``pi3x``) or MapAnything (``mapanything``), loaded once; satisfies ``PoseAndDepth``."""

    def __init__(self, name: str, weights: Path, where: str) -> None:
        folder = staged(name, weights)
        self._name, self._device = name, device(name, where, _LOWER)
        if name == "mapanything":
            network = attribute(name, upstream(name, "mapanything.models"), "MapAnything")
            self._network = network.from_pretrained(str(folder / "mapanything")).to(self._device).eval()
            return
        network = attribute(name, upstream(name, f"pi3.models.{name}"), {"pi3": "Pi3", "pi3x": "Pi3X"}[name])
        state = attribute(name, upstream(name, "safetensors.torch"), "load_file")(str(folder / _FILES[name]))
        self._network = network()
        try:
            self._network.load_state_dict(state, strict=name == "pi3")
        except RuntimeError as error:
            raise Refusal(f"{folder / _FILES[name]} does not fit {model(name).title} ({str(error).splitlines()[0]})") from None
        self._network.to(self._device).eval()

    def reconstruct(self, pictures: Sequence[np.ndarray], names: Sequence[str]) -> Reconstruction:
        """See ``models.protocols.PoseAndDepth``."""
        tensor, taken = pre(pictures)
        infer = inferred_by_mapanything if self._name == "mapanything" else inferred
        made = infer(self._network, tensor, self._device)
        for what, values in zip(("points", "confidence", "poses"), made):
            finite(self._name, what, values)
        return post(*made, taken, names, self._name != "pi3")


def inferred(network: Any, tensor: np.ndarray, where: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Camera-frame points, confidence after the sigmoid and world-from-camera poses of (N, 3, h, w) pictures, by Pi3 or Pi3X."""
    import torch

    kind = torch.device(where).type
    half = torch.bfloat16 if kind != "cuda" or torch.cuda.get_device_capability()[0] >= 8 else torch.float16
    with torch.inference_mode(), torch.autocast(kind, dtype=half, enabled=kind == "cuda"):
        made = network(torch.from_numpy(tensor)[None].to(where))
    points, logits, poses = (made[key][0].float().cpu().numpy() for key in ("local_points", "conf", "camera_poses"))
    return points, probability(logits[..., 0]), poses


def inferred_by_mapanything(network: Any, tensor: np.ndarray, where: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same by MapAnything; its confidence c ≥ 0 becomes c / (1 + c), and 0 outside its mask."""
    import torch

    prepare = attribute("mapanything", upstream("mapanything", "mapanything.utils.image"), "preprocess_inputs")
    views = [{"img": torch.from_numpy(picture.transpose(1, 2, 0) * 255).round().to(torch.uint8)} for picture in tensor]
    # At the size they have: another one would crop, and intrinsics with it.
    made = network.infer(
        prepare(views, resize_mode="fixed_size", size=(tensor.shape[3], tensor.shape[2])), apply_mask=False, mask_edges=False
    )
    points = np.stack([one["pts3d_cam"][0].float().cpu().numpy() for one in made])
    sure = np.stack([one["conf"][0].float().cpu().numpy() for one in made])
    mask = np.stack([one["non_ambiguous_mask"][0].bool().cpu().numpy() for one in made])
    poses = np.stack([one["camera_poses"][0].float().cpu().numpy() for one in made])
    return points, np.where(mask, sure / (1 + sure), 0), poses
