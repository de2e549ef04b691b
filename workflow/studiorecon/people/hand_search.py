# SPDX-License-Identifier: Apache-2.0
"""Searches one camera's pictures for the hands at the ends of people's arms."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.hand_landmarks import MIN_GUESS, MIN_PRESENCE, Hand, HandLandmarks, region_of_arm
from studiorecon.keypoints.hands import HAND_POINTS, SIDES
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.expected_keypoints import ExpectedKeypoints
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Keypoints of the body that are less confident do not show where the hand is.
_SURE = 0.3
# A hand is another one if its wrist is further from the arm's than this share of its length.
_MAX_OFF = 0.6
# Confidence is this power of the presence: weights of squared residuals are then as the errors are. On the made studio
# points are off by 6 % of the hand's length where it is above 0.97, by 8 % to 0.85, by 14 % below.
_CONFIDENCE_POWER = 6
# Hands are searched for at most so often, pictures per second: fingers move little beside the wrist in a twentieth of a
# second, and at 30 it would cost a fifth of detecting the body.
_SEARCHED_FPS = 20.0
# Turns of the crops against the arm, one in each picture: most of a wrist's reach to either side. With all of them in
# every picture 169 hands of the made studio were found instead of 166, for a third more time.
_TURNS_RAD = (0.0, -0.6, 0.0, 0.6)


@dataclass(frozen=True)
class Arm:
    """The end of a person's arm in a picture.

    Attributes:
        row: the person's detection; ``side``: 0 = left, 1 = right; ``person``: who it is.
        wrist, towards: pixels of the film, and a place beyond the wrist in the direction of the hand.
        length_px: length of the hand where it is not foreshortened.
    """

    frame: int
    row: int
    side: int
    person: int
    wrist: Num[np.ndarray, " 2"]
    towards: Num[np.ndarray, " 2"]
    length_px: float


def arm_end(
    layout: str, keypoints: Num[np.ndarray, "K 3"], side: int
) -> tuple[Num[np.ndarray, " 2"], Num[np.ndarray, " 2"]] | None:
    """The wrist and a place beyond it: the root of the middle finger where the layout has fingers, else the forearm's
    extension; None where they are not seen."""
    names = LAYOUTS[layout].keypoints

    def at(name: str) -> np.ndarray | None:
        known = f"{SIDES[side]}_{name}"
        k = names.index(known) if known in names else -1
        return keypoints[k, :2] if k >= 0 and keypoints[k, 2] >= _SURE else None

    wrist, elbow, index, little = at("wrist"), at("elbow"), at("index_finger"), at("little_finger")
    if wrist is not None and index is not None and little is not None:
        return wrist, (2 * index + little) / 3
    return (wrist, 2 * wrist - elbow) if wrist is not None and elbow is not None else None


def every_nth(fps: float) -> int:
    """Steps of frames in which hands are searched for."""
    return max(1, math.ceil(fps / _SEARCHED_FPS - 1e-6))


def arms_in_view(
    own: Detections,
    person: Integer[np.ndarray, " D"],
    people: Sequence[ExpectedKeypoints],
    large: Float[np.ndarray, "P T 2"],
    in_footage: Callable[[Num[np.ndarray, "N 2"]], Num[np.ndarray, "N 2"]],
    fps: float,
) -> list[Arm]:
    """The ends of arms with large hands in the frames that are searched: by the camera's own keypoints, else by the
    other cameras'.

    ``person``: index into ``people`` of each detection, -1 = nobody's. ``in_footage`` maps working pixels to the
    film's.
    """
    arms = []
    for row, (frame, k) in enumerate(zip(own.frame.tolist(), person.tolist())):
        if k < 0 or frame % every_nth(fps):
            continue
        place = people[k].at(frame)
        expected = None if place is None else np.column_stack([place, np.isfinite(place[:, 0])])
        for side in (0, 1):
            end = arm_end(own.layout, own.keypoints[row], side) if large[k, frame, side] else None
            if end is None and large[k, frame, side] and expected is not None:
                end = arm_end(own.layout, expected, side)
            if end is not None:
                wrist, towards = in_footage(np.array(end))
                arms.append(Arm(frame, row, side, k, wrist, towards, float(large[k, frame, side])))
    return arms


def find_hands(
    network: HandLandmarks, pictures: Iterable[Integer[np.ndarray, "H W 3"]], arms: Sequence[Arm]
) -> dict[tuple[int, int], Hand]:
    """(row, side) → the hand at the end of each of ``arms``; ``pictures`` (RGB) are those of their frames, in order.

    A hand that was found, or guessed, in the picture before is searched for around its points. Where it is not there,
    the crop continues the arm; in the next pictures it is turned to either side, as a bent wrist is.
    """
    found, last = dict[tuple[int, int], Hand](), dict[tuple[int, int], tuple[Arm, Hand]]()
    missed = Counter[tuple[int, int]]()
    for frame, picture in zip(sorted({arm.frame for arm in arms}), pictures):
        now = dict[tuple[int, int], tuple[Arm, Hand]]()
        for arm in (one for one in arms if one.frame == frame):
            who = arm.person, arm.side
            straight = region_of_arm(arm.wrist, arm.towards, arm.length_px)
            regions = [replace(straight, turn_rad=straight.turn_rad + _TURNS_RAD[missed[who] % len(_TURNS_RAD)])]
            if before := last.get(who):
                around = before[1].region
                regions.insert(0, replace(around, centre=around.centre + arm.wrist - before[0].wrist))
            for region in regions:
                seen = network.look(picture, region)
                there = float(np.linalg.norm(seen.points[0] - arm.wrist)) <= _MAX_OFF * arm.length_px
                if there and seen.presence >= MIN_GUESS and (who not in now or seen.presence > now[who][1].presence):
                    now[who] = arm, seen
                if who in now and now[who][1].presence >= MIN_PRESENCE:
                    found[arm.row, arm.side] = now[who][1]
                    break
            missed[who] = 0 if (arm.row, arm.side) in found else missed[who] + 1
        last = now
    return found


def hands_of_rows(
    found: Mapping[tuple[int, int], Hand],
    rows: int,
    working: Callable[[Num[np.ndarray, "N 2"]], tuple[Num[np.ndarray, "N 2"], Num[np.ndarray, " N"]]],
) -> tuple[Float[np.ndarray, "D 2 21 3"], Float[np.ndarray, "D 2"]]:
    """``hands`` and ``hands_right`` of detections: ``working`` maps pixels of the film to working pixels and whether
    they exist."""
    out, right = np.full((rows, 2, HAND_POINTS, 3), np.nan, np.float32), np.full((rows, 2), np.nan)
    out[..., 2] = 0
    for (row, side), hand in found.items():
        pixels, valid = working(hand.points)
        out[row, side, :, :2] = np.where(valid[:, None], pixels, np.nan)
        out[row, side, :, 2] = np.where(valid, hand.presence**_CONFIDENCE_POWER, 0.0)
        right[row, side] = hand.right
    return out, right


def interpolate_hands(
    hands: Float[np.ndarray, "D 2 21 3"], own: Detections, person: Integer[np.ndarray, " D"], fps: float
) -> Float[np.ndarray, "D 2 21 3"]:
    """``hands`` with those of the detections between two searched frames in which they are: they move with the wrist,
    and linearly beside it."""
    whole, names = hands.copy(), LAYOUTS[own.layout].keypoints
    for k, side in product(np.unique(person[person >= 0]), (0, 1)):
        rows = np.flatnonzero(person == k)
        rows = rows[np.argsort(own.frame[rows], kind="stable")]
        wrist = own.keypoints[:, names.index(f"{SIDES[side]}_wrist"), :2]
        seen = [place for place, row in enumerate(rows) if hands[row, side, 0, 2] > 0]
        for first, last in pairwise(seen):
            a, b = rows[first], rows[last]
            if own.frame[b] - own.frame[a] > every_nth(fps):
                continue
            for row in rows[first + 1 : last]:
                share = (own.frame[row] - own.frame[a]) / (own.frame[b] - own.frame[a])
                between = (1 - share) * hands[a, side] + share * hands[b, side]
                between[:, :2] += np.nan_to_num(wrist[row] - (1 - share) * wrist[a] - share * wrist[b])
                whole[row, side] = between
    return whole
