# SPDX-License-Identifier: Apache-2.0
"""What a window says about a surface: one negative log-likelihood ratio in nats, for every surface of the room.

The log of how much likelier a score is where the surface is right than where it is 7 to 40 % off falls on a straight
line over all scores from -0.2 to 1 (``python -m benchmarks.depth_likelihood``). A pixel that nothing judges has 0 nats.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from jaxtyping import Float

# Slope of the line, nats per unit of score, and the score that is as likely on a wrong surface as on the right one.
NATS_PER_SCORE, EVEN_SCORE = np.float32(7.0), np.float32(0.32)
# Lower scores say no more.
LEAST_SCORE = np.float32(-0.2)
# Variance of a window (summed over channels) that noise alone gives: a flat window agrees with every other one, so its
# correlation is drawn towards the even score.
NOISE_VARIANCE = np.float32(1e-3)
# Limit of the mean difference's part in the score: beyond it the windows differ anyway.
MAX_DIFFERENCE = np.float32(0.6)
# A pixel is on a surface that its window makes ten times likelier.
CONFIDENT = -np.log(10)
UNKNOWN = np.float32(-9)


def nats_of_score(score: Float[np.ndarray, "*P"]) -> Float[np.ndarray, "*P"]:
    """Negative log-likelihood ratio of a surface by its score; below 0 = the surface is there, 0 where unknown."""
    return np.where(score > UNKNOWN, NATS_PER_SCORE * (EVEN_SCORE - np.maximum(score, LEAST_SCORE)), np.float32(0))


@njit(cache=True, fastmath=True)
def score_of_window(va, vb, cov, apart, mean_weight):
    """Score, at most 1, of a window with these variances, covariance (sums over channels) and difference of means."""
    spread = np.sqrt((max(va, np.float32(0)) + NOISE_VARIANCE) * (max(vb, np.float32(0)) + NOISE_VARIANCE))
    return (cov + EVEN_SCORE * NOISE_VARIANCE) / spread - mean_weight * min(apart, MAX_DIFFERENCE)


@njit(cache=True, fastmath=True)
def nats_of_window(va, vb, cov, apart, mean_weight):
    """``nats_of_score`` of one window."""
    score = score_of_window(va, vb, cov, apart, mean_weight)
    return np.float32(NATS_PER_SCORE * (EVEN_SCORE - max(score, LEAST_SCORE)))
