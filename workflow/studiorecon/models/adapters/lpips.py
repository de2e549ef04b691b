# SPDX-License-Identifier: Apache-2.0
"""LPIPS v0.1 on VGG16 or AlexNet (Zhang et al., CVPR 2018), as a distance with a gradient, with the user's weights.

Two pictures pass the convolutions of the network; at five depths the features are normalised per pixel, and their
squared difference is weighted per channel by a linear head and averaged over the picture. Training calls it
(``splatting.train.perceptual.Perceptual``), reports measure with it (``models.protocols.PerceptualDistance``).

Cost: 235 ms for the VGG16 trunk alone, one 320×176 picture forward and back on two idle cores, against 6 ms for all
else of a training step; a 96×96 crop has a sixth of the pixels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.machine.libraries import install_remedy
from studiorecon.models.catalogue.card import Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.protocols import SMALLEST_MEASURED_PX

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


def _card(name: str, title: str, net: str, file: str, weights: str, download: str, size_gb: float, sha256: str) -> Card:
    """LPIPS on one of torchvision's networks.

    The download's name contains the start of its checksum; ``sha256``: of the heads in lpips 0.1.4's wheel.
    """
    heads = f"weights/v0.1/{net}.pth"
    return Card(
        name=name,
        title=f"LPIPS v0.1 ({title})",
        kind="perceptual distance",
        terms=Terms("BSD-2-Clause", f"BSD-2-Clause; {title} trained on research data", "yes"),
        weights=(
            WeightFile(
                f"lpips/{file}.pth",
                f"PyTorch model downloads, {download}",
                size_gb=size_gb,
                remote=f"torchvision.models:{weights}",
                how="torchvision",
                sha256=download.removesuffix(".pth").rpartition("-")[2],
            ),
            WeightFile(
                f"lpips/lpips_{net}.pth",
                f"package lpips 0.1.4, {heads}",
                remote=f"lpips:{heads}",
                how="package",
                sha256=sha256,
            ),
        ),
        runtime=Runtime("vision", ">=3.10", ">=2.4", (), "lpips 0.1.4"),
        memory=Memory(None, "runs where the Gaussians are drawn (device); 2 GB on a GPU at 1280×704, our estimate"),
        tried="random weights",
        unchecked="a GPU",
    )


VGG = _card(
    "lpips",
    "VGG16",
    "vgg",
    "vgg16",
    "VGG16_Weights.IMAGENET1K_V1",
    "vgg16-397923af.pth",
    0.55,
    "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
)
ALEX = _card(
    "lpips_alex",
    "AlexNet",
    "alex",
    "alexnet",
    "AlexNet_Weights.IMAGENET1K_V1",
    "alexnet-owt-7be5be79.pth",
    0.24,
    "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
)
CARDS = (VGG, ALEX)


@dataclass(frozen=True)
class Convolution:
    """One of torchvision's ``features``: its index there, channels it makes, size, stride and padding."""

    index: int
    channels: int
    size: int = 3
    stride: int = 1
    padding: int = 1


@dataclass(frozen=True)
class Trunk:
    """Convolutions by depth, the pooling (size, stride) or None before each, and the files' names."""

    stages: tuple[tuple[Convolution, ...], ...]
    pools: tuple[tuple[int, int] | None, ...]
    features_file: str
    heads_file: str


def _three_by_three(*stages: tuple[int, tuple[int, ...]]) -> tuple[tuple[Convolution, ...], ...]:
    return tuple(tuple(Convolution(index, channels) for index in indices) for channels, indices in stages)


_ALEX = (
    (Convolution(0, 64, size=11, stride=4, padding=2),),
    (Convolution(3, 192, size=5, padding=2),),
    *_three_by_three((384, (6,)), (256, (8,)), (256, (10,))),
)
_VGG = _three_by_three((64, (0, 2)), (128, (5, 7)), (256, (10, 12, 14)), (512, (17, 19, 21)), (512, (24, 26, 28)))
TRUNKS = {
    "alex": Trunk(_ALEX, (None, (3, 2), (3, 2), None, None), "alexnet.pth", "lpips_alex.pth"),
    "vgg": Trunk(_VGG, (None, (2, 2), (2, 2), (2, 2), (2, 2)), "vgg16.pth", "lpips_vgg.pth"),
}
"""The parts into which the reference implementation divides torchvision's ``alexnet()`` and ``vgg16()``."""
Net = Literal["alex", "vgg"]
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""LPIPS' own standardisation of pictures in [−1, 1]."""
NORM_EPSILON = 1e-10


