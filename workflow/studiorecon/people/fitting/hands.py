# SPDX-License-Identifier: Apache-2.0
"""One person's hands in all cameras, with left and right as the cameras' geometry shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.hands import HAND_POINTS
from studiorecon.people.fitting.hand_sides import hand_sides
from studiorecon.progress import say
from studiorecon.rig.body_points import person_tracks
from studiorecon.rig.hand_sizes import hand_sizes_px, large_hands
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# Arms that are less confident do not say how large a hand is.
_SURE = 0.2


def person_hands(
    person: str,
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    cameras: Sequence[Camera],
    film_px: Sequence[float],
    frames: int,
    use: str,
    fps: float,
) -> Float[np.ndarray, "V T 2 21 3"] | None:
    """Left and right hand of a person in every camera: x, y, confidence; NaN and 0 where there is none; None where no
    hand is large enough (``rig.hand_sizes.large_hands`` with ``use`` and ``film_px``)."""
    if use == "off" or all(d.hands is None for d in detections):
        return None
    seen = person_tracks(detections, identities, [person], frames, _SURE)
    large = large_hands(hand_sizes_px(seen, cameras, film_px), use)[:, 0] > 0
    found = np.full((len(detections), frames, 2, HAND_POINTS, 3), np.nan)
    found[..., 2], right = 0, np.full(found.shape[:3], np.nan)
    for view, own in enumerate(detections):
        if own.hands is None:
            continue
        mine = np.array([identities.get((own.camera, int(t)), "") == person for t in own.track], bool)
        for d in np.flatnonzero(mine & (own.frame >= 0) & (own.frame < frames)):
            at = found[view, own.frame[d]]
            # Where two tracks of one person overlap, the more confident hand counts.
            better = large[view, own.frame[d]] & (own.hands[d, ..., 2].sum(-1) > at[..., 2].sum(-1))
            at[better] = own.hands[d][better]
            if own.hands_right is not None:
                right[view, own.frame[d]][better] = own.hands_right[d][better]
    if not (found[..., 2] > 0).any():
        return None
    hands, exchanged = by_side(found, right, cameras, fps)
    if exchanged:
        say(f"{person}: left and right hand exchanged in {exchanged} pictures, as other pictures show")
    return hands


def by_side(
    found: Float[np.ndarray, "V T 2 21 3"], right: Float[np.ndarray, "V T 2"], cameras: Sequence[Camera], fps: float
) -> tuple[Float[np.ndarray, "V T 2 21 3"], int]:
    """The left and the right hand of those that are ``found`` (``hand_sides``), as confident as that is probable; and
    in how many pictures the arms were exchanged."""
    probability = hand_sides(found, right, cameras, fps)
    arm = probability[..., :2].argmax(-1)
    likely = np.take_along_axis(probability, arm[..., None], -1)[..., 0]
    hands = np.take_along_axis(found, arm[..., None, None], 2)
    hands[..., 2] *= likely[..., None]
    hands[likely < 0.5] = [np.nan, np.nan, 0.0]
    return hands, int(((arm != [0, 1]) & (likely >= 0.5)).any(-1).sum())
