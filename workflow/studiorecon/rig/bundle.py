# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment of calibrated cameras on people's keypoints, and the test whether their lenses may move too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.geometry.bundle import BundleResult, BundleSettings, LensPrior, adjust_with_lenses, remove_drift
from studiorecon.geometry.distortion import undistort
from studiorecon.geometry.triangulation import Limits, triangulate, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.rig.correspondences import Observations
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

_LOOSE = 3.0
POSES_ONLY = LensPrior(0.0, 0.0)


@dataclass(frozen=True)
class AgreementLimits:
    """When cameras agree with people; a setting of every step that judges or moves cameras on people.

    A calibration is refused when people's keypoints are off by more than ``max_error_share`` of the longer image side,
    and by more than ``max_error_m`` at their distance.
    Tracks of two cameras may be one person when their rays pass within ``gate_m``, a wide gate, since poses may be off.
    """

    # The worst real calibration that refinement could still use was 0.7 % off, a shuffled one 1.2 %.
    max_error_share: float = 0.01
    # A right calibration of webcams 1 m from a seated man left 19 mm: detectors mark another point of a joint in every
    # view. Beyond about 2 m the share above is larger.
    max_error_m: float = 0.03
    gate_m: float = 0.25
    limits: Limits = Limits()

    def limit_px(self, cameras: Sequence[Camera], points_m: Num[np.ndarray, "N 3"]) -> float:
        """The largest median error of people's keypoints at ``points_m`` that is allowed, pixels."""
        of_picture = self.max_error_share * max(max(c.wh) for c in cameras)
        return max(of_picture, self.max_error_m / metres_per_px(cameras, points_m)) if len(points_m) else of_picture


def metres_per_px(cameras: Sequence[Camera], points_m: Num[np.ndarray, "N 3"]) -> float:
    """Size of a pixel of the median camera at its median point, metres."""
    return float(np.median([np.median(c.project(points_m)[1]) / np.mean(c.focal_px) for c in cameras]))


@dataclass(frozen=True)
class CalibrationPrior:
    """The prior of the given cameras' poses, for refinement on people."""

    bundle: BundleSettings = BundleSettings()


@dataclass(frozen=True)
class LensSettings:
    """When people may change a lens.

    Attributes:
        focal_sigma, radial_sigma: sigmas of a given focal length, as a share, and of its radial term k1.
        min_sigmas: a change must be this many of its own sigmas, with all frames of a joint counting as one
            observation.
        gain: share by which it must lower the median error on the validation split beyond the poses' effect.
    """

    focal_sigma: float = 0.1
    radial_sigma: float = 0.3
    min_sigmas: float = 3.0
    gain: float = 0.03


def error_medians(
    cameras: Sequence[Camera], seen: Observations, limits: Limits
) -> tuple[float, list[float | None], Num[np.ndarray, "N 3"]]:
    """Median reprojection error in pixels over all views and per camera (None: nothing seen), and the points valid
    there.

    Points need three views where there are three cameras: the residual of a pair proves nothing (T13).
    """
    found = triangulate(
        seen.pixels, seen.confidence, cameras, replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    )
    counted = found.verified if len(cameras) > 2 else found.valid
    error = np.where(counted, found.error_px, np.nan)
    per_camera = [float(np.median(row[np.isfinite(row)])) if np.isfinite(row).any() else None for row in error]
    pooled = error[np.isfinite(error)]
    return (float(np.median(pooled)) if len(pooled) else float("nan")), per_camera, found.points_m[counted]


def contradicted_share(
    cameras: Sequence[Camera], seen: Observations, detections: Sequence[Detections], limits: Limits
) -> float:
    """Share of the points of two views that are in a third one's picture, which detected people in that frame, but not
    there."""
    found = triangulate(
        seen.pixels, seen.confidence, cameras, replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    )
    elsewhere = np.zeros(len(seen.frame), dtype=bool)
    for v, (camera, d) in enumerate(zip(cameras, detections)):
        pixels, depth = camera.project(np.where(found.valid[:, None], found.points_m, np.nan))
        inside = (
            (np.nan_to_num(depth) > 0)
            & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(-1)
            & (np.nan_to_num(pixels) < camera.wh).all(-1)
        )
        elsewhere |= inside & np.isin(seen.frame, d.frame) & ~found.inliers[v]
    return float(elsewhere[found.valid].mean()) if found.valid.any() else 0.0


@dataclass(frozen=True)
class AgreeingObservations:
    """The N observations on which cameras agree.

    A detector's error of a joint is the same in every frame, so all frames of a joint count as one observation. If they
    counted fully, that bias would outvote the calibration in directions that people hardly determine, such as all
    cameras pitching together: observed as 10 px on marks of a real floor, for no gain on the keypoints.
    """

    pixels: Num[np.ndarray, "V N 2"]
    weights: Num[np.ndarray, "V N"]
    points_m: Num[np.ndarray, "N 3"]
    used: Bool[np.ndarray, " M"]

    def adjust(
        self,
        start: Sequence[Camera],
        given: Sequence[Camera] | None,
        limits: Limits,
        bundle: BundleSettings,
        lens: LensPrior = POSES_ONLY,
        units: float = 1.0,
    ) -> BundleResult:
        """The cameras bundle-adjusted from ``start`` with the prior at ``given``, by default at the start."""
        huber_px = units * unit_px(start, limits)
        return adjust_with_lenses(start, self.pixels, self.weights, self.points_m, huber_px, bundle, lens, given)


