# SPDX-License-Identifier: Apache-2.0
"""Pi3 and Pi3X (Wang et al. 2025): cameras and depth of a few pictures of one moment.

Both give world-from-camera poses and points in the camera's frame, OpenCV axes. Pi3 has neither unit nor frame of
reference, and its confidence is a logit. Neither gives a reliable focal length (upstream squashes pictures to multiples
of 14): it is fitted here, at half-pixel centres, to the network's own points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.sizes import as_float, resample
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    failed,
    import_upstream,
    loading,
    require_finite,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import Reconstruction
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

INSTEAD = "give it fewer or smaller pictures, or a calibration (calibration.source: files) and depth.source: embedded"
PI3 = Card(
    name="pi3",
    title="Pi3",
    kind="pose and depth",
    terms=Terms(
        code="BSD-3-Clause",
        weights="CC BY-NC 4.0",
        commercial="no",
        condition="non-commercial weights",
    ),
    weights=(
        WeightFile(
            "pi3/model.safetensors",
            HUB,
            "yyfz233/Pi3",
            3.83,
            "model.safetensors",
            revision="ae722e7039287d0c8fde9f11f197f804f44b510c",
            sha256="33580e4702ac671558aedeab1148fd08118f7ce45bdbeb99f3e3cf340062875d",
        ),
    ),
    runtime=Runtime(
        image="pi3",
        python=">=3.10",
        torch="2.5.1",
        pins=("torchvision==0.20.1", "numpy==1.26.4", "safetensors", "huggingface_hub"),
        commit="9fa3ddb",
    ),
    memory=Memory(
        8.0, "four to sixteen views of 255 000 pixels; weights 3.7 GB and 53 MB per view (upstream benchmark)"
    ),
    tried="random weights",
    unchecked="a GPU",
    instead=INSTEAD,
)
PI3X = Card(
    name="pi3x",
    title="Pi3X",
    kind="pose and depth",
    terms=Terms(
        code="BSD-3-Clause",
        weights="CC BY-NC 4.0",
        commercial="no",
        condition="non-commercial weights",
    ),
    weights=(
        WeightFile(
            "pi3x/model.safetensors",
            HUB,
            "yyfz233/Pi3X",
            5.44,
            "model.safetensors",
            revision="bb1deea4d7423de5b30691739cb451a3f57dc1d5",
            sha256="69972d6e1c4492cb4d737a84fe940e357087d81c52f5c9b7c160b49c1f41669a",
        ),
    ),
    runtime=Runtime(
        image="pi3",
        python=">=3.10",
        torch="2.5.1",
        pins=("torchvision==0.20.1", "numpy==1.26.4", "safetensors", "huggingface_hub"),
        commit="9fa3ddb",
    ),
    memory=Memory(10.0, "four to sixteen views of 255 000 pixels; weights 5.4 GB (upstream benchmark)"),
    tried="random weights",
    unchecked="a GPU",
    instead=INSTEAD,
)
CARDS = (PI3, PI3X)


MULTIPLE_PX = 14
BUDGET_PX = 255_000
"""Pixels per picture that upstream's own loader allows."""
CONFIDENT = 0.1
"""Smallest confidence of a point (paper, section on view synthesis), of the sigmoid."""
EDGE = 0.03
"""Relative jump in depth between neighbours at which a point mixes two surfaces (upstream: rtol)."""
_MIN_POINTS = 100
_GIVEN = ("depth_encoder.", "depth_emb", "ray_embed.", "pose_inject_blk.")


@dataclass(frozen=True)
class Inset:
    """Position and size of a picture in a network's frame, pixels."""

    top: int
    left: int
    height: int
    width: int


