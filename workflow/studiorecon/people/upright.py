# SPDX-License-Identifier: Apache-2.0
"""A body over time from silhouettes alone: found upright at one frame, checked against its mirror image in time, followed both ways.

A silhouette hardly tells front from back (on a real take the right facing wins by 0.01 to 0.03 of agreement), so both are fitted
in several frames before one is believed, and the margin is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.body import prior
from studiorecon.body.basis import State
from studiorecon.body.model import JOINT_NAMES, upright_global_orientation
from studiorecon.geometry import rotations
from studiorecon.people.contour import Silhouette, Targets

_YAWS = 12
# Arms hanging, and arms half raised; radians about the shoulder's z.
_ARMS_RAD = (0.0, 0.9)
_BEST = 6
_ROOT_STEPS, _POSE_STEPS, _FOLLOW_STEPS, _SHAPE_STEPS = 5, 14, 4, 8


@dataclass(frozen=True)
class Found:
    """A start: ``state`` at ``frame``, its ``agreement`` 0..1, and by how much the opposite facing agrees less (over several frames)."""

    frame: int
    state: State
    agreement: float
    margin: float


def upright(place_m: np.ndarray, floor_m: float, height_m: float, body_height_m: float, yaw_rad: float, arms_rad: float) -> State:
    """The relaxed body standing at ``place_m`` (2,) with its pelvis where that of somebody of ``height_m`` is."""
    local = prior.middle()[None].copy()
    local[0, 0] = rotations.exp(upright_global_orientation(yaw_rad))
    for sign, side in ((1, "left"), (-1, "right")):
        joint = JOINT_NAMES.index(f"{side}_shoulder")
        local[0, joint] = rotations.exp(np.array([0.0, 0.0, sign * arms_rad])) @ local[0, joint]
    trans = np.array([[place_m[0], place_m[1], floor_m + 0.53 * height_m]])
    return State(local, trans, np.zeros(10), 0.0, np.zeros((0, 3)))


def cold_start(surface: Silhouette, targets: Targets, place_m: np.ndarray, floor_m: float, height_m: float) -> list[tuple[float, State]]:
    """Agreement and state of the best facings, best first: every yaw and two arm poses by the root alone, the best ones in full."""
    reach = surface.settings.reach_px
    tried = []
    for k in range(_YAWS):
        for arms in _ARMS_RAD:
            state = upright(place_m, floor_m, height_m, 1.75, 2 * np.pi * k / _YAWS, arms)
            state = surface.refine(state, targets, _ROOT_STEPS, free="root", reach_px=(reach[0], reach[0] / 2))
            tried.append((surface.agreement(state, targets), state))
    tried.sort(key=lambda pair: -pair[0])
    refined = []
    for _, state in _distinct(tried, _BEST):
        state = surface.refine(state, targets, _POSE_STEPS, free="shape", reach_px=reach)
        refined.append((surface.agreement(state, targets), state))
    return sorted(refined, key=lambda pair: -pair[0])


def _distinct(tried: list[tuple[float, State]], count: int) -> list[tuple[float, State]]:
    """The best ``count`` of which no two face within 20° of each other with the same arms; both facings of the best are among them."""
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
    partner = [JOINT_NAMES.index(_other_side(n)) for n in JOINT_NAMES]
    # Seen from behind, the left arm is where the right one was: mirror the pose left to right, then turn by 180°.
    local[0] = mirror @ local[0, partner] @ mirror
    # The mirrored root faces where the mirror image does; only its heading is taken from the original, turned round.
    forward = state.local[0, 0] @ np.array([0.0, 0.0, 1.0])
    local[0, 0] = rotations.exp(upright_global_orientation(float(np.arctan2(-forward[1], -forward[0]))))
    return State(local, state.trans.copy(), state.betas.copy(), 0.0, state.corrections)


def _other_side(name: str) -> str:
    side, _, part = name.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, name)


def find(surface: Silhouette, targets: dict[int, Targets], place_m: Callable[[int], np.ndarray], floor_m: float, height_m: float) -> Found:
    """The best start among the frames of ``targets`` (at least one), its facing decided by following both through all of them."""
    frames = sorted(targets)
    known = {t: sum(len(o.points) for o in targets[t].outlines) for t in frames}
    chosen = sorted(sorted(frames, key=lambda t: (-known[t], t))[:2])
    starts = {t: cold_start(surface, targets[t], place_m(t), floor_m, height_m) for t in chosen}
    frame = max(chosen, key=lambda t: (starts[t][0][0], -t))
    best = starts[frame][0][1]
    candidates = [best, *(s for _, s in starts[frame][1:3]), turned_round(best)]
    scored = []
    for state in candidates:
        state = surface.refine(state, targets[frame], _POSE_STEPS, free="shape", reach_px=surface.settings.reach_px)
        followed = follow(surface, targets, frame, state)
        scored.append((float(np.mean([agreement for _, agreement in followed.values()])), state))
    order = sorted(range(len(scored)), key=lambda i: -scored[i][0])
    winner = scored[order[0]][1]
    opposite = [scored[i][0] for i in order[1:] if rotations.angle(scored[i][1].local[0, 0], winner.local[0, 0]) > np.deg2rad(90)]
    margin = scored[order[0]][0] - max(opposite, default=0.0)
    return Found(frame, winner, scored[order[0]][0], margin)


def follow(surface: Silhouette, targets: dict[int, Targets], frame: int, state: State) -> dict[int, tuple[State, float]]:
    """State and agreement at every frame of ``targets``, from ``state`` at ``frame`` forwards and backwards, shape held."""
    out = {frame: (state, surface.agreement(state, targets[frame]))}
    ordered = sorted(targets)
    at = ordered.index(frame)
    reach = surface.settings.reach_px
    for order in (ordered[at + 1 :], ordered[:at][::-1]):
        now = state
        for t in order:
            now = surface.refine(now, targets[t], _FOLLOW_STEPS, free="pose", reach_px=(reach[0] / 3, reach[1]), before=now)
            out[t] = now, surface.agreement(now, targets[t])
    return out


def shaped(surface: Silhouette, targets: dict[int, Targets], found: Found, frames: Sequence[int]) -> Found:
    """The start with the median shape of ``frames``, each fitted with its own; one frame bends the shape to its own noise."""
    followed = follow(surface, {t: targets[t] for t in {*frames, found.frame}}, found.frame, found.state)
    reach = surface.settings.reach_px
    betas = []
    for t, (state, _) in sorted(followed.items()):
        fitted = surface.refine(state, targets[t], _SHAPE_STEPS, free="shape", reach_px=(reach[0] / 3, reach[1]))
        betas.append(fitted.betas)
    state = State(found.state.local, found.state.trans, np.median(betas, axis=0), 0.0, found.state.corrections)
    state = surface.refine(state, targets[found.frame], _SHAPE_STEPS, free="pose", reach_px=(reach[0] / 3, reach[1]))
    return Found(found.frame, state, found.agreement, found.margin)
