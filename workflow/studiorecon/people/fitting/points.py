# SPDX-License-Identifier: Apache-2.0
"""One person's keypoints in all cameras by name, and their points in the world (paper §triangulation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.configuration.setting import setting
from studiorecon.geometry.triangulation import Limits, Solver, triangulate
from studiorecon.keypoints.layouts import HAND_POINT_NAMES, LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num


_HALF_FINGER_M = 0.006


@dataclass(frozen=True)
class Triangulation(Limits):
    """Limits of agreement between views, wider than for cameras; see ``geometry.triangulation.triangulate``.

    Within them the Huber norm bounds the pull of a wrong view, and bones keep their lengths better where no view comes
    and goes (15.5 mm instead of 16.7 on a real take).
    """

    solver: Solver = setting(
        "robust",
        "robust = views that agree; huber = weighted Huber refinement from DLT; dlt = homogeneous least squares.",
        paper="huber",
        paper_value="huber",
    )
    min_confidence: float = 0.2
    outlier_units: float = 5.0


@dataclass(frozen=True)
class Points:
    """Triangulated keypoints of one person.

    Attributes:
        names: K keypoints the body knows.
        points_m: (T, K, 3), NaN where undetermined; ``sigma_m``: (T, K) deviation per coordinate, inf there.
        cameras: cameras that saw the person.
    """

    names: list[str]
    points_m: Float[np.ndarray, "T K 3"]
    sigma_m: Float[np.ndarray, "T K"]
    cameras: Integer[np.ndarray, " T"]


def person_keypoints(
    person: str, detections: list[Detections], identities: dict[tuple[str, int], str], body: BodyModel, frames: int
):
    """Names (K) and keypoints (V, T, K, 3) of one person in every camera: x, y, confidence; NaN and 0 where there is
    none."""
    known = {
        d.camera: [LAYOUTS[d.layout].keypoints[k] for k in LAYOUTS[d.layout].among(body.keypoint_names)]
        for d in detections
    }
    names = sorted({n for camera_names in known.values() for n in camera_names})
    out = np.full((len(detections), frames, len(names), 3), np.nan)
    out[..., 2] = 0.0
    for view, seen in enumerate(detections):
        layout = LAYOUTS[seen.layout]
        source, target = layout.among(body.keypoint_names), [names.index(n) for n in known[seen.camera]]
        for d in range(len(seen.frame)):
            frame = int(seen.frame[d])
            if identities.get((seen.camera, int(seen.track[d])), "") != person or not 0 <= frame < frames:
                continue
            # Two tracks of one person may overlap for a frame where one continues the other: the more confident one
            # counts.
            if np.nansum(seen.keypoints[d, source, 2]) > out[view, frame, :, 2].sum():
                out[view, frame] = [np.nan, np.nan, 0.0]
                out[view, frame, target] = seen.keypoints[d, source]
    return names, out


def triangulate_hands(
    hands: Num[np.ndarray, "V T 2 21 3"], cameras: list[Camera], settings: Triangulation
) -> list[Points]:
    """World points of the left and the right hand.

    A hand is small: a view that is off by half the body's limit shows another finger. Two cameras' points get the
    thickness of half a finger added, as nothing proves that they mean the same side of it. Unsure points count as
    little as they say, but count.
    """
    limits = replace(settings, outlier_units=settings.outlier_units / 2, min_confidence=0.0)
    return [
        triangulate_keypoints(list(names), hands[:, :, side], cameras, limits, _HALF_FINGER_M)
        for side, names in enumerate(HAND_POINT_NAMES)
    ]


def detector_offset_m(names: Sequence[str], detections: Sequence[Detections]) -> Num[np.ndarray, " K"]:
    """Distance of the detectors' points from the body's, metres: the largest of all layouts."""
    layouts = [LAYOUTS[name] for name in sorted({d.layout for d in detections})]
    return np.array([max((one.off_m(name) for one in layouts), default=0.0) for name in names])


def triangulate_keypoints(
    names: list[str],
    keypoints: Num[np.ndarray, "V T K 3"],
    cameras: list[Camera],
    settings: Triangulation,
    unverified_sigma_m: float,
    off: Num[np.ndarray, " K"] | float = 0.0,
) -> Points:
    """World points of all frames at once from keypoints.

    Those of only two cameras get ``unverified_sigma_m`` added (T13), all of them ``off`` (``detector_offset_m``).
    """
    views, frames, count = keypoints.shape[:3]
    flat = keypoints.reshape(views, frames * count, 3)
    result = triangulate(flat[..., :2], flat[..., 2], cameras, settings, solver=settings.solver)
    with np.errstate(invalid="ignore"):
        sigma = result.sigma_m / np.sqrt(3)
    sigma = np.where(result.verified, sigma, np.hypot(sigma, unverified_sigma_m))
    sigma = np.hypot(np.where(result.valid, sigma, np.inf).reshape(frames, count), off)
    seen = (np.isfinite(keypoints[..., 0]) & (keypoints[..., 2] > 0)).any(-1).sum(0)
    return Points(names, result.points_m.reshape(frames, count, 3), sigma, seen)
