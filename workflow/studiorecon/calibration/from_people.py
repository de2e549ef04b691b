# SPDX-License-Identifier: Apache-2.0
"""``calibration.from_people``: cameras without a calibration, from people (the paper uses Pi3X)."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.calibration.known_lenses import ideal_pinhole, lens_at_pose, lenses_of_cameras, undistort_detections
from studiorecon.calibration.room_evidence import radial_lens, with_edges, with_floor
from studiorecon.calibration.room_pictures import read_room_pictures, without_distortion
from studiorecon.camera_files.raw_camera import check_focal_px
from studiorecon.errors import UserError
from studiorecon.estimate.intervals import camera_intervals
from studiorecon.footage.lens_metadata import focal_px_from_metadata
from studiorecon.geometry.lens import lens_with_pixel_map
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.progress import say, warn
from studiorecon.rig.agreement import AgreementLimits
from studiorecon.rig.estimate import estimate_rig
from studiorecon.rig.lens_knowledge import lens_knowledge
from studiorecon.rig.metric_scale import GivenLengths, stature_m
from studiorecon.rig.pose_consensus import PoseConsensus, find_pose_consensus, pose_distance
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.world_of_people import align_to_people
from studiorecon.scene.camera import Camera
from studiorecon.scene.clocks import Clocks, read_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.keypoint_verdict import read_keypoint_verdict
from studiorecon.scene.numbered_files import pictures_in
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

# Beyond so many times the accepted sigmas, bodies would be far from the people.
_HOPELESS = 6.0
_NO_LENGTHS = GivenLengths()
_MIN_CAMERAS = 2
_WOULD_HELP = (
    "let a person walk in view of it and another camera, or add a calibration; to leave it out, list the others "
    "under train: in capture.yaml"
)


@dataclass(frozen=True)
class PeopleRigSettings:
    """When cameras estimated from people are accepted.

    Attributes:
        frames: number of frames in use, spread over the clip.
        focal_sigma, focal_file_sigma, focal_unknown_sigma: sigma of a focal length, as a share: of a given one, of one
            in the file's metadata, and of an unknown one, which starts at a guess.
        max_focal_sigma: share up to which a focal length counts as determined by the people.
        max_sigma_deg, max_sigma_m: sigmas of rotation and position beyond which the cameras are marked as uncertain.
        rival_share: another solution for the cameras with this share of the support is reported, and the uncertainty
            covers it.
    """

    frames: int = 60
    focal_sigma: float = 0.005
    focal_file_sigma: float = 0.07
    focal_unknown_sigma: float = 0.3
    max_focal_sigma: float = 0.05
    max_sigma_deg: float = 1.0
    max_sigma_m: float = 0.06
    rival_share: float = 0.9


@dataclass(frozen=True)
class Settings(AgreementLimits):
    """When the cameras that people determine are accepted."""

    people_rig: PeopleRigSettings = PeopleRigSettings()


def pose_cameras(
    detections: Sequence[Detections],
    wh: Sequence[tuple[int, int]],
    focal_px: Mapping[str, float],
    frames: int,
    template_m: Float[np.ndarray, "12 3"],
    settings: Settings,
    metadata_px: Mapping[str, float] | None = None,
    given: GivenLengths = _NO_LENGTHS,
    stature: float = 1.7,
    edges: Mapping[str, Float[np.ndarray, "N 4"]] | None = None,
    rooms: Mapping[str, RoomPicture] | None = None,
    straight: Collection[str] = (),
) -> tuple[list[Camera], dict[str, Any]]:
    """Cameras in metres, z up, floor at 0, and a report; raises UserError when people show too little.

    ``focal_px``: given focal lengths by camera name; ``metadata_px``: those in the files' metadata. Others are
    estimated with the poses. ``given``: measured lengths; ``stature``: height of the mean body, metres. ``edges``:
    (N, 4) ends of the room's straight edges, pixels; ``rooms``: pictures of its floor. Cameras that are not
    ``straight`` distort: k1 of each is estimated too, and is in the report.
    """
    known = {**(metadata_px or {}), **focal_px}
    about = settings.people_rig
    found = find_pose_consensus(
        detections, wh, known, frames, about.frames, template_m, settings.gate_m, settings.limits, about.rival_share
    )
    start = None if found is None else [found.rig.cameras[v] for v in sorted(found.rig.cameras)]
    names = [c.name for c in start or []]
    sigma = {n: about.focal_sigma if n in focal_px else about.focal_file_sigma for n in known}
    knowledge = lens_knowledge(
        start or [], {n: (known[n], sigma[n]) for n in known}, straight, about.focal_unknown_sigma
    )
    allowed = template_m, settings.gate_m, settings.limits
    estimate = found and start and estimate_rig(start, np.zeros(len(start)), found.sightings, knowledge, *allowed)
    if not found or not estimate:
        raise UserError(
            "the cameras are undetermined: no two cameras see enough of one person at once to "
            "estimate their poses; check that the videos are synchronised, or bring a calibration"
        )
    estimate = with_edges(estimate, template_m, edges or {})
    estimate = with_floor(estimate, template_m, rooms or {})
    known_to = camera_intervals(estimate.solution)
    turn, place, between_deg = known_to.turn_deg, known_to.place_m, known_to.between_deg
    uncertain = _uncertain(names, focal_px, turn, place, known_to.focal, about)
    if found.rival is not None:
        degrees, metres = pose_distance(found.rival, estimate.cameras)
        turn, place = np.hypot(turn, degrees), np.hypot(place, metres)
        between_deg = float(np.hypot(between_deg, 2 * degrees.max()))
        uncertain.append(_of_two(found, degrees))
    if unplaced := [n for n in given.between if n in found.left_out]:
        uncertain.append(f"distance_m is measured from camera {unplaced[0]}, which is left out, so it gives no scale")
        given = replace(given, between=())
    cameras, how, scale = align_to_people(estimate, template_m, given, stature)
    rig = estimate.rig
    error = rig.points.error_px[:, rig.agreeing]
    median = float(np.median(error[np.isfinite(error)]))
    if median > settings.limit_px(estimate.cameras, rig.points.points_m[rig.agreeing]):
        raise UserError(
            f"the cameras are undetermined: the best solution has a median reprojection error of "
            f"{median:.0f} px; check that the videos are synchronised and that no camera moves"
        )
    marks = estimate.room.marks
    report = {
        "source": "people",
        "median_px": median,
        "support": rig.support,
        "frames": len(found.sightings.frames),
        "left_out": dict(found.left_out),
        "sigma_deg": dict(zip(names, turn.tolist())),
        "sigma_m": dict(zip(names, place.tolist())),
        "focal_px": {c.name: c.focal_px[0] for c in cameras},
        "focal_sigma": dict(zip(names, known_to.focal.tolist())),
        "radial_k1": dict(zip(names, estimate.radial.tolist())),
        "shared_m": estimate.noise.shared_m,
        "radial_sigma": dict(zip(names, known_to.radial.tolist())),
        "world": how,
        "points": int(rig.agreeing.sum()),
        "between_deg": between_deg,
        "uncertain": uncertain,
        "on_floor": {} if marks is None else {f"{names[a]} {names[b]}": n for (a, b), n in marks.seen_by.items()},
        "along_edges": {names[v]: turn.along for v, turn in estimate.room.turns.items()},
        "scale": scale.basis,
        "scale_sigma": scale.sigma,
        "focal_from": {n: "given" if n in focal_px else "the file" if n in known else "people" for n in names},
    }
    return cameras, report


def _uncertain(
    names: Sequence[str],
    given: Mapping[str, float],
    turn: np.ndarray,
    place: np.ndarray,
    focal: np.ndarray,
    settings: PeopleRigSettings,
) -> list[str]:
    """Sentences about parameters with too large a sigma; raises UserError where no film could be made."""
    found = []
    free = [(n, s) for n, s in zip(names, focal) if n not in given]
    unknown = [f"{n} ±{s:.0%}" for n, s in free if s > settings.max_focal_sigma]
    if unknown:
        found.append(
            f"the focal length of camera {', '.join(unknown)} is hardly determined; write "
            f"focal_px: {{camera: pixels}} into capture.yaml"
        )
    loose = turn / settings.max_sigma_deg + place / settings.max_sigma_m
    worst = int(np.argmax(loose))
    known = f"{names[worst]} is uncertain by ±{turn[worst]:.1f}° and ±{place[worst]:.2f} m"
    if turn.max() > settings.max_sigma_deg or place.max() > settings.max_sigma_m:
        found.append(
            f"camera {known} only: let a person walk across the whole floor, use more frames, or bring a calibration"
        )
    hopeless = turn.max() > _HOPELESS * settings.max_sigma_deg or place.max() > _HOPELESS * settings.max_sigma_m
    if hopeless or max((s for _, s in free), default=0.0) > _HOPELESS * settings.max_focal_sigma:
        raise UserError(f"the cameras are undetermined, and no film can be made of them: {'; '.join(found)}")
    return found


def mean_body(body: BodyModel) -> Float[np.ndarray, "12 3"]:
    """Stable keypoints of the body of mean shape, metres; adults' bones, and so the scale, differ by 5 %."""
    return body.keypoints(STABLE_KEYPOINTS, np.zeros((1, 72)), np.zeros(body.shapes), np.zeros((1, 3)))[0]


