# SPDX-License-Identifier: Apache-2.0
"""LPIPS v0.1 on VGG16 (Zhang et al., CVPR 2018), as a distance with a gradient; the weights are the user's own files.

Two pictures go through the convolutions of VGG16; at five depths the features are normalised per pixel, their squared difference is
weighed per channel by a linear head and averaged over the picture. It satisfies ``splatting.perceptual.Perceptual``.

Cost: the design measured 235 ms for the VGG16 trunk alone, one 320×176 picture forward and back on two idle cores, against 6 ms for all
else of a training step; a 96×96 crop has a sixth of the pixels. ``python -m tests.bench.training --lpips`` measures it here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal

STAGES = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
"""Indices of the convolutions among torchvision's ``vgg16().features``, by depth; a pooling stands before every depth but the first."""
CHANNELS = (64, 128, 256, 512, 512)
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""LPIPS' own standardisation of pictures in [−1, 1]."""
NORM_EPSILON = 1e-10
FEATURES_FILE, HEADS_FILE = "vgg16.pth", "lpips_vgg.pth"


class Lpips:
    """The distance, from state dicts under the names of torchvision's VGG16 (``features.N.weight``) and of LPIPS (``linN.model.1.weight``).

    It computes in the dtype of the weights. Raises KeyError for a missing entry and ValueError for one of a wrong shape.
    """

    def __init__(self, features: Mapping[str, Any], heads: Mapping[str, Any]) -> None:
        before = 3
        self._stages, self._heads = [], []
        for depth, (indices, channels) in enumerate(zip(STAGES, CHANNELS)):
            stage = []
            for index in indices:
                weight, bias = (features[f"features.{index}.{kind}"].detach() for kind in ("weight", "bias"))
                if tuple(weight.shape) != (channels, before, 3, 3):
                    raise ValueError(f"features.{index}.weight has shape {tuple(weight.shape)}, expected {(channels, before, 3, 3)}")
                stage.append((weight, bias))
                before = channels
            head = heads[f"lin{depth}.model.1.weight"].detach()
            if head.numel() != channels:
                raise ValueError(f"lin{depth}.model.1.weight has shape {tuple(head.shape)}, expected (1, {channels}, 1, 1)")
            self._stages.append(stage)
            self._heads.append(head.reshape(1, channels, 1, 1))

    def distance(self, rendered: Any, target: Any) -> Any:
        """The distance of two tensors (1, 3, h, w) in [0, 1], which are first rescaled to [−1, 1] (numerics U12); sides at least 16."""
        total = 0.0
        for ours, theirs, head in zip(self._features(rendered), self._features(target), self._heads):
            total = total + (head * (normalised(ours) - normalised(theirs)) ** 2).sum(dim=1).mean()
        return total

    def _features(self, picture: Any) -> Sequence[Any]:
        from torch.nn.functional import conv2d, max_pool2d, relu

        shift, scale = (picture.new_tensor(value).reshape(1, 3, 1, 1) for value in (SHIFT, SCALE))
        x, taken = (2 * picture - 1 - shift) / scale, []
        for depth, stage in enumerate(self._stages):
            x = max_pool2d(x, 2) if depth else x
            for weight, bias in stage:
                x = relu(conv2d(x, weight, bias, padding=1))
            taken.append(x)
        return taken

    def __call__(self, rendered: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray]:
        """Distance of two (h, w, 3) float32 RGB pictures in [0, 1], and its gradient (h, w, 3) by ``rendered``."""
        import torch

        kind = self._heads[0].dtype
        ours, theirs = (torch.from_numpy(np.ascontiguousarray(p.transpose(2, 0, 1)))[None].to(kind) for p in (rendered, target))
        ours.requires_grad_(True)
        distance = self.distance(ours, theirs)
        (gradient,) = torch.autograd.grad(distance, ours)
        return distance.item(), np.ascontiguousarray(gradient[0].numpy().transpose(1, 2, 0).astype(np.float32))


def normalised(features: Any) -> Any:
    """(1, C, h, w) features over their length per pixel; epsilon stands inside the root, whose slope at 0 is infinite (numerics I06)."""
    return features / (features.square().sum(dim=1, keepdim=True) + NORM_EPSILON).sqrt()


def read_lpips(folder: Path, threads: int) -> Lpips:
    """The network from ``vgg16.pth`` (torchvision's state dict) and ``lpips_vgg.pth`` (LPIPS v0.1's heads) in ``folder``.

    Raises Refusal that names the file which is missing or unusable.
    """
    paths = [folder / name for name in (FEATURES_FILE, HEADS_FILE)]
    for path in paths:
        if not path.is_file():
            raise Refusal(f"the LPIPS term needs {path}, which is missing; put it there or set lpips.weight to 0")
    try:
        import torch
    except ModuleNotFoundError:
        raise Refusal("the LPIPS term needs the package torch, which is not installed; install it or set lpips.weight to 0") from None
    torch.set_num_threads(threads)
    read = []
    for path in paths:
        try:
            read.append({name: value.float() for name, value in torch.load(path, map_location="cpu", weights_only=True).items()})
        except Exception as error:
            raise Refusal(f"{path} is not a readable state dict ({type(error).__name__}: {str(error).splitlines()[0]})") from None
    try:
        return Lpips(*read)
    except (KeyError, ValueError) as error:
        raise Refusal(f"{paths[0]} and {paths[1]} are not VGG16 and LPIPS v0.1: {error}") from None
