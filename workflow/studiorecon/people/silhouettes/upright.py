# SPDX-License-Identifier: Apache-2.0
"""A body over time from silhouettes alone: found upright at one frame, checked against its mirror image in time,
followed both ways.

A silhouette hardly tells front from back, so both are fitted in several frames before one is believed (``facing``), and
how sure that is travels with the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting import prior
from studiorecon.body.fitting.basis import State
from studiorecon.body.model import upright_global_orientation
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES, OTHER_SIDE
from studiorecon.people.silhouettes.contour import Silhouette, Targets
from studiorecon.people.silhouettes.facing import Facing, compare, witness
from studiorecon.people.silhouettes.tracking import arms_settled, follow

if TYPE_CHECKING:
    from jaxtyping import Float

_YAWS = 12
# Arms hanging, and arms half raised; radians about the shoulder's z.
_ARMS_RAD = (0.0, 0.9)
_BEST = 6
# Parts of the clip in which a start is sought; frames on each side that decide the facing, and the time between them.
_STARTS, _HALF_WINDOW, _STEP_S = 3, 5, 0.08
# A way of this many metres within a window is worth as much as outlines of full length; starts that agree by this much
# less are as good.
_WALKED_M, _AS_GOOD = 0.5, 0.02
# Starts whose facings differ by less are the same rival.
_SAME_FACING_RAD = np.deg2rad(45)
_ROOT_STEPS, _POSE_STEPS, _SHAPE_STEPS = 5, 14, 8


@dataclass(frozen=True)
class UprightWalk:
    """Silhouettes by frame, where the hull stood then (2,), the frame rate, and frame → (N, 3) from right to left where
    the detector saw somebody in them."""

    targets: Mapping[int, Targets]
    places_m: Mapping[int, Float[np.ndarray, " 2"]]
    fps: float
    sides: Mapping[int, Float[np.ndarray, "N 3"]] = field(default_factory=dict)

    def place_m(self, frame: int) -> Float[np.ndarray, " 2"]:
        return self.places_m[int(frame)]

    def around(self, frame: int) -> UprightWalk:
        """The frames within about half a second of ``frame``, at most one per ``_STEP_S``, so that a limb can be
        followed."""
        chosen = self._near(frame)
        return UprightWalk({t: self.targets[t] for t in chosen}, self.places_m, self.fps, self.sides)

    def way_m(self, frame: int) -> float:
        """How far the hull moves in those frames, end to end; walking tells the facing."""
        chosen = sorted(self._near(frame))
        return float(np.linalg.norm(self.place_m(chosen[-1]) - self.place_m(chosen[0])))

    def _near(self, frame: int) -> list[int]:
        step = max(1, round(_STEP_S * self.fps))
        return [t for t in self.targets if abs(t - frame) <= _HALF_WINDOW * step and (t - frame) % step == 0]


@dataclass(frozen=True)
class UprightFit:
    """A start: ``state`` at ``frame``, its ``agreement`` 0..1 over several frames, and how sure its ``facing`` is."""

    frame: int
    state: State
    agreement: float
    facing: Facing


def upright(
    place_m: Float[np.ndarray, " 2"], floor_m: float, height_m: float, yaw_rad: float, arms_rad: float
) -> State:
    """The relaxed body standing at ``place_m`` (2,) with its pelvis where that of somebody of ``height_m`` is."""
    local = prior.middle()[None].copy()
    local[0, 0] = rotations.exp(upright_global_orientation(yaw_rad))
    for sign, side in ((1, "left"), (-1, "right")):
        joint = JOINT_NAMES.index(f"{side}_shoulder")
        local[0, joint] = rotations.exp(np.array([0.0, 0.0, sign * arms_rad])) @ local[0, joint]
    trans = np.array([[place_m[0], place_m[1], floor_m + 0.53 * height_m]])
    return State(local, trans, np.zeros(10), 0.0, np.zeros((0, 3)))


def cold_start(
    surface: Silhouette, targets: Targets, place_m: Float[np.ndarray, " 2"], floor_m: float, height_m: float
) -> list[tuple[float, State]]:
    """Agreement and state of the best facings, best first: every yaw and two arm poses by the root alone, the best ones
    in full."""
    reach = surface.settings.reach_px
    tried = []
    for k in range(_YAWS):
        for arms in _ARMS_RAD:
            state = upright(place_m, floor_m, height_m, 2 * np.pi * k / _YAWS, arms)
            state = surface.refine(state, targets, _ROOT_STEPS, free="root", reach_px=(reach[0], reach[0] / 2))
            tried.append((surface.agreement(state, targets), state))
    tried.sort(key=lambda pair: -pair[0])
    refined = []
    for _, state in _distinct(tried, _BEST):
        state = surface.refine(state, targets, _POSE_STEPS, free="shape", reach_px=reach)
        refined.append((surface.agreement(state, targets), state))
    return sorted(refined, key=lambda pair: -pair[0])


def _distinct(tried: list[tuple[float, State]], count: int) -> list[tuple[float, State]]:
    """The best ``count`` of which no two face within 20° of each other with the same arms; both facings of the best are
    among them."""
    kept: list[tuple[float, State]] = []
    for pair in tried:
        close = [rotations.angle(pair[1].local[0, 0], other.local[0, 0]) < np.deg2rad(20) for _, other in kept]
        if sum(close) < 1:
            kept.append(pair)
    if len(kept) > count:
        opposite = max(kept, key=lambda pair: float(rotations.angle(pair[1].local[0, 0], kept[0][1].local[0, 0])))
        kept = kept[:count] if any(pair is opposite for pair in kept[:count]) else [*kept[: count - 1], opposite]
    return kept


def turned_round(state: State) -> State:
    """The same place and outline, facing the other way: the body about its vertical, left and right limbs exchanged."""
    local = state.local.copy()
    mirror = np.diag([-1.0, 1.0, 1.0])
    partner = list(OTHER_SIDE)
    # Seen from behind, the left arm is where the right one was: mirror the pose left to right, then turn by 180°.
    local[0] = mirror @ local[0, partner] @ mirror
    # The mirrored root faces where the mirror image does; only its heading is taken from the original, turned round.
    forward = state.local[0, 0] @ np.array([0.0, 0.0, 1.0])
    local[0, 0] = rotations.exp(upright_global_orientation(float(np.arctan2(-forward[1], -forward[0]))))
    return State(local, state.trans.copy(), state.betas.copy(), 0.0, state.corrections)


def find(surface: Silhouette, walk: UprightWalk, floor_m: float, height_m: float) -> UprightFit:
    """The best of a few starts over the clip; its facing is decided by following both for a second, where somebody
    walks if they do."""
    frames = sorted(walk.targets)
    # Where the outlines are longest the least is hidden; a second of walking says more about the facing than any
    # outline.
    known = {t: sum(len(o.points) for o in walk.targets[t].outlines) for t in frames}
    longest, farthest = max(known.values()), max(walk.way_m(t) for t in frames)
    worth = {
        t: known[t] / max(longest, 1) + min(farthest, _WALKED_M) * walk.way_m(t) / max(farthest, 1e-6) for t in frames
    }
    chosen = [max(part, key=lambda t: (worth[t], -t)) for part in np.array_split(frames, _STARTS) if len(part)]
    starts = {t: cold_start(surface, walk.targets[t], walk.place_m(t), floor_m, height_m) for t in chosen}
    best_of_all = max(tried[0][0] for tried in starts.values())
    frame = int(max(chosen, key=lambda t: (starts[t][0][0] > best_of_all - _AS_GOOD, worth[t], -t)))
    window = walk.around(frame)
    rivals: list[State] = []
    for _, state in [*starts[frame][:2], *((0.0, turned_round(s)) for _, s in starts[frame][:2])]:
        if all(rotations.angle(state.local[0, 0], other.local[0, 0]) > _SAME_FACING_RAD for other in rivals):
            rivals.append(state)
    scored = []
    for state in rivals:
        state = surface.refine(
            state, walk.targets[frame], _POSE_STEPS, free="shape", reach_px=surface.settings.reach_px
        )
        followed = follow(surface, window, frame, state, both_legs=False)
        scored.append((witness(surface, window.targets, followed, walk.sides), state))
    seen, winner = max(scored, key=lambda pair: pair[0].nats)
    opposite = [w for w, state in scored if rotations.angle(state.local[0, 0], winner.local[0, 0]) > np.deg2rad(90)]
    return UprightFit(frame, winner, seen.outline, compare(seen, max(opposite, key=lambda w: w.nats, default=None)))


def shaped(surface: Silhouette, walk: UprightWalk, found: UprightFit) -> UprightFit:
    """The start with the median shape of the frames around it, each fitted with its own; one frame bends it to its own
    noise."""
    window = walk.around(found.frame)
    reach = surface.settings.reach_px
    betas = []
    for t, (state, _) in sorted(follow(surface, window, found.frame, found.state, both_legs=False).items()):
        fitted = surface.refine(state, walk.targets[t], _SHAPE_STEPS, free="shape", reach_px=(reach[0] / 3, reach[1]))
        betas.append(fitted.betas)
    state = State(found.state.local, found.state.trans, np.median(betas, axis=0), 0.0, found.state.corrections)
    state = surface.refine(
        state, walk.targets[found.frame], _SHAPE_STEPS, free="pose", reach_px=(reach[0] / 3, reach[1])
    )
    state = arms_settled(surface, walk.targets[found.frame], state)
    return UprightFit(found.frame, state, found.agreement, found.facing)