class Lpips:
    """The distance, from state dicts named as torchvision's networks and LPIPS' heads (``linN.model.1.weight``).

    It uses the weights' device and dtype. Raises KeyError for a missing entry and ValueError for one of a wrong shape.
    """

    def __init__(self, features: Mapping[str, Any], heads: Mapping[str, Any], net: Net = "vgg") -> None:
        before, self._trunk = 3, TRUNKS[net]
        self._stages, self._heads = [], []
        for depth, convolutions in enumerate(self._trunk.stages):
            stage = []
            for made in convolutions:
                weight, bias = (features[f"features.{made.index}.{kind}"].detach() for kind in ("weight", "bias"))
                if tuple(weight.shape) != (shape := (made.channels, before, made.size, made.size)):
                    raise ValueError(f"features.{made.index}.weight has shape {tuple(weight.shape)}, expected {shape}")
                stage.append((made, weight, bias))
                before = made.channels
            head = heads[f"lin{depth}.model.1.weight"].detach()
            if head.numel() != before:
                raise ValueError(
                    f"lin{depth}.model.1.weight has shape {tuple(head.shape)}, expected (1, {before}, 1, 1)"
                )
            self._stages.append(stage)
            self._heads.append(head.reshape(1, before, 1, 1))

    def distance(self, rendered: Any, target: Any) -> Any:
        """The distance of two tensors in [0, 1], (1, 3, h, w), sides at least 16, rescaled to [−1, 1] (U12)."""
        total = 0.0
        for ours, theirs, head in zip(self._features(2 * rendered - 1), self._features(2 * target - 1), self._heads):
            total = total + (head * (normalise_features(ours) - normalise_features(theirs)) ** 2).sum(dim=1).mean()
        return total

    def _features(self, picture: Any) -> Sequence[Any]:
        from torch.nn.functional import conv2d, max_pool2d, relu

        shift, scale = (picture.new_tensor(value).reshape(1, 3, 1, 1) for value in (SHIFT, SCALE))
        x, taken = (picture - shift) / scale, []
        for pool, stage in zip(self._trunk.pools, self._stages):
            x = max_pool2d(x, *pool) if pool else x
            for made, weight, bias in stage:
                x = relu(conv2d(x, weight, bias, stride=made.stride, padding=made.padding))
            taken.append(x)
        return taken

    def measure(self, prediction: Integer[np.ndarray, "H W 3"], truth: Integer[np.ndarray, "H W 3"]) -> float | None:
        """LPIPS of two uint8 pictures; None when a side is under 64 pixels. Raises ValueError when they differ in
        size."""
        import torch

        require("truth", truth, ("H", "W", 3), require("prediction", prediction, ("H", "W", 3)))
        if min(truth.shape[:2]) < SMALLEST_MEASURED_PX:
            return None
        with torch.inference_mode():
            return self.distance(*(self._tensor(picture) / 255 for picture in (prediction, truth))).item()

    def __call__(
        self, rendered: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"]
    ) -> tuple[float, Float[np.ndarray, "h w 3"]]:
        """Distance of two float32 RGB pictures in [0, 1], and its gradient by ``rendered``."""
        import torch

        ours, theirs = self._tensor(rendered).requires_grad_(True), self._tensor(target)
        distance = self.distance(ours, theirs)
        (gradient,) = torch.autograd.grad(distance, ours)
        return distance.item(), np.ascontiguousarray(gradient[0].cpu().numpy().transpose(1, 2, 0).astype(np.float32))

    def _tensor(self, picture: np.ndarray) -> Any:
        """(1, 3, h, w) of (h, w, 3), on the weights' device and in their dtype."""
        import torch

        return torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))[None].to(self._heads[0])


def normalise_features(features: Any) -> Any:
    """Features over their length per pixel; epsilon is inside the root, whose slope at 0 is infinite (I06)."""
    return features / (features.square().sum(dim=1, keepdim=True) + NORM_EPSILON).sqrt()


def read_lpips(
    folder: Path, threads: int, net: Net = "vgg", without: str = "leave LPIPS out", device: str = "cpu"
) -> Lpips:
    """The network from torchvision's state dict and LPIPS v0.1's heads in ``folder`` (``TRUNKS``), on ``device``.

    Raises UserError with the missing or unusable file; ``without`` says how to continue without LPIPS.
    """
    paths = [folder / name for name in (TRUNKS[net].features_file, TRUNKS[net].heads_file)]
    for path in paths:
        if not path.is_file():
            raise UserError(f"LPIPS needs {path}, which is missing; put it there or {without}")
    try:
        import torch
    except ModuleNotFoundError:
        raise UserError(
            f"LPIPS needs the package torch, which is not installed ({install_remedy('torch')}); get it or {without}"
        ) from None
    torch.set_num_threads(threads)
    read = []
    for path in paths:
        try:
            read.append(
                {
                    n: value.float().to(device)
                    for n, value in torch.load(path, map_location="cpu", weights_only=True).items()
                }
            )
        except Exception as error:
            raise UserError(
                f"{path} is not a readable state dict ({type(error).__name__}: {str(error).splitlines()[0]})"
            ) from None
    try:
        features, heads = read
        return Lpips(features, heads, net)
    except (KeyError, ValueError) as error:
        raise UserError(f"{paths[0]} and {paths[1]} are not what LPIPS v0.1 ({net}) is made of: {error}") from None
