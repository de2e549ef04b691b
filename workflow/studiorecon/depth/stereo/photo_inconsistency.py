# SPDX-License-Identifier: Apache-2.0
"""Where a photo is not explained: what the surface in every pixel costs in the other photos, and the superpixels that
cost too much."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.stereo.patches import UNSEEN
from studiorecon.depth.stereo.plates import Picture
from studiorecon.images.channels import channel_sum
from studiorecon.images.warp import sample

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Superpixels are this share of the picture's width wide: one texture's detail, and a piece of furniture's side.
SIZES = (1 / 20, 1 / 10)
_COMPACTNESS = 12.0
# A region is looked at when its pixels cost more than this in the mean, and when such shares are known and textured.
_UNEXPLAINED, _LEAST_KNOWN, _LEAST_TEXTURED, LEAST_PIXELS = 0.4, 0.9, 0.5, 24
# As in passes.py and matching.py.
_HIDING_SHARE, _HIDING_M = 0.04, 0.05
_FLAT_VARIANCE, _MOST_DIFFERENCE, _MOST_COST, _LEAST_SHARE = 4e-4, 0.6, 1.2, 0.35


def surface_cost(
    picture: Picture,
    depth_m: Float[np.ndarray, "H W"],
    others: Sequence[tuple[Picture, Float[np.ndarray, "h w"]]],
    window: int,
    mean_weight: float,
) -> tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """(H, W) float32 cost of a surface in the mean over the other pictures (with their depths) that see it, and (H, W)
    bool: one does."""
    total, judges = np.zeros(depth_m.shape, np.float32), np.zeros(depth_m.shape, np.float32)
    points_m = picture.camera.unproject(picture.camera.pixel_centres(), depth_m)
    for other, surface_m in others:
        pixels, z = other.camera.project(points_m)
        colours, inside = sample(other.rgb, pixels)
        known, _ = sample(other.known.astype(np.float32), pixels)
        there, _ = sample(surface_m, pixels, "nearest")
        usable = inside & (known > 0.99) & (depth_m > 0) & (z > 0) & picture.known
        score = _correlation(
            picture.rgb, np.where(usable[..., None], colours, 0).astype(np.float32), usable, window, mean_weight
        )
        seen = usable & (score > -np.inf) & ~((there > 0) & (there < z * (1 - _HIDING_SHARE) - _HIDING_M))
        total += np.where(seen, np.clip(1 - score, 0, _MOST_COST), 0)
        judges += seen
    return np.where(judges > 0, total / np.maximum(judges, 1), UNSEEN).astype(np.float32), judges > 0


def _correlation(a: np.ndarray, b: np.ndarray, usable: np.ndarray, window: int, mean_weight: float) -> np.ndarray:
    """(H, W) windowed correlation over the usable pixels, less the difference of means; -inf with too few."""
    mask = usable.astype(np.float32)
    a = a * mask[..., None]
    share = cv2.blur(mask, (window, window), borderType=cv2.BORDER_CONSTANT)
    scale = 1 / np.maximum(share, 1e-6)
    ma, mb = (cv2.blur(x, (window, window), borderType=cv2.BORDER_CONSTANT) * scale[..., None] for x in (a, b))
    products = np.stack([channel_sum(a * a), channel_sum(b * b), channel_sum(a * b)], axis=-1)
    aa, bb, ab = np.moveaxis(
        cv2.blur(products, (window, window), borderType=cv2.BORDER_CONSTANT) * scale[..., None], -1, 0
    )
    va, vb = np.maximum(aa - channel_sum(ma * ma), 0), np.maximum(bb - channel_sum(mb * mb), 0)
    apart = np.minimum(channel_sum(np.abs(ma - mb)), _MOST_DIFFERENCE)
    score = (ab - channel_sum(ma * mb) + _FLAT_VARIANCE) / np.sqrt(
        (va + _FLAT_VARIANCE) * (vb + _FLAT_VARIANCE)
    ) - mean_weight * apart
    return np.where(usable & (share >= _LEAST_SHARE), score, -np.inf)


def superpixels(rgb: Float[np.ndarray, "H W 3"], size: int) -> Integer[np.ndarray, "H W"]:
    """(H, W) int: pieces of one colour, about ``size`` pixels wide."""
    lab = cv2.cvtColor(np.clip(rgb, 0, 1).astype(np.float32), cv2.COLOR_RGB2Lab)
    pieces = cv2.ximgproc.createSuperpixelSLIC(lab, cv2.ximgproc.SLIC, size, _COMPACTNESS)
    pieces.iterate(10)
    pieces.enforceLabelConnectivity(25)
    return pieces.getLabels()


def unexplained(picture: Picture, cost: Float[np.ndarray, "H W"], window: int) -> list[Bool[np.ndarray, "H W"]]:
    """Masks (H, W) of the regions whose pixels are known and textured but cost too much as they are."""
    found = []
    textured = picture.textured(window)
    for share in SIZES:
        pieces = superpixels(picture.rgb, max(round(share * picture.camera.wh[0]), 6))
        count = np.bincount(pieces.ravel())
        known, detail, price = (
            np.bincount(pieces.ravel(), weights=x.ravel().astype(np.float64)) / np.maximum(count, 1)
            for x in (picture.known, textured, cost)
        )
        wanted = (
            (count >= LEAST_PIXELS) & (known >= _LEAST_KNOWN) & (detail >= _LEAST_TEXTURED) & (price > _UNEXPLAINED)
        )
        found += [pieces == k for k in np.flatnonzero(wanted)]
    return found
