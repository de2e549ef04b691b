# SPDX-License-Identifier: Apache-2.0
"""One person's body over time: fit the body model to the triangulated keypoints of all cameras, fill gaps, smooth.

Somebody without keypoints is fitted to silhouettes instead. Paper §fitting and appendix (smoothing). Shape is shared
over the sequence (numerics U39); the world is in metres, so there is no scale to estimate: the ratio of measured to fitted limbs is
reported as a check (U36).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from studiorecon.body import alternation, fitting
from studiorecon.body.model import OTHER_SIDE, BodyModel
from studiorecon.errors import Refusal
from studiorecon.geometry import rotations, smoothing
from studiorecon.geometry.smoothing import Smoothing
from studiorecon.people.legs import seated
from studiorecon.people.points import Points, Triangulation, lift, observations
from studiorecon.people.skin import surface_of
from studiorecon.people.standing import HullSettings, Standing, follow_standing, read_standing
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.people import Person, read_detections, read_identities, write_person

_LIMBS = tuple((f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow")))

# Share of the fitted frames that must lie near their keypoints; chance agreements of wrong points pass in an eighth of them.
_LEAST_PLAUSIBLE = 0.5


_FITTED = {f.name for f in fields(fitting.FitSettings)}


@dataclass(frozen=True)
class BodyFit:
    """How the body is fitted; see ``body/fitting.FitSettings`` for all between ``solver`` and ``unverified_sigma_m``.

    Attributes:
        solver: "levenberg_marquardt" (``body/fitting``), or "paper": its loss and 30 iterations literally (``body/alternation``, U38).
        unverified_sigma_m: deviation added to points that only two cameras agree on: their residual says nothing (numerics T13).
        worst_frame_m: frames whose median point lies further from the body count as not measured.
        worst_beta: deviations from the mean shape beyond which the points are no person's, or the lengths no metres.
    """

    solver: str
    iterations: int
    tolerance: float
    point_sigma_m: float
    correction_sigma_m: float
    huber_units: float
    pose_weight: float
    limit_weight: float
    beta_weight: float
    vertex_weight: float
    shape: str
    unverified_sigma_m: float
    worst_frame_m: float
    worst_beta: float


@dataclass(frozen=True)
class Settings:
    """Keys of the section ``people`` that this step uses."""

    triangulation: Triangulation
    fit: BodyFit
    smooth: Smoothing
    hull: HullSettings


def fit_person(
    person: str, points: Points, body: BodyModel, fps: float, settings: Settings, surface: fitting.Surface | None = None
) -> tuple[Person, fitting.Fit]:
    """The person in all frames, and the fit before gaps were filled; raises Refusal when no frame could be measured.

    ``surface``: triangulated surface points, where a source gives bodies (paper: the vertex term; numerics U33).
    """
    frames = len(points.points_m)
    keys = settings.fit
    if not (points.cameras >= 2).any():
        raise Refusal(
            f"person {person} is never seen by two cameras in the same frame (frames 0–{frames - 1}); correct {person} in "
            "people/identities.tsv, or leave the person out there"
        )
    options = fitting.FitSettings(**{f.name: getattr(keys, f.name) for f in fields(keys) if f.name in _FITTED}, free_scale=False)
    solve = alternation.fit if keys.solver == "paper" else fitting.fit
    result = solve(body, points.names, points.points_m, points.sigma_m, options, surface)
    if not result.valid.any():
        raise Refusal(
            f"person {person}: no frame of 0–{frames - 1} has enough keypoints on which two cameras agree; check the calibration "
            "(cameras/refinement.png) and the identities (people/identities.tsv)"
        )
    median = _row_median(result.residual_m)
    valid = result.valid & (median <= keys.worst_frame_m)
    if valid.sum() < _LEAST_PLAUSIBLE * result.valid.sum():
        raise Refusal(
            f"person {person}: the body lies more than people.fit.worst_frame_m = {keys.worst_frame_m:g} m off the keypoints in "
            f"{result.valid.sum() - valid.sum()} of {result.valid.sum()} frames; check the keypoint layout, calibration and identities"
        )
    worst = int(np.argmax(np.abs(result.betas)))
    if abs(result.betas[worst]) > keys.worst_beta:
        raise Refusal(
            f"person {person}: the fitted shape is {result.betas[worst]:.1f} deviations from the mean (beta {worst}, frames "
            f"{frame_ranges(valid)}), which no person is; check that the calibration is in metres, the keypoint layout and the identities"
        )
    local, bent = seated(result.rotations, result.trans_m, result.betas, points.names, points.points_m, body)
    if (valid[:, None] & bent).any():
        say(
            f"{person}: no camera shows the legs in {(valid & bent.any(1)).sum()} frames, and they cannot hang through the floor: they are "
            "bent as somebody sits, a guess that the joints' deviations mark"
        )
    return _person(person, local, result.trans_m, result.betas, valid, result.joint_sigma_m, body, fps, settings), result


def fit_standing(person: Standing, cameras: list[Camera], body: BodyModel, frames: int, fps: float, settings: Settings) -> Person:
    """The body of somebody without keypoints, from silhouettes; raises Refusal when too few frames agree."""
    keys = settings.hull
    followed = follow_standing(person, cameras, body, fps, keys)
    local, trans, agreement = np.zeros((frames, 24, 3, 3)), np.zeros((frames, 3)), np.zeros(frames)
    for t, (state, share) in followed.items():
        local[t], trans[t], agreement[t] = state.local[0], state.trans[0], share
    valid = agreement >= keys.least_agreement
    if valid.sum() < _LEAST_PLAUSIBLE * len(followed):
        raise Refusal(
            f"person {person.name}: the body agrees with the silhouettes by people.hull.least_agreement = {keys.least_agreement:g} in only "
            f"{valid.sum()} of {len(followed)} frames; bring keypoints of this person, or set people.hull.use to never"
        )
    # What the outlines do not explain may be anywhere: the less they agree, the less is known.
    sigma = keys.sigma_m / np.maximum(agreement, 0.1)[:, None] * np.ones(24)
    facing = person.start.facing
    # Facing the other way, every joint would be where its partner of the other side is.
    apart_m = _to_other_side_m(local[valid], trans[valid], person.start.state.betas, body)
    sigma[valid] = np.hypot(sigma[valid], np.sqrt((1 - facing.probability) / 3) * apart_m)
    say(
        f"{person.name}: body measured from silhouettes alone in {valid.sum()} of {frames} frames, agreement "
        f"{np.median(agreement[valid]):.2f} (median, 1 = identical); joints are known to about {1000 * np.median(sigma[valid]):.0f} mm; "
        f"{facing.sentence()}"
    )
    return _person(person.name, local, trans, person.start.state.betas, valid, sigma, body, fps, settings)


def _to_other_side_m(local: np.ndarray, trans_m: np.ndarray, betas: np.ndarray, body: BodyModel) -> np.ndarray:
    """(F, 24) distance from every joint to its partner of the other side, 0 in the middle, of poses (F, 24, 3, 3)."""
    joints = body.joints(rotations.log(local).reshape(len(local), 72), betas, trans_m)
    return np.linalg.norm(joints - joints[:, list(OTHER_SIDE)], axis=-1)


def _person(
    name: str,
    local: np.ndarray,
    trans_m: np.ndarray,
    betas: np.ndarray,
    valid: np.ndarray,
    sigma_m: np.ndarray,
    body: BodyModel,
    fps: float,
    settings: Settings,
) -> Person:
    """Fill frames that are not ``valid`` (T,), smooth, and pose the body; ``sigma_m`` (T, 24) counts where valid."""
    local = smoothing.fill_rotations(np.where(valid[:, None, None, None], local, np.eye(3)), valid)
    trans = smoothing.fill_vectors(np.where(valid[:, None], trans_m, 0.0), valid)
    local, trans = settings.smooth.smooth_body(local, trans, fps)
    poses = rotations.log(local).reshape(len(valid), 72)
    return Person(
        name=name,
        body=body.identity,
        fps=fps,
        poses=poses,
        trans=trans,
        betas=betas,
        joints=body.joints(poses, betas, trans),
        valid=valid,
        sigma=np.where(valid[:, None], sigma_m, np.inf),
        metric=True,
    )


def limb_ratio(points: Points, fitted: Person, body: BodyModel) -> float:
    """Median of measured over fitted limb lengths, long bones only (numerics S04, S05); NaN when none was measured."""
    at = {n: k for k, n in enumerate(points.names)}
    model = body.keypoints(points.names, fitted.poses, fitted.betas, fitted.trans)
    ratios = []
    for a, b in _LIMBS:
        if a in at and b in at:
            measured = np.linalg.norm(points.points_m[:, at[a]] - points.points_m[:, at[b]], axis=-1)
            ratios.append(measured / np.linalg.norm(model[:, at[a]] - model[:, at[b]], axis=-1))
    found = np.concatenate(ratios)[np.isfinite(np.concatenate(ratios))] if ratios else np.zeros(0)
    return float(np.median(found)) if len(found) else float("nan")


def _say_filled(fitted: Person) -> None:
    if not fitted.valid.all():
        say(f"{fitted.name}: frames {frame_ranges(~fitted.valid)} are filled from their neighbours and marked not valid")


def frame_ranges(chosen: np.ndarray) -> str:
    """``"3–5, 9"``: the frames where ``chosen`` (T,) is true."""
    at = np.flatnonzero(chosen)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
    return ", ".join(f"{r[0]}–{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)


def _row_median(values: np.ndarray) -> np.ndarray:
    """(T,) median of each row's finite entries, inf for a row without any."""
    return np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.inf for row in values])


