# SPDX-License-Identifier: Apache-2.0
"""Random weights in the shape of VGG16 and of LPIPS' heads, for tests and timings of the perceptual term."""

from __future__ import annotations

from typing import Any

from studiorecon.models.lpips import CHANNELS, STAGES


def random_weights(kind: Any, seed: int = 0) -> tuple[dict[str, Any], dict[str, Any]]:
    """State dicts (features, heads) of dtype ``kind``: convolutions that keep the variance, heads that are not negative."""
    import torch

    generator, features, heads, before = torch.Generator().manual_seed(seed), {}, {}, 3
    for depth, (indices, channels) in enumerate(zip(STAGES, CHANNELS)):
        for index in indices:
            spread = (2 / (9 * before)) ** 0.5
            features[f"features.{index}.weight"] = spread * torch.randn(channels, before, 3, 3, generator=generator, dtype=kind)
            features[f"features.{index}.bias"] = 0.1 * torch.randn(channels, generator=generator, dtype=kind)
            before = channels
        heads[f"lin{depth}.model.1.weight"] = torch.rand(1, channels, 1, 1, generator=generator, dtype=kind)
    return features, heads
