# SPDX-License-Identifier: Apache-2.0
"""Space that people show to be free: positions of their joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Float

_CELL_M, _CLEARANCE_M = 0.2, 0.05


def joint_places(people: Sequence[Person]) -> Float[np.ndarray, "M 4"]:
    """Positions, 20 cm apart along an axis, of measured joints at any time, with a least distance of 5 cm."""
    places = np.concatenate([np.zeros((0, 3)), *(person.joints[person.valid].reshape(-1, 3) for person in people)])
    return append_distance(
        np.unique(np.round(places[np.isfinite(places).all(axis=1)] / _CELL_M), axis=0) * _CELL_M, _CLEARANCE_M
    )


def append_distance(places_m: Float[np.ndarray, "M 3"], distance_m: float) -> Float[np.ndarray, "M 4"]:
    """Positions and the least distance of primitives from each."""
    return np.column_stack([places_m, np.full(len(places_m), distance_m)])
