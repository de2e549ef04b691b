# SPDX-License-Identifier: Apache-2.0
"""A factor: residuals of one kind of evidence about some of the unknowns, in standard deviations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Length of a complex step: the derivative is exact to rounding, so only underflow bounds it.
_STEP = 1e-30


@dataclass(frozen=True)
class Factor(ABC):
    """M residuals of D numbers, each on K unknowns.

    Attributes:
        columns: indices of the unknowns of each residual.
        freedom: degrees of freedom of Student's t distribution of the residuals: 4 where a few are gross errors; inf is
            normal.
    """

    columns: Integer[np.ndarray, "M K"]
    freedom: float

    @abstractmethod
    def residuals(self, at: Num[np.ndarray, "M K"], unknowns: Unknowns) -> Num[np.ndarray, "M D"]:
        """Residuals, in standard deviations, at values that may be complex; ``unknowns`` has the rotations."""

    def evaluate(self, unknowns: Unknowns) -> Num[np.ndarray, "M D"]:
        """Residuals in standard deviations."""
        return self.residuals(unknowns.values[self.columns], unknowns)

    def derivatives(self, unknowns: Unknowns, numbers: Integer[np.ndarray, " L"]) -> Num[np.ndarray, "M D L"]:
        """Derivatives of the residuals by ``numbers`` of their K unknowns, by complex steps."""
        at = unknowns.values[self.columns].astype(np.complex128)
        found = []
        for k in numbers:
            at[:, k] += 1j * _STEP
            found.append(self.residuals(at, unknowns).imag / _STEP)
            at[:, k] = at[:, k].real
        return np.stack(found, axis=-1) if found else np.zeros((*self.evaluate(unknowns).shape, 0))

    def cost(self, residuals: Num[np.ndarray, "M D"]) -> float:
        """Twice the negative log likelihood, up to a constant."""
        squared = (residuals**2).sum(1)
        if not np.isfinite(self.freedom):
            return float(squared.sum())
        return float(((self.freedom + residuals.shape[1]) * np.log1p(squared / self.freedom)).sum())

    def weights(self, residuals: Num[np.ndarray, "M D"]) -> Num[np.ndarray, " M"]:
        """Weight of each squared residual in the normal equations: small for gross errors."""
        if not np.isfinite(self.freedom):
            return np.ones(len(residuals))
        return (self.freedom + residuals.shape[1]) / (self.freedom + (residuals**2).sum(1))
