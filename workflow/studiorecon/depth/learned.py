# SPDX-License-Identifier: Apache-2.0
"""A network's depth of one plate as a likelihood: calibrated to the room from stereo, with its own uncertainty.

log z = log(g(d)) + f(u, v): d is the network's number, g its scale and shift (of depth or of inverse depth), f a smooth
field, because such networks err slowly over a picture. All are fitted robustly to what stereo measured and to the floor
and walls, which all cameras share. Held-out tiles measure the network's error in this scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.depth.depth_edges import edge_sigma, sharpen_depth
from studiorecon.geometry.depth_alignment import Alignment, align_depth
from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.images.sizes import corner_shares, resample_corners

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Output = Literal["auto", "metric", "affine", "inverse"]
"""What a network's number is: metres up to a scale, depth or inverse depth up to scale and shift; auto = as fits."""

# Nodes of the smooth field along the longer side. Floor and walls measure it nearly everywhere, so it may be finer than
# the bends of published networks (a third of a picture): of planted ones 0.2 % of depth remain, of six nodes 0.8 %.
_NODES = 12
# Standard deviations of the field (log depth) and of its change from node to node.
_FIELD, _FIELD_STEP = 0.1, 0.04
# Degrees of freedom of the residuals' t-distribution: objects before walls, wrong matches, blurred edges.
_FREEDOM = 3.0
_ROUNDS = 10
# Least standard deviation of log depth: floor and walls are placed in steps of 1 cm, a quarter of a per cent at 4 m.
_MIN_SIGMA = 0.005
# The held-out error that nine tenths stay below is so many standard deviations. Their median would call a network right
# that fits floor and walls by its field alone and is wrong about everything before them.
_SHARE_WITHIN, _WITHIN_SIGMAS = 0.9, 1.645
# Side of the tiles that are held out, as a share of the longer side.
_TILE_SHARE = 1 / 12
# Pixels so near to each other, as a share of the longer side, err together and count as one measurement.
_TOGETHER_SHARE = 0.02
_NEAR_M = 1e-3
# Standard deviation of the log depth of furniture that stereo found: boxes for what is no box.
_FURNITURE_SIGMA = 0.03
# Outliers before anything is measured: the share of right and of wrong objects, and how many tiles that is worth.
_PRIOR_RIGHT, _PRIOR_WRONG = 2.0, 1.0


