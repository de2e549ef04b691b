# SPDX-License-Identifier: Apache-2.0
"""Scene units per metre, from the bones of people of known size, or "undetermined" where bones do not decide.

The paper's s* = argmin Σ ρ(‖Jʷᵢ − Jʷⱼ‖ − s ‖Jˢᵢ − Jˢⱼ‖), with a Huber ρ whose delta grows with the bone and the scale
(S01), solved by reweighting from the median ratio instead of L-BFGS (S02, U35). There is one scale per scene. Every
person's own ratio is returned with it as a check (U36), because a free scale per person cannot be separated from their
height (S06).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import SIGMA_OF_MAD

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Share of a bone's expected length within which a residual counts as noise.
_DELTA_SHARE = 0.1
_MIN_BONES = 4
_SMALLEST, _LARGEST = 1e-6, 1e6


@dataclass(frozen=True)
class SceneScale:
    """The scale, or the reason why it is undetermined.

    Attributes:
        world_per_metre: scene units per metre; NaN when undetermined. Divide scene coordinates by it to get metres.
        spread: robust relative standard deviation of single bones about the scale; NaN when undetermined.
        bones: number of different bones that were measured at least once.
        per_person: every person's own ratio to the scene's scale, NaN where undetermined; a hint at wrong heights.
        reason: one clause why the scale is undetermined; empty when it is determined.
    """

    world_per_metre: float
    spread: float
    bones: int
    per_person: Num[np.ndarray, " P"]
    reason: str

    @property
    def determined(self) -> bool:
        return not self.reason


def scene_scale(
    joints: Num[np.ndarray, "P T J 3"],
    template_joints_m: Num[np.ndarray, "P J 3"],
    bones: Num[np.ndarray, "B 2"],
    valid: Bool[np.ndarray, "P T J"],
    sigma: Num[np.ndarray, "P T J"] | float = 0.0,
    least_bone_m: float = 0.2,
) -> SceneScale:
    """Scale of triangulated ``joints`` in scene units against template joints in metres.

    ``bones`` are pairs of joints; joints that are not finite count as not measured. ``sigma`` is their standard
    deviation per coordinate in scene units: noise makes bones longer by (σᵢ² + σⱼ²)/b on average, which is subtracted
    (S05). Bones shorter than ``least_bone_m`` in the template are left out, because noise would be most of their length
    (S04, S05). Undetermined with fewer than 4 different bones or a scale outside 1e-6 to 1e6 (S03). Raises ValueError
    that names the argument when shapes do not fit or the template is not finite.
    """
    sizes = require("joints", joints, ("P", "T", "J", 3))
    sizes = require("template_joints_m", template_joints_m, ("P", "J", 3), sizes, finite=True)
    require("bones", bones, ("B", 2))
    require("valid", valid, ("P", "T", "J"), sizes)
    sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), np.shape(valid))
    measured = np.asarray(valid, dtype=bool) & np.isfinite(joints).all(-1) & np.isfinite(sigma)
    # Replace the input, not the output.
    place, sigma = np.where(measured[..., None], joints, 0.0).astype(np.float64), np.where(measured, sigma, 0.0)
    first, second = np.asarray(bones).T
    template = np.linalg.norm(template_joints_m[:, first] - template_joints_m[:, second], axis=-1)  # (P, B)
    length = np.linalg.norm(place[:, :, first] - place[:, :, second], axis=-1)  # (P, T, B)
    usable = measured[:, :, first] & measured[:, :, second] & (template > least_bone_m)[:, None]
    person, _, bone = np.nonzero(usable)
    variance = (sigma[:, :, first] ** 2 + sigma[:, :, second] ** 2)[usable]
    ratios = np.full(sizes["P"], np.nan)
    kinds = len(np.unique(bone))
    if kinds < _MIN_BONES:
        reason = f"only {kinds} different bones longer than {least_bone_m} m were measured, {_MIN_BONES} are needed"
        return SceneScale(np.nan, np.nan, kinds, ratios, reason)
    expected, seen = template[person, bone], length[usable]
    scale = fit_scale(seen, expected, variance)
    if not _SMALLEST < scale < _LARGEST:
        return SceneScale(
            np.nan, np.nan, kinds, ratios, f"the bones would give a scale of {scale:.3g}, which is no length"
        )
    for p in range(sizes["P"]):
        own = person == p
        if len(np.unique(bone[own])) >= _MIN_BONES:
            ratios[p] = fit_scale(seen[own], expected[own], variance[own]) / scale
    off = (seen - variance / (scale * expected)) / (scale * expected) - 1
    return SceneScale(scale, SIGMA_OF_MAD * float(np.median(np.abs(off))), kinds, ratios, "")


def fit_scale(
    lengths: Num[np.ndarray, " N"], template_m: Num[np.ndarray, " N"], variance: Num[np.ndarray, " N"]
) -> float:
    """The s that minimises Σ ρ(length − variance / (s b) − s b) over bones of template length b; 0 for lengths 0.

    ``variance`` is the sum of the two ends' variances per coordinate: E‖b + n‖ = b + v/b up to exp(−b²/2v). Delta is a
    tenth of the bone's expected length at the median ratio. Iteratively reweighted from the median; 1e-9 or better, at
    any scale. Raises ValueError for other shapes and numbers that are not finite and, in the template, positive.
    """
    sizes = require("lengths", lengths, ("N",), finite=True)
    require("template_m", template_m, ("N",), sizes, finite=True)
    require("variance", variance, ("N",), sizes, finite=True)
    scale = float(np.median(lengths / template_m))
    if not scale > 0:
        return scale
    # In units of the median ratio the problem is the same at every scale (S01).
    unit, scaled, noise = scale, lengths / scale, variance / scale**2
    delta, scale = _DELTA_SHARE * template_m, 1.0
    for _ in range(200):
        expected = scale * template_m
        # A bone as short as its noise is not informative: the correction is at most half of it.
        corrected = scaled - np.minimum(noise / expected, 0.5 * scaled)
        residual = corrected - expected
        weight = delta / np.maximum(np.abs(residual), delta)
        new = float((weight * corrected * template_m).sum() / (weight * template_m**2).sum())
        if abs(new - scale) <= 1e-13 * scale:
            return new * unit
        scale = new
    return scale * unit
