# SPDX-License-Identifier: Apache-2.0
"""Factor of the lower foot of people who stand or walk: it is on one flat floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Standard deviation of the lower ankle's height while walking, metres: it rolls over the foot.
STEP_M = 0.03
# People jump, climb and sit on tables.
_FREEDOM = 3.0


@dataclass(frozen=True)
class FeetOnFloor(Factor):
    """Heights of points above an unknown plane: columns of a point and of the group "floor" (two slopes and a height).

    Attributes:
        axes: rows: two directions along the floor at first, and its normal.
        repeats: number of feet in the same place and posture.
    """

    axes: Num[np.ndarray, "3 3"]
    repeats: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 6"], unknowns: Unknowns) -> Num[np.ndarray, "M 1"]:
        along = at[:, :3] @ self.axes.T
        height = along[:, 2] - at[:, 3] * along[:, 0] - at[:, 4] * along[:, 1] - at[:, 5]
        return (height / STEP_M / np.sqrt(self.repeats))[:, None]


def feet_on_floor(
    unknowns: Unknowns, ankle: Integer[np.ndarray, " M"], axes: Num[np.ndarray, "3 3"], repeats: Num[np.ndarray, " M"]
) -> FeetOnFloor:
    """The factor of the lower ankles, points ``ankle``, on the plane of the group "floor"."""
    points = unknowns.columns("points", ankle, range(3), 3)
    floor = np.repeat(unknowns.columns("floor", 0, range(3), 3), len(points), axis=0)
    return FeetOnFloor(np.concatenate([points, floor], axis=1), _FREEDOM, axes, repeats)
