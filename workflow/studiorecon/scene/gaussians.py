# SPDX-License-Identifier: Apache-2.0
"""A set of 3D Gaussians in the form of 3DGS: log scales, logit opacities, spherical harmonics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic: colour = 0.5 + SH_C0 · sh[0] + higher bands."""

# A logit that no rasteriser draws: opacity 1e-13.
_UNDRAWN = -30.0


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians in the world; all arrays are float32.

    Attributes:
        means_m: metres.
        quaternions: (w, x, y, z), any norm: rotation world_from_gaussian.
        log_scales: natural logarithm of the standard deviations in metres.
        sh: (N, (degree + 1)², 3) spherical harmonics, 3DGS order and signs.
    """

    means_m: Float[np.ndarray, "N 3"]
    quaternions: Float[np.ndarray, "N 4"]
    log_scales: Float[np.ndarray, "N 3"]
    logit_opacities: Float[np.ndarray, " N"]
    sh: Float[np.ndarray, "N B 3"]

    def __post_init__(self) -> None:
        count = len(self.means_m)
        bands = self.sh.shape[1] if self.sh.ndim == 3 else 0
        expected = {"means_m": (count, 3), "quaternions": (count, 4), "log_scales": (count, 3), "sh": (count, bands, 3)}
        expected["logit_opacities"] = (count,)
        for name, shape in expected.items():
            value = getattr(self, name)
            if value.shape != shape:
                raise ValueError(f"{name} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, name, np.ascontiguousarray(value, dtype=np.float32))
        if bands not in (1, 4, 9, 16):
            raise ValueError(f"sh has {bands} coefficients per channel; expected 1, 4, 9 or 16")

    @property
    def count(self) -> int:
        return len(self.means_m)

    @property
    def sh_degree(self) -> int:
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    @property
    def unit_quaternions(self) -> Float[np.ndarray, "N 4"]:
        """Float32 w, x, y, z of length 1."""
        return self.quaternions / np.linalg.norm(self.quaternions, axis=1, keepdims=True).clip(1e-12)

    @property
    def opacities(self) -> Float[np.ndarray, " N"]:
        """Float32 in 0..1."""
        from scipy.special import expit  # imported here: containers of networks read Gaussians and have no scipy

        return expit(self.logit_opacities).astype(np.float32)

    def take(self, index: Integer[np.ndarray, " M"] | Bool[np.ndarray, " N"]) -> Gaussians:
        """The Gaussians at ``index`` (integers or a boolean mask), in that order."""
        return Gaussians(*(getattr(self, field.name)[index] for field in fields(self)))

    def undrawn(self) -> Gaussians:
        """The same number of Gaussians, all invisible: it keeps the place of an absent person in a composite."""
        return replace(self, logit_opacities=np.full(self.count, _UNDRAWN, np.float32))

    def with_sh_degree(self, degree: int) -> Gaussians:
        """The same Gaussians with more (zero) or fewer (cut) spherical harmonics."""
        bands = (degree + 1) ** 2
        sh = np.zeros((self.count, bands, 3), np.float32)
        kept = min(bands, self.sh.shape[1])
        sh[:, :kept] = self.sh[:, :kept]
        return replace(self, sh=sh)


def sh_from_rgb(rgb: Num[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """The constant spherical harmonic that is displayed as ``rgb``."""
    return ((np.asarray(rgb, np.float64) - 0.5) / SH_C0).astype(np.float32)


def empty(sh_degree: int) -> Gaussians:
    """A set without Gaussians."""
    return Gaussians(
        np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, (sh_degree + 1) ** 2, 3))
    )


def concatenate(sets: Sequence[Gaussians]) -> Gaussians:
    """All sets in one, in order; harmonics are padded with zeros to the highest degree among them."""
    if not sets:
        return empty(0)
    degree = max(s.sh_degree for s in sets)
    padded = [s.with_sh_degree(degree) for s in sets]
    return Gaussians(*(np.concatenate([getattr(s, field.name) for s in padded]) for field in fields(Gaussians)))
