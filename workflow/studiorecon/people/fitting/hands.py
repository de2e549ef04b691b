# SPDX-License-Identifier: Apache-2.0
"""One person's hands in all cameras, with left and right as the cameras' geometry shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import cross_matrix
from studiorecon.keypoints.hands import HAND_POINTS
from studiorecon.progress import say
from studiorecon.rig.body_points import person_tracks
from studiorecon.rig.hand_sizes import hand_sizes_px, large_hands
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# A point further than this from another view's ray, as a share of the longer side, is not the same point: as for bodies
# (``fitting.points.Triangulation``).
_MAX_OFF_SHARE = 0.025
# Agreement that exchanging left and right must gain, in hands of which every point is exactly on the other's ray.
_CLEAR = 0.25
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
) -> Float[np.ndarray, "V T 2 21 3"] | None:
    """Left and right hand of a person in every camera: x, y, confidence; NaN and 0 where there is none; None where no
    hand is large enough (``rig.hand_sizes.large_hands`` with ``use`` and ``film_px``)."""
    if use == "off" or all(d.hands is None for d in detections):
        return None
    seen = person_tracks(detections, identities, [person], frames, _SURE)
    large = large_hands(hand_sizes_px(seen, cameras, film_px), use)[:, 0] > 0
    out = np.full((len(detections), frames, 2, HAND_POINTS, 3), np.nan)
    out[..., 2] = 0
    for view, own in enumerate(detections):
        if own.hands is None:
            continue
        mine = np.array([identities.get((own.camera, int(t)), "") == person for t in own.track], bool)
        for d in np.flatnonzero(mine & (own.frame >= 0) & (own.frame < frames)):
            at = out[view, own.frame[d]]
            # Where two tracks of one person overlap, the more confident hand counts.
            better = large[view, own.frame[d]] & (own.hands[d, ..., 2].sum(-1) > at[..., 2].sum(-1))
            at[better] = own.hands[d][better]
    if not (out[..., 2] > 0).any():
        return None
    mended, exchanged = mend_sides(out, cameras)
    if exchanged.any():
        pictures = int((exchanged > 0).sum())
        say(f"{person}: left and right hand exchanged in {pictures} pictures, as the other cameras show")
    return mended


def mend_sides(
    hands: Num[np.ndarray, "V T 2 21 3"], cameras: Sequence[Camera]
) -> tuple[Float[np.ndarray, "V T 2 21 3"], Integer[np.ndarray, "V T"]]:
    """Hands with left and right exchanged in the fewest views with which all agree best, and where that is (1).

    Two views that contradict each other do not show which is wrong; their hands are then removed (-1).
    """
    views, frames = hands.shape[:2]
    gain = np.zeros((2, 2, frames, views, views))  # by the two sides that are compared
    for a, b in combinations(range(views), 2):
        gain[:, :, :, a, b] = _agreement(hands[a], hands[b], cameras[a], cameras[b])
    choices = np.array([c for c in sorted(product((0, 1), repeat=views), key=sum) if 2 * sum(c) <= views])
    total = np.zeros((len(choices), frames))
    for n, choice in enumerate(choices):
        for side, (a, b) in product((0, 1), combinations(range(views), 2)):
            total[n] += gain[side ^ choice[a], side ^ choice[b], :, a, b]
    best = total.argmax(0)
    better = total[best, np.arange(frames)] > total[0] + _CLEAR
    out, exchanged = hands.astype(np.float64), np.zeros((views, frames), np.int64)
    for t in np.flatnonzero(better):
        as_good = np.isclose(total[:, t], total[best[t], t]) & (choices.sum(1) == choices[best[t]].sum())
        same = choices[as_good]
        if len(same) > 1:
            involved = np.any(same, axis=0)
            out[involved, t] = [np.nan, np.nan, 0.0]
            exchanged[involved, t] = -1
        else:
            exchanged[:, t] = same[0]
            out[same[0] == 1, t] = hands[same[0] == 1, t, ::-1]
    return out, exchanged


def _agreement(first: np.ndarray, second: np.ndarray, a: Camera, b: Camera) -> np.ndarray:
    """(2, 2, T) how well each of ``first``'s hands (T, 2, 21, 3) agrees with each of ``second``'s, 0 to 1: by the
    distance of its points from the rays in ``b``; 0 where one is not seen."""
    relative = b.camera_from_world @ np.linalg.inv(a.camera_from_world)
    essential = cross_matrix(relative[:3, 3]) @ relative[:3, :3]
    fundamental = np.linalg.inv(b.intrinsics).T @ essential @ np.linalg.inv(a.intrinsics)
    lines = np.concatenate([first[..., :2], np.ones_like(first[..., :1])], -1) @ fundamental.T
    points = np.concatenate([second[..., :2], np.ones_like(second[..., :1])], -1)
    off = np.abs(np.einsum("tikc,tjkc->ijtk", lines, points))
    off = off / np.maximum(np.linalg.norm(lines[..., :2], axis=-1), 1e-12).transpose(1, 0, 2)[:, None]
    near = np.clip(1 - off / (_MAX_OFF_SHARE * max(b.wh)), 0, 1)
    return np.nan_to_num(near).mean(-1)
