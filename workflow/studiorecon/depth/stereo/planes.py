# SPDX-License-Identifier: Apache-2.0
"""The candidate planes of a room: floors, table tops and upright walls in the two directions of its lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

# Offsets are dense within this distance of the rig's centre and thin out with its square beyond, as stereo's precision
# does.
_DENSE_M = 4.5
# Yaws are counted in bins of this size before the peak is refined.
_BIN_RAD = np.radians(0.5)


def rig_centre(cameras: Sequence[Camera]) -> Float[np.ndarray, " 3"]:
    """Mean of the camera centres, around which the offsets of wall hypotheses are spaced."""
    return np.mean([camera.centre_m for camera in cameras], axis=0)


def wall_yaw(
    cameras: Sequence[Camera], pictures: Sequence[Num[np.ndarray, "H W 3"]], known: Sequence[Bool[np.ndarray, "H W"]]
) -> tuple[float, float]:
    """Yaw in [0, pi/2) of the horizontal direction of most straight lines, and the share of line length behind it.

    A line segment and its camera centre span a plane; a horizontal line has the direction in both this plane and the
    horizontal. Every segment votes for one yaw (modulo 90°: walls come in two directions) with its length, unless it
    may be vertical or its plane is nearly horizontal. The share is 0 without lines.
    """
    detector = cv2.createLineSegmentDetector()
    yaws, weights = [], []
    for camera, rgb, mask in zip(cameras, pictures, known):
        # Local contrast is equalised, so that the detector also finds a pale wall's lines.
        grey = cv2.createCLAHE(2.0, (4, 4)).apply(
            cv2.cvtColor(np.clip(rgb * 255, 0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        )
        found = detector.detect(grey)[0]
        if found is None:
            continue
        ends = found.reshape(-1, 2, 2).astype(np.float64) + 0.5
        middle = ends.mean(axis=1).astype(int)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
        keep = (length > 0.04 * camera.wh[0]) & mask[
            middle[:, 1].clip(0, camera.hw[0] - 1), middle[:, 0].clip(0, camera.wh[0] - 1)
        ]
        rays = camera.unproject(ends[keep], np.ones((int(keep.sum()), 2))) - camera.centre_m
        normals = np.cross(rays[:, 0], rays[:, 1])
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        level = np.linalg.norm(normals[:, :2], axis=-1)
        # |n_z| small: the segment may be a vertical edge; level small: its plane is horizontal and every yaw fits.
        useful = (np.abs(normals[:, 2]) > 0.12) & (level > 0.25)
        yaws.append(np.arctan2(-normals[useful, 0], normals[useful, 1]))
        weights.append((length[keep] * level)[useful])
    if not yaws or not sum(len(y) for y in yaws):
        return 0.0, 0.0
    yaw, weight = np.concatenate(yaws) % (np.pi / 2), np.concatenate(weights)
    bins = round(np.pi / 2 / _BIN_RAD)
    histogram = np.bincount((yaw / _BIN_RAD).astype(int) % bins, weights=weight, minlength=bins)
    smooth = sum((np.roll(histogram, shift) for shift in (-2, -1, 0, 1, 2)), np.zeros(bins))
    peak = (smooth.argmax() + 0.5) * _BIN_RAD
    for reach in (np.radians(3.0), np.radians(1.5), np.radians(1.5)):
        away = (yaw - peak + np.pi / 4) % (np.pi / 2) - np.pi / 4
        near = np.abs(away) < reach
        # A weighted median, because half of the lines in the window may belong to furniture.
        order = np.argsort(away[near])
        cumulated = np.cumsum(weight[near][order])
        if len(order):
            peak += away[near][order][np.searchsorted(cumulated, cumulated[-1] / 2)]
    return float(peak % (np.pi / 2)), float(smooth.max() / weight.sum())


def plane_hypotheses(
    centre_m: Float[np.ndarray, " 3"],
    yaw_rad: float,
    floor_m: float,
    *,
    horizontal_step_m: float,
    wall_step_m: float,
    furniture_m: float,
    ceiling_m: tuple[float, float],
    reach_m: float,
) -> Float[np.ndarray, "L 4"]:
    """Planes n·p = o: horizontals from the floor to ``furniture_m`` and through the ceiling's range, then the walls.

    Walls are across yaw and yaw + 90°, up to ``reach_m`` from the rig's centre; their step grows with the square of the
    distance beyond 4.5 m.
    """
    up = np.array([0.0, 0.0, 1.0])
    heights = np.concatenate(
        [
            floor_m + np.arange(-horizontal_step_m, furniture_m + 1e-6, horizontal_step_m),
            floor_m + np.arange(ceiling_m[0], ceiling_m[1] + 1e-6, 2 * horizontal_step_m),
        ]
    )
    planes = [np.array([*up, z]) for z in heights]
    offsets = [0.0]
    while offsets[-1] < reach_m:
        offsets.append(offsets[-1] + wall_step_m * max(1.0, (offsets[-1] / _DENSE_M) ** 2))
    around = np.array([*(-np.array(offsets[:0:-1])), *offsets])
    for turn in (0.0, np.pi / 2):
        normal = np.array([np.cos(yaw_rad + turn), np.sin(yaw_rad + turn), 0.0])
        planes += [np.array([*normal, o]) for o in around + normal @ centre_m]
    return np.array(planes)
