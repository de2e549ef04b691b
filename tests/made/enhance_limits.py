# SPDX-License-Identifier: Apache-2.0
"""What tests of enhance limits and their neighbours share."""

from __future__ import annotations

from studiorecon.recursive.injection import Injection

PAPER = Injection(
    history=3,
    strength=0.3,
    moving_strength=0.3,
    decay=0.5,
    error_threshold=30.0,
    blur_px=11,
    blur_sigma_px=2.0,
    form="residual",
    settle=False,
    check=True,
    cut_share=0.1,
)
