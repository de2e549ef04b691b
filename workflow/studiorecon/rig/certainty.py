# SPDX-License-Identifier: Apache-2.0
"""How well cameras found from people are known: what halves of the evidence disagree by, not only what random noise
would do.

A detector misplaces joints by centimetres, in the same way for as long as the body looks the same from a camera. No
number of frames averages that out, and the residuals do not show it. But halves of the clip show other poses and halves
of the body other joints: what the cameras found from them differ by is an error of that kind.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from studiorecon.geometry.bundle import Adjusted, LensPrior, without_drift
from studiorecon.geometry.triangulation import Limits, Triangulated
from studiorecon.rig.from_people import Rig, adjusted, places_of_joints
from studiorecon.rig.stale import HALF_OF_THE_JOINTS, moves

# What stays when every half agrees: joints that are defined otherwise seen from the front than from behind.
_FLOOR_DEG = 0.2
_LEAST_POINTS = 60


def sigma_of(
    rig: Rig, result: Adjusted, lens: LensPrior, limits: Limits, known_px: Mapping[int, float] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(V,) standard deviations of turn (degrees), place (metres) and focal length (share) of cameras relative to one
    another.

    The larger of what the residuals say (``Adjusted.sigma``, with all places of a joint as one observation) and what
    four half fits (both halves of the clip, both of the joints) are off in the root mean square, and 0.2° of what no
    half shows, with what that means in place at the people's distance. The difference of a half from the whole is as
    uncertain as the whole where errors are independent. Focal lengths are known no worse than ``lens`` says;
    ``known_px`` as for ``adjusted``.
    """
    counted = rig.points.verified if len(result.cameras) > 2 else rig.points.valid
    early = rig.seen.frame <= np.median(rig.seen.frame[counted]) if counted.any() else counted
    half = HALF_OF_THE_JOINTS[rig.seen.keypoint]
    turns, places, focals = [], [], []
    for chosen in (early, ~early, half, ~half):
        if (chosen & counted).sum() < _LEAST_POINTS:
            continue
        part, _ = adjusted(_part(rig, chosen), lens, limits, known_px)
        laid = without_drift(part.cameras, result.cameras)[0]
        degrees, metres = moves(laid, result.cameras)
        turns.append(degrees)
        places.append(metres)
        focals.append([np.log(a.focal_px[0] / b.focal_px[0]) for a, b in zip(part.cameras, result.cameras)])
    joints = len(np.unique(np.stack([rig.seen.group[counted], rig.seen.keypoint[counted]]), axis=1).T)
    wider = np.sqrt(places_of_joints(rig, counted) / max(joints, 1))
    formal = (
        wider * np.degrees(result.sigma[:, :3].max(1)),
        wider * result.sigma[:, 3:6].max(1),
        wider * result.sigma[:, 6],
    )
    # A turn has three numbers and so has a place: per number, as the formal ones are.
    seen = [np.sqrt(np.mean(np.square(v), axis=0) / n) if v else 0.0 for v, n in ((turns, 3), (places, 3), (focals, 1))]
    middle = np.median(result.points_m, axis=0)
    away = np.array([np.linalg.norm(c.centre_m - middle) for c in result.cameras])
    floor = _FLOOR_DEG, np.radians(_FLOOR_DEG) * away, 0.0
    turn, place, focal = (np.hypot(np.maximum(f, s), least) for f, s, least in zip(formal, seen, floor))
    return turn, place, np.minimum(focal, lens.log_focal)


def _part(rig: Rig, chosen: np.ndarray) -> Rig:
    points = rig.points
    some = Triangulated(
        points.points_m[chosen],
        points.valid[chosen],
        points.verified[chosen],
        points.inliers[:, chosen],
        points.covariance_m2[chosen],
        points.error_px[:, chosen],
    )
    return Rig(rig.cameras, rig.seen.of(chosen), some, rig.support)


def between_deg(turn_deg: np.ndarray) -> float:
    """95 % interval (half width, degrees) of the rotation between the two least certain of cameras with ``sigma_of``'s
    turns (V,).

    2.5 standard deviations: between 2 for an error about one axis and 2.8 for one about all three.
    """
    return float(2.5 * np.sqrt((np.sort(turn_deg)[-2:] ** 2).sum()))
