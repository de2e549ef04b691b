# SPDX-License-Identifier: Apache-2.0
"""Front or back: what a silhouette hardly tells, walking, feet and the detector do.

Four witnesses, each in nats for one facing against the opposite one. The whole outline: on a real take the right
facing agrees by 0.01 to 0.03 more, and once 0.01 less. The feet, whose toes stick out to the front: the same over their
surroundings alone, where they are a tenth of the pixels and not a hundredth. The way: who moves through the room mostly
walks forwards. The detector, where it saw somebody in that silhouette though no second camera did: by its metric guess
left is where it is within 37° in nine of ten pictures of the made studio, and in none of 444 on the other side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.body.fitting.basis import State
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.people.guessed import across
from studiorecon.people.silhouettes.contour import Silhouette, Targets
from studiorecon.people.silhouettes.foreground import FOREGROUND, UNKNOWN
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Differences of agreement worth one nat: of the whole outline, and around the feet.
_OUTLINE_UNIT, _FEET_UNIT = 0.01, 0.03
# Walking this far forwards is worth all that walking can say: one in twenty such ways is walked backwards or sideways.
_WALK_M, _WALK_NATS = 0.5, 3.0
# What the detector's guess is worth when it points exactly where the body's left is.
_GUESS_NATS = 2.0
# Around each foot this far is looked at, metres.
_FOOT_M = 0.2
_TRUNK = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "hip"))
_FEET = tuple(JOINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot"))
# Less sure than this, a facing is called undetermined.
SURE = 0.95


@dataclass(frozen=True)
class Facing:
    """How sure a person's facing is.

    Attributes:
        outline, feet: by how much the opposite facing agrees less with the silhouettes, and around the feet.
        ahead_m: way walked forwards, less backwards, in the frames that were looked at.
        probability: of this facing against the opposite one.
        guess: cosine between the body's left and that by the detector; 0 where it saw nobody.
    """

    outline: float
    feet: float
    ahead_m: float
    probability: float
    guess: float = 0.0

    @property
    def determined(self) -> bool:
        return self.probability >= SURE

    def sentence(self) -> str:
        """What it rests on, for the log."""
        verdict = "sure" if self.determined else "undetermined, sure only"
        off_deg = np.degrees(np.arctan2(np.sqrt(max(0.0, 1 - self.guess**2)), self.guess))
        return (
            f"facing {verdict} to {self.probability:.0%} (turned round, silhouettes agree "
            f"by {self.outline:.3f} less and feet by "
            f"{self.feet:.3f}; the person went {self.ahead_m:.2f} m ahead"
            + (f"; the detector's guess is {off_deg:.0f}° off)" if self.guess else ")")
        )


@dataclass(frozen=True)
class Witness:
    """What one followed facing is supported by: agreement of outline and feet (0..1), way ahead in metres, and the
    cosine between its left and the detector's."""

    outline: float
    feet: float
    ahead_m: float
    guess: float = 0.0

    @property
    def nats(self) -> float:
        return (
            self.outline / _OUTLINE_UNIT
            + self.feet / _FEET_UNIT
            + 0.5 * _WALK_NATS * float(np.clip(self.ahead_m / _WALK_M, -1, 1))
            + _GUESS_NATS * self.guess
        )


def witness(
    surface: Silhouette,
    targets: Mapping[int, Targets],
    followed: Mapping[int, tuple[State, float]],
    sides: Mapping[int, Float[np.ndarray, "N 3"]] | None = None,
) -> Witness:
    """What speaks for the facing of a body ``followed`` (frame → state, agreement) over some frames; ``sides``: frame
    → (N, 3) from right to left by the detector."""
    frames = sorted(followed)
    states = [followed[t][0] for t in frames]
    feet = [feet_agreement(surface, state, targets[t]) for t, state in zip(frames, states)]
    known = [share for share in feet if np.isfinite(share)]
    outline = float(np.mean([followed[t][1] for t in frames]))
    told = [sides[t] @ left_of(followed[t][0]) for t in frames if sides and t in sides]
    guess = float(np.mean(np.concatenate(told))) if told else 0.0
    return Witness(outline, float(np.mean(known)) if known else 0.0, ahead_m(states), guess)


