# SPDX-License-Identifier: Apache-2.0
"""Refines a rig from people: poses and focal lengths together, then the room's edges, with people grouped again in
between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.bundle import BundleResult, LensPrior
from studiorecon.progress import say
from studiorecon.rig.bundle import AgreementLimits
from studiorecon.rig.from_tracks import Rig, Sightings, adjust_rig, refine_rig
from studiorecon.rig.room_turns import RoomTurn, room_turns

if TYPE_CHECKING:
    from jaxtyping import Num

_ROUNDS = 6
_SETTLED_SHARE = 0.002
# Rounds in which people are grouped again after the room's edges turned the cameras; least share of people's support to
# keep, and largest factor on their error.
_EDGE_ROUNDS = 2
_KEPT_SUPPORT, _EDGES_COST = 0.9, 1.2


def self_calibrate(
    rig: Rig,
    seen: Sightings,
    template_m: Num[np.ndarray, "12 3"],
    lens: LensPrior,
    known_px: Mapping[int, float],
    agreement: AgreementLimits,
) -> tuple[Rig, BundleResult]:
    """The rig and its adjustment after poses and focal lengths are refined together, with new groups, until focal
    lengths converge."""
    result, _ = adjust_rig(rig, lens, agreement.limits, known_px)
    for _ in range(_ROUNDS):
        before = np.array([rig.cameras[v].focal_px[0] for v in sorted(rig.cameras)])
        after = np.array([c.focal_px[0] for c in result.cameras])
        again = refine_rig(seen, dict(enumerate(result.cameras)), template_m, agreement.gate_m, agreement.limits)
        if again is None:
            break
        rig = again
        if np.abs(after / before - 1).max() < _SETTLED_SHARE:
            break
        result, _ = adjust_rig(rig, lens, agreement.limits, known_px)
    return rig, adjust_rig(rig, lens, agreement.limits, known_px)[0]


def rotate_by_edges(
    rig: Rig,
    result: BundleResult,
    seen: Sightings,
    template_m: Num[np.ndarray, "12 3"],
    lens: LensPrior,
    known_px: Mapping[int, float],
    edges: Mapping[int, Num[np.ndarray, "N 4"]],
    agreement: AgreementLimits,
) -> tuple[Rig, BundleResult, dict[int, RoomTurn]]:
    """The rig refined on the rotations from the room's edges, its adjustment, and these rotations.

    Unchanged without sufficient edges, or where people contradict them.
    """
    turns = room_turns(dict(enumerate(result.cameras)), edges)
    if not turns:
        return rig, result, {}
    held, after = rig, result
    for _ in range(_EDGE_ROUNDS):
        again = refine_rig(
            seen, dict(enumerate(after.cameras)), template_m, agreement.gate_m, agreement.limits, turns=turns
        )
        if again is None:
            return rig, result, {}
        held, (after, _) = again, adjust_rig(again, lens, agreement.limits, known_px, turns)
    if held.support < _KEPT_SUPPORT * rig.support or after.error_units > _EDGES_COST * result.error_units:
        say(
            f"the room's edges were left out: with them people agree less ({held.support} keypoints instead of "
            f"{rig.support}, {after.error_units / result.error_units - 1:+.0%} error)"
        )
        return rig, result, {}
    return held, after, turns
