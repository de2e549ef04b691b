# SPDX-License-Identifier: Apache-2.0
"""Motion in the player: skeletons, objects, and colours that change, at evenly spaced moments of the capture."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.deliver.gltf import BONES
from studiorecon.deliver.packing import Bytes, quantise_weights
from studiorecon.geometry import rotations
from studiorecon.splatting.rigid_object import RigidObject

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Number of body points at which the player evaluates a network that the renderer evaluates at every Gaussian.
_PLACES = 512


def motion_times(frames: int, most: int) -> Float[np.ndarray, " K"]:
    """At most ``most`` evenly spaced times of the capture, including both ends: all frames if they fit."""
    return np.linspace(0, frames - 1, max(min(frames, most), 1)) if frames > 1 else np.zeros(1)


def pack_skeleton(held: Bytes, person: Avatar, times: Num[np.ndarray, " K"]) -> dict[str, Any]:
    """A person's joints at rest and their rotations at ``times``: 16 bits a number, 0.002 degrees.

    A person who is away at times also has the moments of presence.
    """
    poses, roots_m = zip(*(person.pose_at(float(time)) for time in times))
    turns = rotations.to_quaternion(rotations.exp(np.array(poses).reshape(len(times), -1, 3)))
    # The sign of a quaternion is chosen near the previous one: slow changes compress.
    flips = np.cumprod(np.where((turns[1:] * turns[:-1]).sum(axis=-1) < 0, -1.0, 1.0), axis=0)
    turns[1:] *= flips[..., None]
    there = np.array([person.is_present(float(time)) for time in times], np.uint8)
    return {
        "rest": held.floats(person.model.rest_joints(person.betas)),
        "parents": [int(parent) for parent in person.model.parents],
        "turns": held.levels(turns.reshape(len(times), -1), 16, -1.0, 1.0),
        "places": held.floats(np.array(roots_m)),
        "valid": held.whole(person.valid.astype(np.uint8), 8),
    } | ({} if person.present.all() else {"present": held.whole(there, 8)})


def pack_rigid_motion(held: Bytes, thing: RigidObject, times: Num[np.ndarray, " K"]) -> dict[str, Any]:
    """An object's positions and rotations at ``times``, and the times at which they are known."""
    there = [thing.centre_at(float(time)) for time in times]
    turns = rotations.to_quaternion(np.stack([thing.turn_at(float(time)) for time in times]))
    return {
        "rest": held.floats(np.zeros((1, 3))),
        "parents": [-1],
        "turns": held.levels(turns, 16, -1.0, 1.0),
        "places": held.floats(np.array([np.zeros(3) if place is None else place for place in there])),
        "present": held.whole(np.array([place is not None for place in there], np.uint8), 8),
        "valid": held.whole(thing.valid.astype(np.uint8), 8),
    }


def pack_skin(held: Bytes, bones: Integer[np.ndarray, "N J"], weights: Float[np.ndarray, "N J"]) -> dict[str, Any]:
    """The four bones with the largest weights of each Gaussian, and their shares, which add up to exactly one."""
    count, given = weights.shape
    if given < BONES:
        bones = np.concatenate([bones, np.zeros((count, BONES - given), bones.dtype)], axis=1)
        weights = np.concatenate([weights, np.zeros((count, BONES - given))], axis=1)
    strongest = np.argsort(-weights, axis=1, kind="stable")[:, :BONES]
    kept = np.take_along_axis(np.asarray(weights, np.float64), strongest, axis=1)
    shares = quantise_weights(kept / kept.sum(axis=1, keepdims=True))
    return {"bones": held.whole(np.take_along_axis(bones, strongest, 1), 8), "shares": held.whole(shares, 8)}


def pack_colour_changes(
    held: Bytes, person: Avatar, order: Integer[np.ndarray, " N"], times: Num[np.ndarray, " K"]
) -> tuple[dict[str, Any], float]:
    """The changes of colour and logit by a person's network at ``times``, and the largest error of colour, 0..1.

    They are evaluated at some points of the body, to which the Gaussians in ``order`` are assigned; the error is that
    in the middle of the capture.
    """
    network, seen = person.network, person.drift_mask
    assert network is not None
    means = person.gaussians.means_m[seen]
    own = network if network.control else replace(network, control=ControlPoints.on(means, _PLACES))
    control = own.control
    assert control is not None

    values = np.stack([own.at_points(float(time)) for time in times])
    near = np.zeros((person.gaussians.count, 4), np.uint16)
    shares = np.zeros((person.gaussians.count, 4))
    near[seen], shares[seen] = control.near, control.shares
    shares[~seen, 0] = 1.0
    # Gaussians that no camera measured are assigned to one more point, which never changes.
    near[~seen] = len(control.points_m)
    values = np.concatenate([values, np.zeros((len(times), 1, 4), values.dtype)], axis=1)
    middle = float(times[len(times) // 2])
    exact, _ = network.residuals(means, middle)
    spread = control.spread(np.ascontiguousarray(values[len(times) // 2, :-1]))[:, :3]
    return {
        "moments": len(times),
        "near": held.whole(near[order], 16),
        "shares": held.whole(quantise_weights(shares[order]), 8),
        "values": held.levels(values.reshape(len(times), -1), 16, float(values.min()), float(values.max())),
    }, float(np.abs(exact - spread).max()) * 0.28209479177387814
