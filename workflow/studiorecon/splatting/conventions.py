# SPDX-License-Identifier: Apache-2.0
"""Constants every kernel shares: sizes of tiles and records, thresholds of alpha blending, how kernels are compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

LANES = 16
"""float32 numbers per vector: sixteen pixels of a 4×4 block, or sixteen Gaussians of a parameter block."""
TILE_PX = 16
"""Side of a tile. 8 loses 10–20 %, 32 gains nothing."""
BLOCK_PX = 4
"""Side of a pixel block, the unit of skipping. 4×4 leaves fewer lanes idle than 8×2 or 16×1."""
BLOCKS_PER_SIDE = TILE_PX // BLOCK_PX
BLOCKS = BLOCKS_PER_SIDE * BLOCKS_PER_SIDE
ALL_LANES = (1 << LANES) - 1

ALPHA_LOG2_MIN = np.float32(-7.994353436858858)
"""log2(1/255): a splat fainter than that at a pixel is skipped there, as in 3DGS."""
ALPHA_MAX = np.float32(0.999)
"""Alpha is cut here, as in gsplat, so that the transmittance never reaches zero."""
TRANSMITTANCE_MIN = np.float32(1e-4)
"""A pixel is finished when the next transmittance would not be above this."""
DILATION_PX2 = np.float32(0.3)
"""Added to the variance of every projected splat, as in 3DGS: no splat is thinner than a pixel."""
FRAME_MARGIN = np.float32(0.15)
"""The projection is linearised at most this share of the frame outside it (gsplat's 0.3 of half a frame)."""
LOG2_E = np.float32(1.4426950408889634)

# Rows of one parameter block of 16 Gaussians; a row is a vector of 16 floats (one cache line).
MEAN, SCALE, QUATERNION, OPACITY, SH = 0, 3, 6, 10, 11
SH_BANDS = 16
ROWS = SH + 3 * SH_BANDS
BLOCK_FLOATS = ROWS * LANES

# Fields of one splat record of 16 floats (one cache line): centre, ellipse (see projection), log2 opacity, colour,
# depth, half extents, and from MORE on three values of the caller's own.
X, Y, ELLIPSE_A, ELLIPSE_K, ELLIPSE_C, OPACITY_LOG2, RED, GREEN, BLUE, DEPTH, HALF_WIDTH, HALF_HEIGHT, MORE = range(13)
RECORD = 16

# The camera vector that kernels take: rotation (row-major, 0–8), translation (9–11), focal lengths, principal point,
# size, near, centre, tangents (left, right, top, bottom) where the projection stops being linearised further out, and 1
# for energy compensation.
FOCAL, PRINCIPAL, SIZE, NEAR, CENTRE, LIMITS, COMPENSATED = 12, 14, 16, 18, 19, 22, 26
CAMERA_FLOATS = 27

SANE = np.float32(1e7)
"""Metres, pixels or colour beyond which a Gaussian is refused: float32 has no resolution left, and integer pixel
indices overflow."""
PAIRS_MAX = 1 << 28
"""Splat–tile pairs of one image; beyond 2 GB of lists the scene is broken, not detailed."""

PIECE = 32
"""Blocks that one thread takes at a time. The loop over them is a function of its own: a parallel one takes twice as
long to compile."""

# No reassociation: sums replay bit for bit. No nnan/ninf: NaN inputs must be caught by comparisons, not be undefined.
KERNEL: dict[str, Any] = {"cache": True, "fastmath": {"nsz", "contract"}, "error_model": "numpy", "boundscheck": False}
# parallel=True is for loops that run at every step: it doubles a kernel's time to compile.
INLINE: dict[str, Any] = {**KERNEL, "forceinline": True}