def _of_two(found: PoseConsensus, degrees: np.ndarray) -> str:
    """A sentence about two solutions that fit about equally well and differ by ``degrees`` (V,)."""
    assert found.rival is not None
    return (
        f"two solutions for the cameras fit the people about equally well ({found.rig.support} and "
        f"{found.rival.support} keypoints) and differ by {degrees.max():.0f}°; the likelier one is used, and its "
        "interval includes the other: let a person walk across the whole floor, use more frames, or bring a "
        "calibration"
    )


def _focal_px_from_files(cameras: Sequence[str], sources: Sequence[Path], size: Mapping[str, tuple[int, int]]) -> dict:
    """camera → focal length in its file's metadata, pixels of its footage; a folder's first picture counts."""
    found = {}
    for camera, source in zip(cameras, sources):
        pictures = pictures_in(source) if source.is_dir() else []
        path = pictures[0] if pictures else source
        if camera in size and path.is_file() and (focal := focal_px_from_metadata(path, size[camera])):
            found[camera] = focal
    return found


def run(
    settings: Settings,
    sightings: list[Path],
    sizes: list[Path],
    clocks: Path,
    body: Path,
    cameras: list[str],
    training: list[str],
    sources: list[Path],
    lenses: list[Path],
    focal_px: str,
    lengths: str,
    calibration: Written,
) -> None:
    """Estimate the cameras of ``sightings`` (npz, pixels of the videos whose ``sizes`` are JSON); write JSON.

    ``focal_px``: JSON, camera → focal length in pixels of the video, for as many cameras as the user knows; the
    metadata of the footage ``sources`` of ``cameras`` may hold others. ``lengths``: JSON, ``GivenLengths``.
    ``lenses``: files with lenses alone. Cameras whose poses people do not determine are missing in ``calibration``,
    with a message; raises UserError with fewer than two of ``training``.
    """
    common = read_clocks(clocks)
    if common.refusal:
        raise UserError(common.refusal)
    verdicts = [read_keypoint_verdict(path) for path in sizes]
    if refused := [v.refusal for v in verdicts if v.refusal]:
        raise UserError(refused[0])
    size_of = {v.camera: v.wh for v in verdicts}
    detections = _read_sightings(sightings, size_of, common, cameras)
    warn("there is no calibration: the cameras are estimated from people (calibration.source)")
    fitted = BodyModel.load(body)
    maps = {v.camera: v.pixel_map for v in verdicts}
    known = lenses_of_cameras(lenses, size_of, maps)
    detections = [
        undistort_detections(d, known[d.camera], size_of[d.camera]) if d.camera in known else d for d in detections
    ]
    given_px = {c: ideal_pinhole(lens, size_of[c]).focal_px[0] for c, lens in known.items()}
    given_px |= check_focal_px(json.loads(focal_px or "{}"), size_of)
    metadata_px = _focal_px_from_files(cameras, sources, size_of)
    measured = GivenLengths(**json.loads(lengths or "{}"))
    rooms = {
        c: without_distortion(room, known[c], ideal_pinhole(known[c], size_of[c])) if c in known else room
        for c, room in read_room_pictures(cameras, sources, size_of).items()
    }
    found, report = pose_cameras(
        detections,
        [size_of[d.camera] for d in detections],
        given_px,
        common.frames,
        mean_body(fitted),
        settings,
        metadata_px,
        measured,
        stature_m(fitted),
        {c: room.edges_px for c, room in rooms.items()},
        rooms,
        known,
    )
    if sum(c.name in training for c in found) < _MIN_CAMERAS:
        raise UserError(
            "people determine the poses of fewer than two training cameras: "
            + "; ".join(f"camera {n}: {why}" for n, why in report["left_out"].items())
            + "; check that the videos are synchronised, or bring a calibration"
        )
    notes, doubts = _notes(report), _doubts(report)
    for note in notes:
        say(note)
    for sentence in doubts:
        warn(sentence)
    # In the pixels of the footage's maps, so that all later steps read keypoints in the same ones.
    placed = [
        lens_at_pose(known[c.name], c)
        if c.name in known
        else lens_with_pixel_map(radial_lens(c, report["radial_k1"][c.name]), maps[c.name])
        for c in found
    ]
    content = {"source": "people", "format": "estimated from people", "lenses": [lens.as_json() for lens in placed]}
    write_json(calibration, {**content, "floor_known": True, "notes": notes, "doubts": doubts, "people_rig": report})


