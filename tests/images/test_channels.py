# SPDX-License-Identifier: Apache-2.0
"""Sums and maxima over channels are numpy's own, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.images.channels import channel_max, channel_sum


@pytest.mark.parametrize("shape", [(37, 53, 3), (5, 2), (2, 3, 4, 7), (0, 4, 3)])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_numpys_own_reductions_to_the_bit(shape: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(0)
    picture = (rng.normal(size=shape) * 10.0 ** rng.integers(-6, 6, shape)).astype(kind)
    if picture.size:
        picture.flat[0], picture.flat[-1] = np.nan, -np.inf
    assert channel_sum(picture).tobytes() == picture.sum(axis=-1).tobytes()
    assert channel_max(picture).tobytes() == picture.max(axis=-1).tobytes()