@dataclass(frozen=True)
class Calibration:
    """From a network's numbers to metres: ``alignment`` is their scale and shift, ``inverse`` that of an inverse depth.

    ``nodes`` is the log of the smooth field, over the whole picture.
    """

    inverse: bool
    alignment: Alignment
    nodes: Float[np.ndarray, "R C"]

    def depth(self, estimate: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
        """Float32 depth in metres at any size; 0 = unknown."""
        flat = _aligned_depth(estimate, self.alignment, self.inverse)
        field = resample_corners(self.nodes, estimate.shape)
        return np.where(flat > 0, flat * np.exp(field), 0).astype(np.float32)

    def sharp_depth(
        self, estimate: Float[np.ndarray, "H W"], rgb: Float[np.ndarray, "H W 3"]
    ) -> Float[np.ndarray, "H W"]:
        """The same with its edges on those of the photo ``rgb`` (``depth_edges``)."""
        depth_m = self.depth(estimate)
        return np.where(depth_m > 0, sharpen_depth(_filled(depth_m), rgb), 0).astype(np.float32)


@dataclass(frozen=True)
class LearnedDepth:
    """A network's depth in metres with its uncertainty in this scene.

    Attributes:
        depth_m: float32; 0 = unknown.
        sigma: float32 standard deviation of log depth.
        outliers: probability that the network is wrong about an object: the share of measured surfaces before floor
            and walls that it misses by more than three standard deviations of both.
    """

    depth_m: Float[np.ndarray, "H W"]
    sigma: Float[np.ndarray, "H W"]
    outliers: float

    def misfit(self, depth_m: Float[np.ndarray, "... H W"]) -> Float[np.ndarray, "... H W"]:
        """Negative log-likelihood (nats above its least value) of surfaces at ``depth_m``; 0 where nothing is known.

        A mixture: normal about the network's depth, or anywhere within a factor e where the network is wrong.
        """
        known = (self.depth_m > 0) & (depth_m > 0)
        off = np.log(np.where(known, depth_m, 1) / np.where(known, self.depth_m, 1)) / self.sigma
        anywhere = self.outliers * self.sigma * np.sqrt(2 * np.pi)
        right = 1 - self.outliers
        nats = np.log(right + anywhere) - np.log(right * np.exp(-(off**2) / 2) + anywhere)
        return np.where(known, nats, 0).astype(np.float32)


def calibrate(
    estimate: Float[np.ndarray, "H W"],
    reference_m: Float[np.ndarray, "H W"],
    measured: Bool[np.ndarray, "H W"],
    room_m: Float[np.ndarray, "H W"],
    on_room: Bool[np.ndarray, "H W"],
    rgb: Float[np.ndarray, "H W 3"],
    output: Output,
) -> tuple[Calibration, LearnedDepth] | None:
    """The calibration and the network's depth, or None where nothing determines its unit.

    Args:
        estimate: the network's numbers; 0 = unknown.
        reference_m, measured: depth from stereo, and where another camera confirms it.
        room_m, on_room: depth of floor and walls alone, and pixels of ``reference_m`` on fitted ones.
        rgb: the photo.
        output: with "auto" depth and inverse depth are tried, and the better fit is taken.
    """
    outputs: tuple[Output, ...] = ("affine", "inverse") if output == "auto" else (output,)
    usable = measured | on_room
    found = [one for kind in outputs if (one := _fit_calibration(estimate, reference_m, usable, kind)) is not None]
    if not found:
        return None
    calibration, sigma = min(found, key=lambda one: float(np.median(one[1])))
    depth_m = calibration.sharp_depth(estimate, rgb)
    sigma = np.hypot(sigma, edge_sigma(_filled(calibration.depth(estimate))))
    objects = measured & (depth_m > 0) & (_log_difference(reference_m, room_m) > 4 * sigma)
    missed = float((_log_difference(reference_m, depth_m) > 3 * np.hypot(sigma, _FURNITURE_SIGMA))[objects].sum())
    tile = (_TOGETHER_SHARE * max(estimate.shape)) ** 2
    outliers = (missed / tile + _PRIOR_WRONG) / (objects.sum() / tile + _PRIOR_RIGHT + _PRIOR_WRONG)
    return calibration, LearnedDepth(depth_m, sigma, float(outliers))


def _filled(depth_m: np.ndarray) -> np.ndarray:
    """The depth with unknown pixels (0) at the median of the others."""
    known = depth_m > 0
    return np.where(known, depth_m, np.median(depth_m[known]) if known.any() else 1).astype(np.float32)


def _log_difference(first_m: np.ndarray, second_m: np.ndarray) -> np.ndarray:
    """(H, W) difference of log depth; 0 where one is unknown."""
    known = (first_m > 0) & (second_m > 0)
    return np.where(known, np.abs(np.log(np.where(known, first_m, 1) / np.where(known, second_m, 1))), 0)


def _fit_calibration(
    estimate: np.ndarray, reference_m: np.ndarray, room: np.ndarray, output: Output
) -> tuple[Calibration, np.ndarray] | None:
    usable = room & (estimate > 0) & (reference_m > 0)
    inverse = output == "inverse"
    target = np.where(reference_m > 0, 1 / np.where(reference_m > 0, reference_m, 1), 0) if inverse else reference_m
    if output == "metric" and usable.any():
        alignment = Alignment(float(np.median(reference_m[usable] / estimate[usable])), 0.0, "scale")
    else:
        alignment = align_depth(estimate, target, usable, np.random.default_rng(0))
    flat = _aligned_depth(estimate, alignment, inverse)
    usable &= flat > 0
    if alignment.model == "undetermined" or not usable.any():
        return None
    ratio = np.log(np.where(usable, reference_m, 1) / np.where(usable, flat, 1))
    basis, fold = _basis(estimate.shape), _folds(estimate.shape)
    held_out = []
    for k in (0, 1):
        nodes, _ = _field(basis, ratio, usable & (fold == k))
        there = usable & (fold != k)
        held_out.append(ratio[there] - np.tensordot(nodes, basis, 2)[there])
    off = np.abs(np.concatenate(held_out))
    least = max(float(np.quantile(off, _SHARE_WITHIN)) / _WITHIN_SIGMAS, _MIN_SIGMA)
    nodes, uncertain = _field(basis, ratio, usable)
    sigma = np.hypot(least, uncertain).astype(np.float32)
    return Calibration(inverse, alignment, nodes), sigma


def _aligned_depth(estimate: np.ndarray, alignment: Alignment, inverse: bool) -> np.ndarray:
    """(H, W) depth in metres before the smooth field; 0 = unknown."""
    made = alignment.apply(estimate, _NEAR_M)
    return np.where(made > 0, 1 / np.where(made > 0, made, 1), 0) if inverse else made


def _basis(shape: tuple[int, ...]) -> np.ndarray:
    """(R, C, H, W) float32 the part of every node of the field in every pixel."""
    rows, columns = (max(2, round(_NODES * side / max(shape))) for side in shape)
    return np.einsum("yr,xc->rcyx", corner_shares(rows, shape[0]), corner_shares(columns, shape[1]))


def _field(basis: np.ndarray, ratio: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R, C) the nodes of the smooth field, and (H, W) its standard deviation."""
    grid = np.arange(basis.shape[0] * basis.shape[1]).reshape(basis.shape[:2])
    beside = [np.stack(two, axis=-1).reshape(-1, 2) for two in ((grid[:, 1:], grid[:, :-1]), (grid[1:], grid[:-1]))]
    prior = np.eye(grid.size) / _FIELD**2
    for a, b in np.concatenate(beside):
        prior[[a, b], [a, b]] += 1 / _FIELD_STEP**2
        prior[[a, b], [b, a]] -= 1 / _FIELD_STEP**2
    every = basis.reshape(grid.size, -1)
    rows, target = every[:, usable.ravel()].T.astype(np.float64), ratio[usable]
    share = 1 / (_TOGETHER_SHARE * max(ratio.shape)) ** 2
    nodes, spread = np.zeros(grid.size), np.linalg.inv(prior)
    for _ in range(_ROUNDS if len(target) else 0):
        residual = target - rows @ nodes
        sigma = max(SIGMA_OF_MAD * float(np.median(np.abs(residual))), _MIN_SIGMA)
        weight = share * (_FREEDOM + 1) / (_FREEDOM + (residual / sigma) ** 2) / sigma**2
        spread = np.linalg.inv(rows.T @ (rows * weight[:, None]) + prior)
        nodes = spread @ (rows.T @ (weight * target))
    uncertain = np.sqrt(np.einsum("np,np->p", every, spread @ every)).reshape(ratio.shape)
    return nodes.reshape(grid.shape), uncertain


def _folds(shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) 0 or 1: a chequerboard of tiles, one half of which judges what the other fitted."""
    side = max(4, round(_TILE_SHARE * max(shape)))
    rows, columns = np.indices(shape)
    return (rows // side + columns // side) % 2
