# SPDX-License-Identifier: Apache-2.0
"""Background and people as one set of Gaussians, so that one rasterisation resolves occlusions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numba
import numpy as np
import scipy

from studiorecon.render.shading import Shading
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import INFERRED, INVENTED, MEASURED

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Grey level of each class (measured, inferred, invented) in a truth video.
TRUTH_LEVELS = np.array([255, 128, 0], np.uint8)


class PosedAvatar(Protocol):
    """An avatar in a composite: Gaussians and joints at a time, their classes, and the measured frames.

    An absent person has the same number of Gaussians, all invisible, and joints infinitely far away.
    """

    @property
    def person(self) -> str: ...

    @property
    def provenance(self) -> Integer[np.ndarray, " N"]: ...

    @property
    def valid(self) -> Bool[np.ndarray, " T"]: ...

    def posed(self, frame: float) -> Gaussians: ...

    def joints_m(self, frame: float) -> Float[np.ndarray, "J 3"]: ...


@dataclass(frozen=True)
class Composite:
    """A scene that can be composed at any time.

    Attributes:
        background: static Gaussians.
        classes: uint8 per background Gaussian: measured, inferred or invented.
        people, objects: one posable set each.
        shading: shadows of people on the room; None for none.
        absent: people who were captured and are left out of this film; its camera still knows where they were.
    """

    background: Gaussians
    classes: Integer[np.ndarray, " N"]
    people: Sequence[PosedAvatar]
    shading: Shading | None = None
    objects: Sequence[PosedAvatar] = ()
    absent: Sequence[PosedAvatar] = ()

    @property
    def moving(self) -> list[PosedAvatar]:
        """People, then objects."""
        return [*self.people, *self.objects]


def provenance_classes(person: PosedAvatar, frame: float) -> Integer[np.ndarray, " N"]:
    """Classes of a person or object at a frame; where the pose was interpolated no part of a body is measured."""
    measured = bool(person.valid[int(np.clip(round(frame), 0, len(person.valid) - 1))])
    return person.provenance if measured else np.maximum(person.provenance, INFERRED)


def truth_levels(shares: Float[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "H W"]:
    """Truth map from class shares: 255 measured, 128 inferred, 0 invented.

    The largest share wins. A pixel with more than half of its light from no Gaussian is invented too: no camera
    measured that there is nothing.
    """
    return _levels(np.ascontiguousarray(shares), TRUTH_LEVELS)


@numba.njit(cache=True, nogil=True)
def _levels(shares, levels):
    found = np.empty(shares.shape[:2], np.uint8)
    for y in range(shares.shape[0]):
        for x in range(shares.shape[1]):
            measured, inferred, invented = shares[y, x, MEASURED], shares[y, x, INFERRED], shares[y, x, INVENTED]
            if (measured + inferred) + invented < 0.5:
                found[y, x] = levels[INVENTED]
            elif measured >= inferred and measured >= invented:
                found[y, x] = levels[MEASURED]
            else:
                found[y, x] = levels[INFERRED] if inferred >= invented else levels[INVENTED]
    return found


def to_millimetres(depth_m: Float[np.ndarray, "H W"]) -> Integer[np.ndarray, "H W"]:
    """Uint16 millimetres; 0 stays unknown, larger depths than 65.535 m become 65535."""
    return np.clip(np.rint(np.nan_to_num(depth_m, nan=0.0, posinf=65.535) * 1000), 0, 65535).astype(np.uint16)


def is_blocked(eyes_m: Float[np.ndarray, "E 3"], background: Gaussians, clearance_m: float) -> Bool[np.ndarray, " E"]:
    """Whether solid background (Gaussians of opacity above a half) is within ``clearance_m`` of each position.

    It takes a group of them: a single floater must not move a camera path.
    """
    solid = background.means_m[background.logit_opacities > 0]
    if len(solid) == 0 or clearance_m <= 0:
        return np.zeros(len(eyes_m), bool)
    near = scipy.spatial.cKDTree(solid).query_ball_point(np.asarray(eyes_m), clearance_m, return_length=True)
    # This many solid Gaussians within reach are a surface, fewer are floaters.
    return np.asarray(near) >= 10