def left_of(state: State) -> Float[np.ndarray, " 3"]:
    """(3,) level unit vector from a body's right to its left."""
    left = (state.local[0, 0] @ np.array([1.0, 0.0, 0.0])) * [1, 1, 0]
    return left / max(float(np.linalg.norm(left)), 1e-9)


def across_of(
    shown: Mapping[int, Sequence[Integer[np.ndarray, "H W"]]],
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    sizes: Sequence[tuple[int, int]],
) -> dict[int, Float[np.ndarray, "N 3"]]:
    """Frame → (N, 3) level unit vectors from right to left by the detector, of those whom it saw in the silhouettes
    ``shown`` (frame → V pictures of ``cameras``); its detections, one of each camera that has any, are in pictures of
    ``sizes``."""
    found: dict[int, list[np.ndarray]] = {}
    by_name = {camera.name: v for v, camera in enumerate(cameras)}
    for d, wh in zip(detections, sizes):
        view = by_name.get(d.camera)
        if view is None:
            continue
        names = LAYOUTS[d.layout].keypoints
        trunk = [names.index(n) for n in _TRUNK if n in names]
        scale = np.array(cameras[view].wh) / wh
        for t, vector, points in zip(d.frame, across(d, cameras[view]), d.keypoints[:, trunk, :2]):
            middle = scale * np.nanmean(points, axis=0) if np.isfinite(points).all(1).any() else np.full(2, np.nan)
            if int(t) in shown and np.isfinite(vector).all() and np.isfinite(middle).all():
                column, row = np.floor(middle).astype(int)
                label = shown[int(t)][view]
                inside = 0 <= row < label.shape[0] and 0 <= column < label.shape[1]
                if inside and label[row, column] == FOREGROUND:
                    found.setdefault(int(t), []).append(vector)
    return {t: np.array(vectors) for t, vectors in found.items()}


def ahead_m(states: Sequence[State]) -> float:
    """Way of the pelvis along the body's own forward direction, over consecutive states, metres."""
    places = np.array([s.trans[0, :2] for s in states])
    forward = np.array([(s.local[0, 0] @ np.array([0.0, 0.0, 1.0]))[:2] for s in states])
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    return float((np.diff(places, axis=0) * (forward[1:] + forward[:-1]) / 2).sum())


def feet_agreement(surface: Silhouette, state: State, targets: Targets) -> float:
    """Mean over cameras of intersection over union around the feet; NaN where no camera shows them."""
    joints = surface.joints(state)[list(_FEET)]
    shares = []
    for camera, region, label in zip(surface.cameras, surface.regions(state), targets.labels):
        pixels, depth_m = camera.project(joints)
        near = np.zeros(label.shape, np.uint8)
        for (x, y), z in zip(pixels, depth_m):
            if z > 0.1 and abs(x) < 1e5 and abs(y) < 1e5:
                cv2.circle(near, (int(x), int(y)), max(2, round(_FOOT_M * camera.focal_px[0] / z)), 1, cv2.FILLED)
        heard = (near > 0) & (label != UNKNOWN)
        there = label == FOREGROUND
        union = int(((region | there) & heard).sum())
        if union:
            shares.append(int((region & there & heard).sum()) / union)
    return float(np.mean(shares)) if shares else float("nan")


def compare(winner: Witness, opposite: Witness | None) -> Facing:
    """The winner against the best body that faces the other way; None when there was none that could be followed."""
    if opposite is None:
        sure = 1 / (1 + np.exp(-min(winner.nats, 30.0)))
        return Facing(winner.outline, winner.feet, winner.ahead_m, sure, winner.guess)
    nats = float(np.clip(winner.nats - opposite.nats, -30, 30))
    apart = winner.outline - opposite.outline, winner.feet - opposite.feet
    return Facing(*apart, winner.ahead_m, float(1 / (1 + np.exp(-nats))), winner.guess)
