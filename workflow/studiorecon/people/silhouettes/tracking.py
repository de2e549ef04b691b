# SPDX-License-Identifier: Apache-2.0
"""A body followed from silhouette to silhouette: several ways of going on are kept until the clip has decided between
them.

Where the legs pass each other a silhouette does not tell left from right; how they went on turning does. A leg that
swings through keeps its speed, a wrong pair bounces back. So every frame also tries the legs exchanged, and the way
with the least cost over all frames wins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from studiorecon.body.fitting import prior
from studiorecon.body.fitting.basis import State
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES, OTHER_SIDE
from studiorecon.people.silhouettes.contour import Before, Silhouette, Targets

if TYPE_CHECKING:
    from jaxtyping import Float

_SIDES = ("left", "right")
_ARM = {side: [JOINT_NAMES.index(f"{side}_{joint}") for joint in ("shoulder", "elbow")] for side in _SIDES}
_LEGS = [JOINT_NAMES.index(f"{side}_{joint}") for side in _SIDES for joint in ("hip", "knee", "ankle", "foot")]
_SWUNG = [JOINT_NAMES.index(f"{side}_{joint}") for side in _SIDES for joint in ("hip", "knee")]
# Time in which a joint is expected to lose its speed to 1/e, seconds.
_KEPT_SPEED_S = 0.15
# How much a hip's or knee's speed typically changes: radians per second squared, and the error of a turn, radians.
_ACCELERATION, _TURN_ERROR_RAD = 25.0, 0.1
# A loss of agreement worth one nat in one frame; what the arms' return to the relaxed pose must win to be believed.
_AGREEMENT_UNIT, _RELAXED_NATS = 0.02, 0.15
# Share of the pose prior's nats that counts: neighbouring frames have the same pose. A forearm folded before the chest,
# where an outline lacks the hand, agrees as well as one that hangs (to 0.001) at 3.5 nats more; an arm that is up
# agrees better by 3.5 nats.
_STRAIN_SHARE = 0.1
# Ways whose hips and knees differ by less are one; so many are kept.
_SAME_LEGS_RAD, _WAYS = 0.25, 2
_STEPS = 5


class Walk(Protocol):
    """Silhouettes by frame, where the hull stood in them, and the frame rate: ``upright.Walk``."""

    @property
    def targets(self) -> Mapping[int, Targets]: ...

    @property
    def fps(self) -> float: ...

    def place_m(self, frame: int) -> Float[np.ndarray, " 2"]: ...


@dataclass(frozen=True)
class _Way:
    """What was found so far: the last two states and their times, all states and agreements, and the cost."""

    now: State
    frame: int
    before: State | None
    elapsed_s: float
    found: tuple[tuple[int, State, float], ...]
    nats: float


def follow(
    surface: Silhouette, walk: Walk, frame: int, state: State, *, both_legs: bool = True
) -> dict[int, tuple[State, float]]:
    """State and agreement at every frame of ``walk``, from ``state`` at ``frame`` forwards and backwards, shape held.

    ``both_legs``: also with left and right leg exchanged, at twice the cost.
    """
    ordered = sorted(walk.targets)
    at = ordered.index(frame)
    reach = surface.settings.reach_px
    starts = [state]
    if both_legs:
        other = surface.refine(
            legs_exchanged(state), walk.targets[frame], _STEPS, free="pose", reach_px=(reach[0] / 2, reach[1])
        )
        starts += [other] if _leg_turn(other, state) > _SAME_LEGS_RAD else []
    best, least = {}, np.inf
    for start in starts:
        share = surface.agreement(start, walk.targets[frame])
        first = _Way(start, frame, None, 0.0, ((frame, start, share),), _nats(surface, start, share))
        ways = [_along(surface, walk, order, first, both_legs) for order in (ordered[at + 1 :], ordered[:at][::-1])]
        nats = sum(way.nats for way in ways)
        if nats < least:
            best, least = {t: (s, a) for way in ways for t, s, a in way.found}, nats
    return best


def legs_exchanged(state: State) -> State:
    """The state with left and right leg exchanged, mirrored."""
    local, mirror = state.local.copy(), np.diag([-1.0, 1.0, 1.0])
    partners = [OTHER_SIDE[j] for j in _LEGS]
    local[0, _LEGS] = mirror @ state.local[0, partners] @ mirror
    return State(local, state.trans, state.betas, 0.0, state.corrections)


def arms_relaxed(state: State, sides: Sequence[str] = _SIDES) -> State:
    """The state with the arms of ``sides`` in the relaxed pose."""
    local = state.local.copy()
    arms = [joint for side in sides for joint in _ARM[side]]
    local[0, arms] = prior.middle()[arms]
    return State(local, state.trans, state.betas, 0.0, state.corrections)


def arms_settled(surface: Silhouette, targets: Targets, state: State) -> State:
    """The state, or it with one arm or both hanging when that costs less: outlines hardly tell an arm before the
    body."""
    reach = surface.settings.reach_px
    tried = [state]
    for sides in (*([s] for s in _SIDES), _SIDES):
        tried.append(
            surface.refine(arms_relaxed(state, sides), targets, _STEPS, free="pose", reach_px=(reach[0] / 2, reach[1]))
        )
    return min(tried, key=lambda s: _nats(surface, s, surface.agreement(s, targets)))


def _nats(surface: Silhouette, state: State, share: float) -> float:
    """What speaks against a state by itself that agrees with its silhouettes by ``share``."""
    return (1 - share) / _AGREEMENT_UNIT + _STRAIN_SHARE * surface.strain(state)


def _along(surface: Silhouette, walk: Walk, order: Sequence[int], first: _Way, both_legs: bool) -> _Way:
    """The cheapest way through the frames of ``order``."""
    ways = [first]
    for t in order:
        grown = []
        for rank, way in enumerate(ways):
            going_on = _predicted(way, walk, t)
            guesses = [(going_on, 0.0), (arms_relaxed(going_on), _RELAXED_NATS)]
            if both_legs and rank == 0:
                guesses += [(arms_relaxed(going_on, [side]), _RELAXED_NATS) for side in _SIDES]
                guesses.append((legs_exchanged(going_on), 0.0))
            grown += [_grown(surface, walk, t, way, going_on, guess, nats) for guess, nats in guesses]
        ways = []
        for way in sorted(grown, key=lambda w: w.nats):
            if all(_leg_turn(way.now, other.now) > _SAME_LEGS_RAD for other in ways):
                ways.append(way)
        ways = ways[: _WAYS if both_legs else 1]
    return ways[0]


def _predicted(way: _Way, walk: Walk, frame: int) -> State:
    """The state at ``frame`` if everything goes on as it did: joints turn on, the pelvis moves as the hull does."""
    local = way.now.local
    if way.before is not None:
        elapsed_s = abs(frame - way.frame) / walk.fps
        share = np.exp(-elapsed_s / _KEPT_SPEED_S) * elapsed_s / way.elapsed_s
        local = local @ rotations.exp(min(share, 1.0) * rotations.log(np.swapaxes(way.before.local, -1, -2) @ local))
    moved = np.append(walk.place_m(frame) - walk.place_m(way.frame), 0.0)
    return State(local, way.now.trans + moved, way.now.betas, 0.0, way.now.corrections)


def _grown(surface: Silhouette, walk: Walk, frame: int, way: _Way, going_on: State, guess: State, nats: float) -> _Way:
    elapsed_s, reach = abs(frame - way.frame) / walk.fps, surface.settings.reach_px
    state = surface.refine(
        guess,
        walk.targets[frame],
        _STEPS,
        free="pose",
        reach_px=(reach[0] / 2, reach[1]),
        before=Before(going_on, elapsed_s),
    )
    share = surface.agreement(state, walk.targets[frame])
    nats += way.nats + _nats(surface, state, share)
    if way.before is not None:
        typical = np.hypot(_ACCELERATION * elapsed_s**2, _TURN_ERROR_RAD)
        nats += (
            0.5 * float((rotations.angle(going_on.local[0, _SWUNG], state.local[0, _SWUNG]) ** 2).sum()) / typical**2
        )
    return _Way(state, frame, way.now, elapsed_s, (*way.found, (frame, state, share)), nats)


def _leg_turn(a: State, b: State) -> float:
    """Largest angle between hips and knees of two states, radians."""
    return float(rotations.angle(a.local[0, _SWUNG], b.local[0, _SWUNG]).max())
