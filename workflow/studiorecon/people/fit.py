# SPDX-License-Identifier: Apache-2.0
"""One person's body over time: fits the body model to the triangulated keypoints of all cameras, fills gaps, smooths.

Paper §fitting and appendix (smoothing). Shape is shared over the sequence (U39). The world is in metres, so no scale is
estimated unless ``scale`` requests the paper's s* per person (Eq. 3). The ratio of measured to fitted limbs is reported
as a check (U36).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.body.fitting import fit as fitting
from studiorecon.body.fitting import paper_solver
from studiorecon.body.fitting.hands import HandFit, attach_hands, fit_hand
from studiorecon.body.hands import scale_hands
from studiorecon.body.model import BodyModel, of_size
from studiorecon.body.person_files import write_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.keypoints.resampling import correct_rolling_shutter
from studiorecon.people.fit_settings import HandSettings, SmoothingSettings, TriangulationSettings
from studiorecon.people.fitting.hands import person_hands
from studiorecon.people.fitting.legs import bend_hidden_legs
from studiorecon.people.fitting.limbs import body_scale, limb_ratio
from studiorecon.people.fitting.points import (
    Points,
    detector_offset_m,
    person_keypoints,
    triangulate_hands,
    triangulate_keypoints,
)
from studiorecon.people.fitting.presence import fill_gaps, presence, true_runs
from studiorecon.people.fitting.surface_points import triangulate_surface
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import Detections, Person, read_detections, read_identities, split_tracks
from studiorecon.scene.readouts import read_readouts
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool

# Share of the fitted frames that must be near their keypoints; chance agreements of wrong points pass in an eighth of
# them.
_MIN_PLAUSIBLE = 0.5


_FITTED = {f.name for f in fields(fitting.FitSettings)}


@dataclass(frozen=True)
class BodyFit:
    """Settings of the body's fit; see ``body/fitting/fit.FitSettings`` for all between ``solver`` and
    ``unverified_sigma_m``.

    Attributes:
        unverified_sigma_m: sigma added to points that only two cameras agree on: their residual proves nothing (T13).
        max_frame_m: frames whose median point is further from the body count as not measured.
        max_beta: sigmas from the mean shape beyond which the points are no person's, or the lengths no metres.
    """

    solver: Literal["levenberg_marquardt", "paper"] = setting(
        "levenberg_marquardt",
        "levenberg_marquardt; paper = the paper's loss, each frame alone.",
        paper="paper; U38",
        paper_value="paper",
    )
    iterations: int = setting(
        30,
        "Maximum number of steps; converges after about 6.",
        minimum=1,
        maximum=1000,
        paper="30; U38",
        paper_value=30,
    )
    tolerance: float = 0.0001
    point_sigma_m: float = 0.008
    correction_sigma_m: float = 0.015
    huber_units: float = 3.0
    pose_weight: float = 1.0
    limit_weight: float = 1.0
    beta_weight: float = setting(
        1.0, "Weight of the mean-shape prior in every frame.", above=0, paper="10; U39", paper_value=10.0
    )
    vertex_weight: float = setting(
        0.5,
        "Weight of surface points relative to keypoints, for sources of bodies.",
        minimum=0,
        maximum=1,
        paper="a vertex weighs as much as a joint; U33",
        paper_value=1.0,
    )
    vertices: int = setting(
        100,
        "Surface points of such sources; 0 = all vertices.",
        minimum=0,
        paper="all, Eq. 4; U33",
        paper_value=0,
    )
    shape: Literal["shared", "per_frame"] = setting(
        "shared", "One shape for all frames, or one per frame.", paper="per_frame; U39", paper_value="per_frame"
    )
    scale: Literal["none", "bones"] = setting(
        "none",
        "bones = scale the body model per person from bone lengths first.",
        paper="bones: s* per person, Eq. 3; U36",
        paper_value="bones",
    )
    rolling_shutter: bool = setting(
        True,
        "Correct keypoints for rolling shutter where both halves of the clip show it.",
        paper="not treated",
        paper_value=False,
    )
    unverified_sigma_m: float = 0.03
    max_frame_m: float = 0.15
    max_beta: float = 5.0


@dataclass(frozen=True)
class Settings(HandSettings, TriangulationSettings, SmoothingSettings):
    """How points are computed, fitted and smoothed."""

    fit: BodyFit = setting(BodyFit(), "Fit of the body to the triangulated keypoints.")


def fit_person(
    person: str,
    points: Points,
    body: BodyModel,
    fps: float,
    settings: Settings,
    surface: fitting.SurfacePoints | None = None,
    hands: Sequence[Points] | None = None,
) -> tuple[Person, fitting.Fit]:
    """The person in all frames, and the fit before gaps were filled; raises UserError when no frame could be measured.

    ``surface``: triangulated surface points, where a source gives bodies (paper: the vertex term; U33). ``hands``: the
    left and the right hand's points, where cameras show them.
    """
    frames = len(points.points_m)
    keys = settings.fit
    if not (points.cameras >= 2).any():
        raise UserError(
            f"person {person} is never seen by two cameras in the same frame (frames 0–{frames - 1}); correct {person} "
            "in a copy of people/identities.tsv in the capture's folder, or leave the name empty there"
        )
    options = fitting.FitSettings(
        **{f.name: getattr(keys, f.name) for f in fields(keys) if f.name in _FITTED}, free_scale=False
    )
    size = body_scale(person, points, body) if keys.scale == "bones" else 1.0
    solve = paper_solver.fit if keys.solver == "paper" else fitting.fit
    own_body = body if size == 1.0 else body.scaled(size)
    result = solve(own_body, points.names, points.points_m, points.sigma_m, options, surface)
    if not result.valid.any():
        raise UserError(
            f"person {person}: no frame of 0–{frames - 1} has enough keypoints on which "
            "two cameras agree; check the calibration (cameras/refinement.png), or correct the identities in a copy "
            "of people/identities.tsv in the capture's folder"
        )
    median = _row_median(result.residual_m)
    valid = result.valid & (median <= keys.max_frame_m)
    if valid.sum() < _MIN_PLAUSIBLE * result.valid.sum():
        raise UserError(
            f"person {person}: the body is more than {keys.max_frame_m:g} m off the keypoints in "
            f"{result.valid.sum() - valid.sum()} of {result.valid.sum()} frames; check the keypoint layout, "
            "calibration and identities"
        )
    worst = int(np.argmax(np.abs(result.betas)))
    if abs(result.betas[worst]) > keys.max_beta:
        raise UserError(
            f"person {person}: the fitted shape is {result.betas[worst]:.1f} deviations from the mean (beta "
            f"{worst}, frames {frame_ranges(valid)}), which is no human shape; check that the calibration is in "
            "metres, the keypoint layout and the identities"
        )
    betas = result.betas if size == 1.0 else of_size(result.betas, size)
    local, bent = bend_hidden_legs(result.rotations, result.trans_m, betas, points.names, points.points_m, body)
    if (valid[:, None] & bent).any():
        say(
            f"{person}: no camera shows the legs in {(valid & bent.any(1)).sum()} frames: they are bent as if "
            "sitting, so that they stay above the floor, and sigma marks them as a guess"
        )
    sigma_m, scale = result.joint_sigma_m, None
    if hands is not None and body.fingers is not None:
        measured = [np.where(valid[:, None, None], hand.points_m, np.nan) for hand in hands]
        fits = [fit_hand(body, betas, side, at, hands[side].sigma_m, options) for side, at in enumerate(measured)]
        report_hands(person, fits)
        if any(fits):
            local, sigma_m, scale = attach_hands(body, betas, local, result.trans_m, sigma_m, fits)
    parts = local, result.trans_m, betas, valid, points.cameras > 0, sigma_m
    return _person(person, *parts, body, fps, settings, scale), result


def _person(
    name: str,
    local: np.ndarray,
    trans_m: np.ndarray,
    betas: np.ndarray,
    valid: np.ndarray,
    seen: np.ndarray,
    sigma_m: np.ndarray,
    body: BodyModel,
    fps: float,
    settings: Settings,
    hand_scale: np.ndarray | None,
) -> Person:
    """The person with the frames that are not ``valid`` filled, smoothed and posed.

    ``sigma_m`` (T, J) counts where valid; J is 54 with a ``hand_scale``. A camera has the person in frames that are
    ``seen`` (T,).
    """
    present = presence(valid, seen, fps)
    local, trans = settings.smooth.smooth_body(*fill_gaps(local, trans_m, valid, present), fps)
    poses = rotations.log(local).reshape(len(valid), -1)
    skeleton = body if hand_scale is None else scale_hands(body, hand_scale)
    joints = skeleton.joints(poses, betas, trans)
    sigma = np.where(valid[:, None], sigma_m, np.inf)
    fingers = {"hand_poses": poses[:, 72:], "hand_joints": joints[:, 24:], "hand_sigma": sigma[:, 24:]}
    return Person(
        name=name,
        body=body.identity,
        fps=fps,
        poses=poses[:, :72],
        trans=trans,
        betas=betas,
        joints=joints[:, :24],
        valid=valid,
        sigma=sigma[:, :24],
        metric=True,
        present=present,
        **({} if hand_scale is None else fingers | {"hand_scale": hand_scale}),
    )


def report_hands(person: str, fits: Sequence[HandFit | None]) -> None:
    """Log in how many frames each hand was measured, and how well."""
    for side, hand in zip(("left", "right"), fits):
        if hand:
            residual_mm, sigma_mm = (1000 * np.nanmedian(a[hand.valid]) for a in (hand.residual_m, hand.sigma_m))
            say(
                f"{person}: {side} fingers measured in {hand.valid.sum()} of {len(hand.valid)} frames; points are "
                f"{residual_mm:.0f} mm from them (median), joints have a standard deviation of {sigma_mm:.0f} mm"
            )


def report_filled_frames(fitted: Person) -> None:
    """Log the frames in which a person's pose is interpolated, and those in which they are absent."""
    guessed = fitted.present & ~fitted.valid
    if guessed.any():
        say(f"{fitted.name}: frames {frame_ranges(guessed)} are interpolated and marked not valid")
    if not fitted.present.all():
        say(
            f"{fitted.name}: no camera determines the position in frames {frame_ranges(~fitted.present)}, in which the "
            "person is not drawn"
        )


