# SPDX-License-Identifier: Apache-2.0
"""Points in distorting cameras, at values that may be complex."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.unknowns import CENTRE, LOG_FOCAL, PER_CAMERA, PRINCIPAL, RADIAL, TURN, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

_NEAR_M = 0.05


def point_columns(
    unknowns: Unknowns, view: Integer[np.ndarray, " M"], point: Integer[np.ndarray, " M"]
) -> Integer[np.ndarray, "M 13"]:
    """(M, 13) columns of a camera and a point."""
    return np.concatenate(
        [
            unknowns.columns("cameras", view, range(PER_CAMERA), PER_CAMERA),
            unknowns.columns("points", point, range(3), 3),
        ],
        axis=1,
    )


def project(
    at: Num[np.ndarray, "M 13"], rotations: Num[np.ndarray, "M 3 3"], aspect: Num[np.ndarray, " M"]
) -> Num[np.ndarray, "M 2"]:
    """(M, 2) distorted pixels of points; one behind its camera counts as just before it."""
    from_centre = at[:, PER_CAMERA:] - at[:, CENTRE]
    x, y, z = np.moveaxis((rotations @ from_centre[..., None])[..., 0], -1, 0)
    turn = at[:, TURN]
    x, y, z = (
        x + turn[:, 1] * z - turn[:, 2] * y,
        y + turn[:, 2] * x - turn[:, 0] * z,
        z + turn[:, 0] * y - turn[:, 1] * x,
    )
    z = np.where(z.real > _NEAR_M, z, _NEAR_M)
    x, y = x / z, y / z
    bent = np.exp(at[:, LOG_FOCAL]) * (1 + at[:, RADIAL] * (x * x + y * y))
    return np.stack([x * bent, y * bent * aspect], axis=-1) + at[:, PRINCIPAL]