def _read_sightings(
    sightings: Sequence[Path], sizes: Mapping[str, tuple[int, int]], common: Clocks, cameras: Sequence[str]
) -> list[Detections]:
    """Keypoints on the common clock; raises UserError where there are none."""
    detections = [resample_keypoints(d, common, sizes[d.camera][1]) for d in map(read_detections, sightings)]
    if not any(len(d.frame) for d in detections):
        raise UserError(
            f"no person was detected in any camera ({common.frames} moments of "
            f"{', '.join(cameras)} were searched), and without a calibration, cameras are "
            "estimated from people only; add a calibration"
        )
    return detections


def _doubts(report: Mapping[str, Any]) -> list[str]:
    doubts = [f"uncertain cameras: {sentence}" for sentence in report["uncertain"]]
    for camera, why in report["left_out"].items():
        doubts.append(f"camera {camera} is left out of this reconstruction: {why}; {_WOULD_HELP}")
    return doubts


def _notes(report: Mapping[str, Any]) -> list[str]:
    return [
        f"the cameras were estimated from people in {report['frames']} frames: {report['median_px']:.1f} px median",
        f"uncertainty (95 %, the detector's errors included): ±{report['between_deg']:.1f}° for the rotation "
        f"between two cameras, ±{2 * max(report['sigma_m'].values()):.2f} m for positions",
        "turned by the room's edges: "
        + (
            ", ".join(f"{n} ({share:.0%} of their length)" for n, share in report["along_edges"].items())
            or "none, they do not run along three directions"
        ),
        f"matches on the floor: {sum(report['on_floor'].values()) or 'none'}",
        report["scale"],
        report["world"],
        "focal lengths: "
        + ", ".join(
            f"{n} {f:.0f} px ± {report['focal_sigma'][n]:.1%} (from {report['focal_from'][n]})"
            for n, f in report["focal_px"].items()
        ),
        "lens distortion k1: "
        + ", ".join(f"{n} {k1:.2f} ± {report['radial_sigma'][n]:.2f}" for n, k1 in report["radial_k1"].items()),
    ]
