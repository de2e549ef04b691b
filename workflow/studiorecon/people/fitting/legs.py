# SPDX-License-Identifier: Apache-2.0
"""Unseen legs of people at a table or behind a counter: bent until their feet are on the floor.

The pose prior lets unseen legs hang from the pelvis; those of a seated person then pass through the floor. The pelvis's
height is known: shanks upright, thighs as steep as reaches the floor. It is a guess, which the fit's sigmas show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_SIDES = ("left", "right")
_BELOW = ("knee", "ankle", "heel", "big_toe", "small_toe")
# Feet deeper than this below the floor, metres, are wrong: floors are known to a few centimetres.
_UNDER_M = 0.1
# From ankle to sole, metres.
_SOLE_M = 0.07


def bend_hidden_legs(
    local: Float[np.ndarray, "T 24 3 3"],
    trans_m: Float[np.ndarray, "T 3"],
    betas: Float[np.ndarray, " B"],
    names: list[str],
    points_m: Float[np.ndarray, "T K 3"],
    body: BodyModel,
) -> tuple[Float[np.ndarray, "T 24 3 3"], Bool[np.ndarray, "T 2"]]:
    """``local`` with unseen legs bent where they would pass through the floor z = 0, and (T, 2) bool which.

    ``points_m`` are the triangulated keypoints ``names``, NaN where unknown; left leg first. Frames that are not finite
    stay.
    """
    out, bent = local.copy(), np.zeros((len(local), 2), dtype=bool)
    whole = np.isfinite(local).all((1, 2, 3)) & np.isfinite(trans_m).all(1)
    if not whole.any():
        return out, bent
    joints = np.full((len(local), 24, 3), np.nan)
    joints[whole] = body.joints(rotations.log(local[whole]).reshape(-1, 72), betas, trans_m[whole])
    level = _level(local[:, 0])
    for k, side in enumerate(_SIDES):
        hip, knee, ankle, foot = (JOINT_NAMES.index(f"{side}_{j}") for j in ("hip", "knee", "ankle", "foot"))
        below = [
            i for i, name in enumerate(names) if name in [f"{side}_{j}{end}" for j in _BELOW for end in ("", "_joint")]
        ]
        unseen = ~np.isfinite(points_m[:, below]).all(-1).any(1)
        bent[:, k] = whole & unseen & (np.nan_to_num(joints[:, [ankle, foot], 2].min(1), nan=0.0) < -_UNDER_M)
        which = bent[:, k]
        bones = joints[whole][:, [hip, knee]] - joints[whole][:, [knee, ankle]]
        thigh_m, shank_m = np.median(np.linalg.norm(bones, axis=-1), axis=0)
        drop = (joints[which, hip, 2] - shank_m - _SOLE_M) / thigh_m
        cosine = np.clip(drop, -0.5, 1.0)
        turn = rotations.exp(np.arctan2(np.sqrt(1 - cosine**2), cosine)[:, None] * np.array([-1.0, 0.0, 0.0]))
        out[which, hip] = np.swapaxes(local[which, 0], -1, -2) @ level[which] @ turn
        out[which, knee] = np.swapaxes(turn, -1, -2)
        out[np.ix_(which, np.array([ankle, foot]))] = np.eye(3)
    return out, bent


def _level(root: np.ndarray) -> np.ndarray:
    """(T, 3, 3) the upright rotation (y up, z ahead) of bodies with the heading of ``root`` (T, 3, 3)."""
    up = np.array([0.0, 0.0, 1.0])
    ahead = root[:, :, 2] - (root[:, :, 2] @ up)[:, None] * up
    # A person lying down faces up or down: the direction of the head replaces the heading.
    ahead = np.where(
        np.linalg.norm(ahead, axis=1, keepdims=True) > 1e-3, ahead, root[:, :, 1] * [1, 1, 0] + [1e-9, 0, 0]
    )
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack(
        [np.cross(np.broadcast_to(up, ahead.shape), ahead), np.broadcast_to(up, ahead.shape), ahead], axis=-1
    )