def agreeing_observations(seen: Observations, cameras: Sequence[Camera], limits: Limits) -> AgreeingObservations | None:
    """The observations on which three cameras agree (of two cameras: both); None where they are too few."""
    if not len(seen.frame):
        return None
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    used = found.verified if len(cameras) > 2 else found.valid
    if used.sum() < 10 * len(cameras):
        return None
    joints = len(np.unique(seen.group[used] * len(STABLE_KEYPOINTS) + seen.keypoint[used]))
    weights = np.where(found.inliers, seen.confidence, 0.0)[:, used] * (joints / used.sum())
    return AgreeingObservations(seen.pixels[:, used], weights, found.points_m[used], used)


def fit_cameras(
    cameras: Sequence[Camera],
    seen: Observations,
    limits: Limits,
    bundle: BundleSettings,
    lens: LensPrior = POSES_ONLY,
    close: bool = False,
) -> BundleResult | None:
    """Three or more cameras bundle-adjusted on ``seen`` without their common drift; None where people show too little.

    Loose limits first, so that a wrong camera can converge (unless all are ``close``), then the usual ones.
    """
    if len(cameras) < 3:
        return None
    result: BundleResult | None = None
    current = list(cameras)
    for loose in (1.0,) if close else (_LOOSE, 1.0):
        wide = replace(limits, outlier_units=limits.outlier_units * loose)
        bent = remove_radial(seen, current, result.radial) if result is not None else seen
        found = agreeing_observations(bent, current, wide)
        if found is None:
            return None
        # Every round starts at the given lenses with the poses of the last, because the priors refer to the given
        # lenses.
        start = [replace(c, intrinsics=g.intrinsics) for c, g in zip(current, cameras)]
        result = replace(found, pixels=seen.pixels[:, found.used]).adjust(start, None, limits, bundle, lens)
        current = result.cameras
    return replace(result, cameras=remove_drift(current, cameras)[0]) if result is not None else None


def remove_radial(seen: Observations, cameras: Sequence[Camera], radial: Num[np.ndarray, " V"]) -> Observations:
    """The observations without a radial term k1 in addition to the distortion removed before; pixels without a ray are
    dropped."""
    pixels, confidence = seen.pixels.copy(), seen.confidence.copy()
    for v in map(int, np.flatnonzero(radial)):
        focal, principal = np.array(cameras[v].focal_px), np.array(cameras[v].principal_px)
        known = confidence[v] > 0
        rays, valid = undistort(
            (pixels[v, known] - principal) / focal, "opencv", np.array([radial[v], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        )
        pixels[v, known] = np.where(valid[:, None], rays * focal + principal, np.nan)
        confidence[v, known] = np.where(valid, confidence[v, known], 0.0)
    return replace(seen, pixels=pixels, confidence=confidence)


def choose_lens_terms(
    cameras: Sequence[Camera],
    fit_on: Observations,
    validation: Observations,
    limits: Limits,
    bundle: BundleSettings,
    lens: LensSettings,
) -> dict[str, Any]:
    """Whether focal lengths, or these and a radial term, explain the validation split better than ``cameras``.

    ``cameras``: the best with poses only, fitted on ``fit_on``. A term is required when some camera's change is
    ``min_sigmas`` of its own sigmas and the median error on ``validation`` falls by a further ``gain``.
    """
    before = error_medians(cameras, validation, limits)[0]
    report: dict[str, Any] = {"unseen_poses_only_px": before, "focal": False, "radial": False}
    best = before
    for name, prior, column in (
        ("focal", LensPrior(lens.focal_sigma, 0.0), 6),
        ("radial", LensPrior(lens.focal_sigma, lens.radial_sigma), 7),
    ):
        result = fit_cameras(cameras, fit_on, limits, bundle, prior, close=True)
        if result is None:
            break
        after = error_medians(result.cameras, remove_radial(validation, result.cameras, result.radial), limits)[0]
        longer = np.array([c.focal_px[0] / g.focal_px[0] for c, g in zip(result.cameras, cameras)])
        change = result.radial if name == "radial" else np.log(longer)
        sigmas = float(np.max(np.abs(change) / np.maximum(result.sigma[:, column], 1e-9)))
        report |= {f"unseen_with_{name}_px": after, f"{name}_sigmas": sigmas}
        if after < best * (1 - lens.gain) and sigmas >= lens.min_sigmas:
            report[name], best = True, after
    return report