def frame_ranges(chosen: Bool[np.ndarray, " T"]) -> str:
    """``"3–5, 9"``: the frames where ``chosen`` is true."""
    return ", ".join(f"{first}–{last}" if last > first else f"{first}" for first, last in true_runs(chosen))


def _row_median(values: np.ndarray) -> np.ndarray:
    """(T,) median of each row's finite entries, inf for a row without any."""
    return np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.inf for row in values])


def run(
    settings: Settings,
    person: str,
    model: Path,
    manifest: Path,
    detections: list[Path],
    identities: list[Path],
    readouts: list[Path],
    body: Path,
    fit: Written,
) -> None:
    """Fit one person's body to the keypoints of all training cameras.

    ``identities`` holds the person's tracks, ``readouts`` the cameras' readouts, if any.
    """
    footage, body_model, whose = read_manifest(manifest), BodyModel.load(body), read_identities(identities[0])
    seen, cameras = _read_observed(detections, model, readouts, footage.fps)
    seen = [split_tracks(found, whose) for found in seen]
    names, keypoints = person_keypoints(person, seen, whose, body_model, footage.frames)
    limits, sigma_m = settings.triangulation, settings.fit.unverified_sigma_m
    points = triangulate_keypoints(names, keypoints, cameras, limits, sigma_m, detector_offset_m(names, seen))
    surface = None
    if settings.fit.vertex_weight > 0:
        about = footage.frames, limits, sigma_m, settings.fit.vertices
        surface = triangulate_surface(person, seen, whose, cameras, body_model, *about)
    film_px = [footage.of(c.name).film_px for c in cameras]
    hands = person_hands(person, seen, whose, cameras, film_px, footage.frames, settings.hands, footage.fps)
    fingers = None if hands is None else triangulate_hands(hands, cameras, limits)
    fitted, result = fit_person(person, points, body_model, footage.fps, settings, surface, fingers)
    residual_mm, sigma_mm = 1000 * np.nanmedian(result.residual_m), 1000 * np.median(fitted.sigma[fitted.valid])
    say(
        f"{person}: body measured in {fitted.valid.sum()} of {footage.frames} frames, seen by up to "
        f"{points.cameras.max()} cameras; keypoints are {residual_mm:.0f} mm from it (median), joints have a "
        f"standard deviation of {sigma_mm:.0f} mm, after {result.iterations} steps"
    )
    if not result.converged:
        say(f"{person}: the fit was still improving after people.fit.iterations = {settings.fit.iterations} steps")
    report_filled_frames(fitted)
    ratio = limb_ratio(points, fitted, body_model)
    if abs(ratio - 1) > 0.05:
        say(
            f"{person}: measured limbs are {ratio:.2f} times the fitted ones; the world may "
            "not be metric, or the shape is unusual"
        )
    write_person(fit, fitted)


def _read_observed(
    detections: Sequence[Path], model: Path, readouts: Sequence[Path], fps: float
) -> tuple[list[Detections], list[Camera]]:
    """Detections corrected for rolling shutter, and the camera of each."""
    cameras = {c.name: c for c in read_model(model.parent)}
    seen = [read_detections(path) for path in detections]
    if missing := [d.camera for d in seen if d.camera not in cameras]:
        raise UserError(f"camera {missing[0]} has detections but is not in the camera model {model.parent}")
    if readouts:
        took_s = read_readouts(readouts[0], [d.camera for d in seen])
        seen = [correct_rolling_shutter(d, took_s[d.camera], cameras[d.camera].wh[1], fps) for d in seen]
    return seen, [cameras[d.camera] for d in seen]
