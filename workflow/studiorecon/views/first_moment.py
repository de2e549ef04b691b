# SPDX-License-Identifier: Apache-2.0
"""People in synthesised views, as in the paper: key frames are the first pictures as filmed, including people.

The network's views then show the people of that moment, and the room is trained without those pixels (Eq. 5: 1 − M).
The paper takes the people's depth from Pi3 and M from SAM 3 on every view, which ``depth.reference: calibration`` and
``views.people: network`` do here. By default both come from the fitted bodies, which are known at that moment in
metres, in every camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.body.silhouettes import person_depth_m
from studiorecon.footage.video import read_frame, to_float
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.people import Person
from studiorecon.scene.step_files import require_size
from studiorecon.views.forward_warp import WarpSource, warp_source

if TYPE_CHECKING:
    from jaxtyping import Float

_FIRST = 0


@dataclass(frozen=True)
class FirstMomentPeople:
    """The bodies of the people at the first moment; none when ``people`` is empty."""

    people: Sequence[Person]
    body: BodyModel | None

    @staticmethod
    def read(fits: Sequence[Path], body: Path | None) -> FirstMomentPeople:
        """The bodies from their files; raises UserError with the name of a broken one."""
        return FirstMomentPeople([read_person(path) for path in fits], BodyModel.load(body) if fits and body else None)

    def depth_m(self, camera: Camera) -> Float[np.ndarray, "H W"]:
        """Z-depth of the nearest body at every pixel, 0 where there is none."""
        nearest = np.full(camera.hw, np.inf)
        for person in (one for one in self.people if one.present[_FIRST]):
            assert self.body is not None
            depth = person_depth_m(person, self.body, camera, _FIRST)
            nearest = np.where((depth > 0) & (depth < nearest), depth, nearest)
        return np.where(np.isfinite(nearest), nearest, 0.0)


def first_pictures(
    photos: Sequence[WarpSource],
    videos: Sequence[Path],
    masks: Sequence[Path],
    standing: FirstMomentPeople,
    factors: Factors,
    depth_jump: float,
    measured: bool = False,
) -> list[WarpSource]:
    """The first pictures in place of the plates, with bodies in front of the room in their depth.

    ``measured`` depth of that moment already contains people. Pixels of a person's mask outside the body (hair,
    clothes) take the depth of the nearest pixel inside it. People without a fit, and pixels near a jump in depth, are
    not warped. Raises UserError for pictures of another size.
    """
    require_one_each([p.camera for p in photos], videos=list(videos))
    seen = []
    for view, (photo, video) in enumerate(zip(photos, videos)):
        picture = to_float(factors.normalise(photo.camera.name, read_frame(video, _FIRST)))
        labels = read_frame(masks[view], _FIRST) if masks else np.zeros(photo.camera.hw, np.uint8)
        require_size(video, picture, photo.camera.wh)
        require_size(masks[view] if masks else video, labels, photo.camera.wh)
        theirs, fitted = labels > 0, (labels > 0) & (labels <= len(standing.people))
        depth = photo.depth_m
        if not measured:
            bodies = fill_with_nearest(standing.depth_m(photo.camera))
            depth = np.where(theirs, np.where(fitted, bodies, 0.0), photo.depth_m)
        seen.append(warp_source(photo.camera, picture, np.ones(photo.camera.hw, bool), depth, depth_jump))
    return [replace(s, usable=s.usable & (s.depth_m > 0)) for s in seen]


def fill_with_nearest(depth_m: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Depth whose unknown pixels (0) take the value of the nearest known one; all 0 when none is known."""
    if not (depth_m > 0).any():
        return depth_m
    index = scipy.ndimage.distance_transform_edt(depth_m <= 0, return_distances=False, return_indices=True)
    return depth_m[tuple(index)]
