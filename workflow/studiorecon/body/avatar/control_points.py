# SPDX-License-Identifier: Apache-2.0
"""Control points: a few hundred points on the body that carry slow changes, and every Gaussian's share in them.

Light and folds vary over a person about as coarsely as a hand is wide. So the network is evaluated at some hundred
points and its output is interpolated to thousands of Gaussians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num, Shaped

# Number of control points that a Gaussian interpolates.
_NEAREST = 4


@dataclass(frozen=True)
class ControlPoints:
    """M control points in the rest pose, metres; the nearest of each Gaussian, and their shares, which sum to 1."""

    points_m: Float[np.ndarray, "M 3"]
    near: Integer[np.ndarray, "N 4"]
    shares: Float[np.ndarray, "N 4"]

    @classmethod
    def on(cls, means_m: Num[np.ndarray, "N 3"], count: int) -> ControlPoints:
        """``count`` of the positions ``means_m``, as far apart as possible, and the shares of all N Gaussians in them.

        A share falls to 0 where the next point takes over, so that neighbouring Gaussians do not differ by a step. The
        same positions give the same points; with fewer than ``count``, all of them are points.
        """
        means = np.asarray(means_m, np.float64)
        points = means[farthest_point_sample(means, count)]
        neighbours = min(_NEAREST + 1, len(points))
        distance, near = scipy.spatial.cKDTree(points).query(means, k=neighbours)
        distance, near = distance.reshape(len(means), neighbours), near.reshape(len(means), neighbours)
        if neighbours > _NEAREST:
            shares = np.square(1 - distance / np.maximum(distance[:, -1:], 1e-9))[:, :_NEAREST]
        else:
            # With so few points none takes over from another: the nearest has the largest share. Padding gives all rows
            # one length.
            padding = ((0, 0), (0, _NEAREST - neighbours))
            shares, near = np.pad(1 / np.maximum(distance, 1e-9), padding), np.pad(near, padding)
        total = shares.sum(axis=1, keepdims=True)
        shares = np.where(total > 1e-12, shares / np.maximum(total, 1e-12), np.eye(_NEAREST)[0])
        return cls(points, near[:, :_NEAREST].astype(np.int32), shares.astype(np.float32))

    def spread(self, values: Num[np.ndarray, "M C"]) -> Float[np.ndarray, "N C"]:
        """Values at the Gaussians, float32, interpolated from those at the points."""
        from studiorecon.body.avatar import kernels

        out = np.empty((len(self.near), values.shape[1]), np.float32)
        kernels.spread(self.near, self.shares, np.ascontiguousarray(values, np.float32), out)
        return out

    def gather_gradient(self, gradient: Num[np.ndarray, "N C"]) -> Float[np.ndarray, "M C"]:
        """Gradient by the points' values, float32, from that by the Gaussians'; NaN and inf count 0."""
        from studiorecon.body.avatar import kernels

        out = np.zeros((len(self.points_m), gradient.shape[1]), np.float32)
        kernels.gather(self.near, self.shares, np.ascontiguousarray(gradient, np.float32), out)
        return out

    def to_arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """The arrays to store in a file."""
        return {"points_m": self.points_m, "near": self.near, "shares": self.shares}

    @classmethod
    def from_arrays(cls, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> ControlPoints | None:
        """The inverse of ``to_arrays``, None without control points; raises ValueError for indices out of range."""
        if "points_m" not in held:
            return None
        if held["near"].size and held["near"].max() >= len(held["points_m"]):
            raise ValueError(f"near names point {held['near'].max()} of {len(held['points_m'])}")
        return cls(held["points_m"], held["near"], held["shares"])


def farthest_point_sample(points_m: Num[np.ndarray, "N 3"], count: int) -> Integer[np.ndarray, " K"]:
    """Indices of ``count`` points (or all) by farthest-point sampling, beginning with the one nearest to their mean."""
    chosen = np.empty(min(count, len(points_m)), np.int64)
    chosen[0] = np.square(points_m - points_m.mean(axis=0)).sum(axis=1).argmin()
    gap = np.full(len(points_m), np.inf)
    for k in range(1, len(chosen)):
        gap = np.minimum(gap, np.square(points_m - points_m[chosen[k - 1]]).sum(axis=1))
        chosen[k] = gap.argmax()
    return chosen