def run(
    settings: Settings,
    person: str,
    model: Path,
    manifest: Path,
    detections: list[Path],
    identities: Path,
    standing: Path,
    body: Path,
    fit: Path,
) -> None:
    """Fit one person's body to the keypoints of all training cameras, or to the silhouettes in ``standing``."""
    cameras = {c.name: c for c in read_model(model.parent)}
    footage = read_manifest(manifest)
    for someone in read_standing(standing):
        if someone.name == person:
            fitted = fit_standing(someone, list(cameras.values()), BodyModel.load(body), footage.frames, footage.fps, settings)
            _say_filled(fitted)
            write_person(fit, fitted)
            return
    seen = [read_detections(path) for path in detections]
    missing = [d.camera for d in seen if d.camera not in cameras]
    if missing:
        raise Refusal(f"camera {missing[0]} has detections but is not in the camera model {model.parent}")
    body_model = BodyModel.load(body)
    whose = read_identities(identities)
    names, keypoints = observations(person, seen, whose, body_model, footage.frames)
    points = lift(names, keypoints, [cameras[d.camera] for d in seen], settings.triangulation, settings.fit.unverified_sigma_m)
    surface = None
    if settings.fit.vertex_weight > 0:
        surface = surface_of(
            person, seen, whose, [cameras[d.camera] for d in seen], body_model, footage.frames, settings.triangulation,
            settings.fit.unverified_sigma_m,
        )  # fmt: skip
    fitted, result = fit_person(person, points, body_model, footage.fps, settings, surface)
    residual_mm, sigma_mm = 1000 * np.nanmedian(result.residual_m), 1000 * np.median(fitted.sigma[fitted.valid])
    say(
        f"{person}: body measured in {fitted.valid.sum()} of {footage.frames} frames, seen by up to {points.cameras.max()} cameras; "
        f"keypoints lie {residual_mm:.0f} mm from it (median), joints are known to {sigma_mm:.0f} mm, after "
        f"{result.iterations} steps"
    )
    if not result.converged:
        say(f"{person}: the fit was still improving after people.fit.iterations = {settings.fit.iterations} steps")
    _say_filled(fitted)
    ratio = limb_ratio(points, fitted, body_model)
    if abs(ratio - 1) > 0.05:
        say(f"{person}: measured limbs are {ratio:.2f} times the fitted ones; the world may not be metric, or the shape is unusual")
    write_person(fit, fitted)
