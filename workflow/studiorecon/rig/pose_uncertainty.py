# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of calibrated cameras' rotations by the people they see."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.intervals import camera_intervals
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.detector_noise import DetectorNoise
from studiorecon.rig.estimate import estimate_once
from studiorecon.rig.from_tracks import MIN_SHARED, Rig
from studiorecon.rig.lens_knowledge import fixed_lenses
from studiorecon.rig.moved_cameras import ADULT_JOINTS_M, MovedCameras
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Factor on the interval of the worst pair in ``rotation_interval_deg`` for errors about all three axes.
ABOUT_ALL_AXES = 3.4 / 3.0


def rotation_observability(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> tuple[float, float] | None:
    """How well people alone determine calibrated cameras' relative rotation: the change that they require, and its
    interval.

    These are the degrees by which they would turn two cameras, and half of the 95 % interval of the worst pair. A
    calibration fits people even if it is off by their sum: one man in one place allows degrees. None with too little
    evidence. People determine nothing about cameras that do not see them.
    """
    sighted = [int(v) for v in np.flatnonzero((seen.confidence > 0).any(1))]
    cameras, seen = [cameras[v] for v in sighted], seen.by(sighted)
    if len(cameras) < 2:
        return None
    rig = Rig(dict(enumerate(cameras)), seen, triangulate(seen.pixels, seen.confidence, cameras, limits), 0)
    if int(rig.agreeing.sum()) < MIN_SHARED:
        return None
    lenses = fixed_lenses(cameras)
    found = estimate_once(rig, np.zeros(len(cameras)), lenses, ADULT_JOINTS_M, DetectorNoise.typical(cameras, limits))
    found = estimate_once(rig, np.zeros(len(cameras)), lenses, ADULT_JOINTS_M, found.noise)
    ours, given = ([c.camera_from_world[:3, :3] for c in group] for group in (found.cameras, cameras))
    turned = [angle(ours[a] @ ours[b].T, given[a] @ given[b].T) for a, b in combinations(range(len(cameras)), 2)]
    return float(np.degrees(np.max(turned))), camera_intervals(found.solution).between_deg


def moved_rotation_interval_deg(found: MovedCameras, limits: Limits) -> float:
    """``rotation_interval_deg`` of refined moved cameras, for errors about all three axes.

    From their fit's sigmas and, where no room was used, from what people alone determine.
    """
    found_deg = rotation_interval_deg(np.array(list(found.report["sigma_deg"].values())))
    if not found.report.get("room", {}).get("explained"):
        observable = rotation_observability(found.cameras, found.seen, limits)
        found_deg = max(found_deg, 0.0 if observable is None else observable[1])
    return ABOUT_ALL_AXES * found_deg


def rotation_interval_deg(turn_deg: Num[np.ndarray, " V"]) -> float:
    """Half of the 95 % interval, degrees, of the rotation between the two least certain cameras, valid for the worst
    pair.

    ``turn_deg`` are the rotations' standard deviations. 3 standard deviations: of six pairs, between 2.6 for
    errors about one axis and 3.4 for errors about all three.
    """
    return float(3.0 * np.sqrt((np.sort(turn_deg)[-2:] ** 2).sum()))
