# SPDX-License-Identifier: Apache-2.0
"""Converts a calibration's own world and unit to ours: metres, z up, near the origin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.rotations import turn_to_z

if TYPE_CHECKING:
    from jaxtyping import Float

# Cameras of one room are 2 to 50 m apart in the median: more units than this are millimetres, or centimetres.
_MILLIMETRE_SPREAD = 100.0
# Millimetres among metres are a thousand times as long; cameras of one room are never a hundred times as far out.
_MIXED_UNITS, _MIXED_PAIRS = 100.0, 300.0
_FAR_FROM_ORIGIN_M = 100.0
_UP_TOLERANCE_DEG = 45.0
_EYE_HEIGHT_M = 1.5


def refuse_wrong_places(
    names: Sequence[str], poses: Sequence[Float[np.ndarray, "4 4"]], centres: Float[np.ndarray, "N 3"], source: str
) -> None:
    """Raise UserError for two cameras of one pose, and for cameras a hundred times further out than the others.

    The lengths of the latter are in another unit, or wrong. Two cameras may share a place and face different
    directions: so do inverted poses of a ring, which the people reveal.
    """
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    turned = np.array([[np.abs(one[:3, :3] - other[:3, :3]).max() > 1e-6 for other in poses] for one in poses])
    near = np.where(np.eye(len(names), dtype=bool) | turned, np.inf, apart)
    one, other = divmod(int(np.argmin(near)), len(names))
    if len(names) > 1 and near[one, other] <= 1e-6 * max(apart.max(), 1e-6):
        raise UserError(
            f"{source} gives cameras {names[one]} and {names[other]} one and the same pose: that of one "
            "is missing or copied; calibrate it again, or leave it out with train: [...] in capture.yaml"
        )
    # From the camera that has half of the others nearest.
    away = apart[np.argmin(np.sort(apart)[:, (len(apart) - 1) // 2])]
    order = np.argsort(away, kind="stable")
    ratio = away[order[1:]] / np.maximum(away[order[:-1]], 1e-9)
    # The two lenses of a stereo pair are close to one another and far from all others.
    gaps = np.flatnonzero(ratio[1:] > np.where(np.arange(1, len(ratio)) == 1, _MIXED_PAIRS, _MIXED_UNITS)) + 1
    if len(gaps):
        far = [names[i] for i in sorted(order[gaps[0] + 1 :])]
        raise UserError(
            f"{source} puts {', '.join(far)} {away[order[gaps[0] + 1]]:.4g} units and more from the "
            f"others, which are {away[order[gaps[0]]]:.4g} apart: the lengths of one calibration "
            "must have one unit; correct the translation, or leave these cameras out with train: [...] in capture.yaml"
        )


def metres_per_unit(
    centres: Float[np.ndarray, "N 3"], unit: str, wanted: Literal["auto", "m", "cm", "mm"]
) -> tuple[float, str | None]:
    """Factor to metres for camera centres in a file's unit ("m", "mm", "unknown"), and a sentence if it was guessed."""
    factors = {"m": 1.0, "cm": 0.01, "mm": 0.001}
    if wanted != "auto":
        return factors[wanted], f"lengths were read as {wanted} (calibration.unit)"
    if unit in factors:
        return factors[unit], None
    # The distance within which half of the others are from most cameras: one far away, or wrong, does not decide the
    # unit of all, nor do the two lenses of a stereo pair.
    apart = np.sort(np.linalg.norm(centres[:, None] - centres[None], axis=-1))
    spread = float(np.median(apart[:, len(apart) // 2])) if len(apart) > 1 else 0.0
    is_mm = spread > _MILLIMETRE_SPREAD
    return (
        0.001 if is_mm else 1.0,
        f"the file does not state its unit; the cameras are {spread:.4g} units apart in the median, read as "
        f"{'millimetres' if is_mm else 'metres'}; set calibration.unit if that is wrong",
    )


def camera_up(rotations_camera_from_world: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, " 3"]:
    """Unit up vector for level cameras: across all their x axes, on the side of their -y axes.

    Pitched cameras bias the mean of -y, but not the cross direction. With rolled cameras, or parallel x axes, the mean
    of -y is used.
    """
    mean = -rotations_camera_from_world[:, 1].mean(0)
    values, vectors = np.linalg.eigh(sum(np.outer(x, x) for x in rotations_camera_from_world[:, 0]))
    level = vectors[:, 0] * np.sign(vectors[:, 0] @ mean or 1.0)
    if values[0] < 0.2 * values[1] and level @ mean > np.cos(np.radians(35.0)) * np.linalg.norm(mean):
        return level
    if np.linalg.norm(mean) < 0.2:
        raise UserError(
            "the cameras do not agree on which way is up; set calibration.up to the "
            "axis of the calibration that points up"
        )
    return mean / np.linalg.norm(mean)


def z_up_from_world(rotations: Float[np.ndarray, "N 3 3"], wanted: str) -> tuple[Float[np.ndarray, "3 3"], str | None]:
    """Rotation from the calibration's world to one with z up, and a sentence when it is not the identity.

    ``wanted`` is "auto" (trust z when the cameras' own up is within 45° of it, else the nearest axis within 20°, else
    the cameras' up itself) or a signed axis such as "-y".
    """
    if wanted != "auto":
        axis = np.zeros(3)
        axis["xyz".index(wanted[-1])] = -1.0 if wanted.startswith("-") else 1.0
        turn = turn_to_z(axis)
        return (
            turn,
            None if wanted == "z" else f"the world was turned so that its {wanted} axis points up (calibration.up)",
        )
    up = camera_up(rotations)
    if up[2] > np.cos(np.radians(_UP_TOLERANCE_DEG)):
        return np.eye(3), None
    pivot = int(np.argmax(np.abs(up)))
    if abs(up[pivot]) > np.cos(np.radians(20.0)):
        axis = np.zeros(3)
        axis[pivot] = np.sign(up[pivot])
        name = f"{'-' if up[pivot] < 0 else '+'}{'xyz'[pivot]}"
        return turn_to_z(
            axis
        ), f"the cameras are upright along the calibration's {name} axis: the world was turned so that it points up"
    return (
        turn_to_z(up),
        "the calibration's world has no axis that points up: it was turned by the "
        f"cameras' own up, {np.round(up, 3).tolist()}",
    )


def to_metric_world(
    poses: Sequence[Float[np.ndarray, "4 4"]], z_up: Float[np.ndarray, "3 3"], factor: float, floor_known: bool
) -> tuple[list[Float[np.ndarray, "4 4"]], list[str]]:
    """``camera_from_world`` of all cameras in metres and z up, and sentences about shifts.

    They are shifted when far away or without a floor: coordinates a hundred metres from the origin cost pixels in
    float32 (C08). A rotated world has no known floor: the cameras are put at eye height until people determine it.
    """
    moved = []
    for pose in poses:
        new = np.eye(4)
        new[:3, :3], new[:3, 3] = pose[:3, :3] @ z_up.T, pose[:3, 3] * factor
        moved.append(new)
    centres = np.array([-p[:3, :3].T @ p[:3, 3] for p in moved])
    shift, notes = np.zeros(3), []
    if np.linalg.norm(centres[:, :2].mean(0)) > _FAR_FROM_ORIGIN_M:
        shift[:2] = -np.round(centres[:, :2].mean(0))
        notes.append(
            f"the cameras are {np.linalg.norm(centres[:, :2].mean(0)):.0f} m from the origin: the "
            f"world was moved by {shift[:2].tolist()} m"
        )
    if not floor_known or abs(np.median(centres[:, 2])) > _FAR_FROM_ORIGIN_M:
        shift[2] = _EYE_HEIGHT_M - float(np.median(centres[:, 2]))
        notes.append(
            f"the floor's height is unknown: the cameras are {_EYE_HEIGHT_M} m above it until people are measured"
        )
    for pose in moved:
        pose[:3, 3] -= pose[:3, :3] @ shift
    return moved, notes