def preprocess(pictures: Sequence[Integer[np.ndarray, "H W 3"]]) -> tuple[Float[np.ndarray, "N 3 h w"], list[Inset]]:
    """Float32 RGB in [0, 1], sides multiples of 14, and the position of each picture in it.

    Pictures keep their aspect ratio and are padded by their border, equally on both sides: networks assume the
    principal point in the middle of the frame.
    """
    shapes = np.array([p.shape[:2] for p in pictures], dtype=np.float64)
    aspect = float(np.exp(np.mean(np.log(shapes[:, 1] / shapes[:, 0]))))
    height = np.sqrt(BUDGET_PX / aspect)
    frame = [max(MULTIPLE_PX, int(side // MULTIPLE_PX) * MULTIPLE_PX) for side in (height, height * aspect)]
    tensors, taken = [], []
    for picture in pictures:
        scale = min(side / own for side, own in zip(frame, picture.shape[:2]))
        size = (min(round(picture.shape[0] * scale), frame[0]), min(round(picture.shape[1] * scale), frame[1]))
        missing = [side - own for side, own in zip(frame, size)]
        beside = [(m // 2, m - m // 2) for m in missing]
        inside = np.pad(resample(as_float(picture), size), (*beside, (0, 0)), mode="edge")
        tensors.append(np.clip(inside, 0, 1).transpose(2, 0, 1))
        taken.append(Inset(beside[0][0], beside[1][0], *size))
    return np.stack(tensors), taken


def sigmoid(logits: Num[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Sigmoid that does not overflow."""
    small = np.exp(-np.abs(logits.astype(np.float64)))
    return np.where(logits >= 0, 1 / (1 + small), small / (1 + small)).astype(np.float32)


def depth_edges(depth: Float[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Pixels whose depth differs from that of one of eight neighbours by more than ``EDGE`` of it.

    Upstream's newer rule also needs a jump of the normal; this one drops more of floors seen at a grazing angle.
    """
    import cv2

    return cv2.morphologyEx(depth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > EDGE * np.abs(depth)


def fit_focal(points: Float[np.ndarray, "h w 3"], weight: Num[np.ndarray, "h w"]) -> tuple[float, float]:
    """Focal length, px, that projects camera-frame points to their pixels by weighted least squares, and the residual.

    The principal point is in the middle; the residual is the median distance of a pixel and its point's projection.
    """
    height, width = weight.shape
    u = (np.arange(width) + 0.5 - width / 2)[None].repeat(height, 0)[weight > 0]
    v = (np.arange(height) + 0.5 - height / 2)[:, None].repeat(width, 1)[weight > 0]
    x, y = ((points[..., k] / points[..., 2])[weight > 0].astype(np.float64) for k in (0, 1))
    share = weight[weight > 0].astype(np.float64)
    best = float((share * (u * x + v * y)).sum() / (share * (x * x + y * y)).sum())
    return best, float(np.median(np.hypot(best * x - u, best * y - v)))


def postprocess(
    points: Float[np.ndarray, "N h w 3"],
    confidence: Float[np.ndarray, "N h w"],
    poses: Float[np.ndarray, "N 4 4"],
    taken: Sequence[Inset],
    names: Sequence[str],
    card: Card,
) -> Reconstruction:
    """Cameras and depth from points in camera frames, confidence in [0, 1] and world-from-camera poses.

    The first camera becomes the world's origin. Depth near edges or of low confidence is 0. Raises UserError for poses
    that are no rotations, a camera without confident points, or one whose points are behind it.
    """
    turned = poses[:, :3, :3].astype(np.float64)
    if np.abs(turned @ turned.transpose(0, 2, 1) - np.eye(3)).max() > 1e-2 or (np.linalg.det(turned) < 0).any():
        raise failed(card, "returned a pose that is no rotation")
    first = np.linalg.inv(poses[0].astype(np.float64))
    cameras, depths, kept, residuals = [], [], [], []
    for own, sure, pose, inset, name in zip(points, confidence, poses, taken, names):
        height, width = inset.height, inset.width
        rows, columns = slice(inset.top, inset.top + height), slice(inset.left, inset.left + width)
        own, sure = own[rows, columns], sure[rows, columns]
        depth = own[..., 2]
        usable = (sure > CONFIDENT) & (depth > 0) & ~depth_edges(depth)
        if usable.sum() < _MIN_POINTS:
            raise UserError(
                f"the network is sure of {int(usable.sum())} pixels of camera {name}: its picture "
                "shares nothing with the others; leave it "
                "out with train: [...] in capture.yaml"
            )
        length, residual = fit_focal(own, np.where(usable, sure, 0))
        intrinsics = np.array([[length, 0, width / 2], [0, length, height / 2], [0, 0, 1.0]])
        cameras.append(
            Camera(name, (width, height), intrinsics, _rigid(np.linalg.inv(first @ pose.astype(np.float64))))
        )
        depths.append(np.where(usable, depth, 0).astype(np.float32))
        kept.append(np.where(usable, sure, 0).astype(np.float32))
        residuals.append(residual)
    return Reconstruction(cameras, depths, kept, residuals, metric=card is not PI3)


def _rigid(pose: np.ndarray) -> np.ndarray:
    """The pose with its rotation made exactly orthogonal: networks return float32, or bfloat16 at worst."""
    left, _, right = np.linalg.svd(pose[:3, :3])
    rigid = np.eye(4)
    rigid[:3, :3], rigid[:3, 3] = left @ right, pose[:3, 3]
    return rigid


class Pi3:
    """Pi3 or Pi3X, loaded once; satisfies ``PoseAndDepth``."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        file = staged_weights(card, weights) / card.weights[0].path
        self._card, self._device = card, torch_device(card, where)
        network = attribute(card, import_upstream(card, f"pi3.models.{card.name}"), card.title)
        state = attribute(card, import_upstream(card, "safetensors.torch"), "load_file")(str(file))
        self._network = network()
        with loading(card, file):
            if card is PI3X:
                # Branches for given depth, rays and poses, which are not used here: upstream's own example drops them
                # too. Without them every entry has to fit.
                self._network.disable_multimodal()
                state = {key: value for key, value in state.items() if not key.startswith(_GIVEN)}
            self._network.load_state_dict(state)
        self._network.to(self._device).eval()

    def reconstruct(self, pictures: Sequence[Integer[np.ndarray, "H W 3"]], names: Sequence[str]) -> Reconstruction:
        """Cameras and depth; see ``models.protocols.PoseAndDepth``."""
        tensor, taken = preprocess(pictures)
        made = infer(self._network, tensor, self._device)
        for what, values in zip(("points", "confidence", "poses"), made):
            require_finite(self._card, what, values)
        return postprocess(*made, taken, names, self._card)


def infer(
    network: Any, tensor: Float[np.ndarray, "N 3 h w"], where: Any
) -> tuple[Float[np.ndarray, "N h w 3"], Float[np.ndarray, "N h w"], Float[np.ndarray, "N 4 4"]]:
    """Camera-frame points, confidence after the sigmoid and world-from-camera poses of pictures."""
    import torch

    kind = torch.device(where).type
    half = torch.bfloat16 if kind != "cuda" or torch.cuda.get_device_capability()[0] >= 8 else torch.float16
    with torch.inference_mode(), torch.autocast(kind, dtype=half, enabled=kind == "cuda"):
        made = network(torch.from_numpy(tensor)[None].to(where))
    points, logits, poses = (made[key][0].float().cpu().numpy() for key in ("local_points", "conf", "camera_poses"))
    return points, sigmoid(logits[..., 0]), poses


ADAPTER = Pi3
