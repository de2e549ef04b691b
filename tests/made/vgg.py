# SPDX-License-Identifier: Apache-2.0
"""Random weights in the shape of VGG16 or AlexNet and of LPIPS' heads, for tests and timings of the perceptual term."""

from __future__ import annotations

from typing import Any

from studiorecon.models.adapters.lpips import TRUNKS, Net


def random_weights(kind: Any, seed: int = 0, net: Net = "vgg") -> tuple[dict[str, Any], dict[str, Any]]:
    """State dicts (features, heads) of dtype ``kind``: convolutions that keep the variance, heads that are not
    negative."""
    import torch

    generator, features, heads, before = torch.Generator().manual_seed(seed), {}, {}, 3
    for depth, stage in enumerate(TRUNKS[net].stages):
        for c in stage:
            spread = (2 / (c.size**2 * before)) ** 0.5
            shape = c.channels, before, c.size, c.size
            features[f"features.{c.index}.weight"] = spread * torch.randn(shape, generator=generator, dtype=kind)
            features[f"features.{c.index}.bias"] = 0.1 * torch.randn(c.channels, generator=generator, dtype=kind)
            before = c.channels
        heads[f"lin{depth}.model.1.weight"] = torch.rand(1, before, 1, 1, generator=generator, dtype=kind)
    return features, heads
