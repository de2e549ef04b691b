# SPDX-License-Identifier: Apache-2.0
"""``cameras.uncalibrated``: cameras without any calibration, from the people they saw (not in the paper, which asks Pi3X)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.cameras.certainty import between_deg, sigma_of
from studiorecon.cameras.correspondences import spread_frames
from studiorecon.cameras.people_rig import Rig, adjusted, bone_factor, rigs, scaled, settled, sightings
from studiorecon.cameras.standing_world import world_from_people
from studiorecon.errors import Refusal
from studiorecon.geometry.bundle import Adjusted, LensPrior
from studiorecon.geometry.correspondence import STABLE_KEYPOINTS
from studiorecon.geometry.lens import mapped_lens
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.scene.retiming import on_common_clock

# Widths of view that are tried when nobody says: phones, action cameras, webcams, tele ends.
_HFOV_DEG = (65.0, 85.0, 48.0, 105.0, 36.0)
_SELF_CALIBRATION_ROUNDS = 6
_SETTLED_SHARE = 0.002
_SAME_DEG = 5.0
_WIDER = (1.0, 2.0)
# So many times the accepted standard deviations, and the bodies are not where the people were.
_HOPELESS = 6.0


@dataclass(frozen=True)
class PeopleRigSettings:
    """When cameras found from people are believed.

    Attributes:
        frames: frames that are looked at, spread over the clip.
        focal_sigma: standard deviation of a given focal length, as a share; an unknown one starts at a guess with ``focal_unknown_sigma``.
        focal_unknown_sigma: as above.
        max_focal_sigma: share up to which a focal length counts as determined by the people.
        max_sigma_deg, max_sigma_m: standard deviations of turn and place past which the cameras are marked as uncertain.
        rival_share: another arrangement of the cameras with this share of the support makes them undetermined.
    """

    frames: int
    focal_sigma: float
    focal_unknown_sigma: float
    max_focal_sigma: float
    max_sigma_deg: float
    max_sigma_m: float
    rival_share: float


@dataclass(frozen=True)
class Settings:
    """The section ``cameras`` as far as this step reads it; ``refine_gate_m``, ``max_error_share`` and ``limits`` as in ``refine``."""

    refine_gate_m: float
    max_error_share: float
    limits: Limits
    people_rig: PeopleRigSettings


def pose_cameras(
    detections: Sequence[Detections],
    wh: Sequence[tuple[int, int]],
    focal_px: Mapping[str, float],
    frames: int,
    template_m: np.ndarray,
    settings: Settings,
) -> tuple[list[Camera], dict[str, Any]]:
    """Cameras in metres, z up, floor at 0, and a report; raises Refusal with "undetermined" when people show too little.

    ``focal_px``: given focal lengths by camera name; the others are found along with the poses, or kept as guessed when the
    people do not determine them.
    """
    names = [d.camera for d in detections]
    chosen = spread_frames(frames, settings.people_rig.frames)
    guesses = _HFOV_DEG if len(focal_px) < len(names) else _HFOV_DEG[:1]
    best: list[Rig] = []
    seen = sightings(detections, chosen, settings.limits.min_confidence)
    # Real detectors are off by more than one error unit more often than made ones: a second, wider look where the first fails.
    for hfov, wider in [(hfov, wider) for wider in _WIDER for hfov in guesses]:
        start = [_pinhole(n, size, focal_px.get(n), hfov) for n, size in zip(names, wh)]
        limits = replace(settings.limits, huber_share=settings.limits.huber_share * wider)
        found = rigs(seen, start, template_m, settings.refine_gate_m, limits)
        if found and (not best or (len(found[0].cameras), found[0].support) > (len(best[0].cameras), best[0].support)):
            best = found
        if best and len(best[0].cameras) == len(names):
            break
    _complete(best, names)
    _no_rival(best, names, settings.people_rig)
    # Given focal lengths are pulled towards their value at every round; unknown ones are free.
    sigma = settings.people_rig.focal_sigma if len(focal_px) == len(names) else settings.people_rig.focal_unknown_sigma
    rig, result = _self_calibrated(best[0], seen, template_m, sigma, settings)
    turn, place, focal_sigma = sigma_of(rig, result, LensPrior(sigma, 0.0), settings.limits)
    uncertain = _uncertain(names, focal_px, turn, place, focal_sigma, settings.people_rig)
    cameras, points, how = _settled_in_the_world(result, rig, template_m)
    error = rig.points.error_px[:, rig.points.verified if len(names) > 2 else rig.points.valid]
    median = float(np.median(error[np.isfinite(error)]))
    if median > settings.max_error_share * max(max(s) for s in wh):
        raise Refusal(
            f"the cameras are undetermined: the best arrangement leaves people {median:.0f} px off; check that the videos are synchronised "
            "and that no camera moves"
        )
    report = {
        "source": "people",
        "median_px": median,
        "support": rig.support,
        "frames": len(chosen),
        "sigma_deg": dict(zip(names, turn.tolist())),
        "sigma_m": dict(zip(names, place.tolist())),
        "focal_px": {c.name: c.focal_px[0] for c in cameras},
        "focal_sigma": dict(zip(names, focal_sigma.tolist())),
        "world": how,
        "points": points,
        "between_deg": between_deg(turn),
        "uncertain": uncertain,
    }
    return cameras, report


def _uncertain(
    names: Sequence[str], given: Mapping[str, float], turn: np.ndarray, place: np.ndarray, focal: np.ndarray, settings: PeopleRigSettings
) -> list[str]:
    """What is known worse than it should be, in sentences; raises Refusal where no film could be made of it."""
    found = []
    free = [(n, s) for n, s in zip(names, focal) if n not in given]
    unknown = [f"{n} ±{s:.0%}" for n, s in free if s > settings.max_focal_sigma]
    if unknown:
        found.append(
            f"the focal length of camera {', '.join(unknown)} is hardly determined; write focal_px: {{camera: pixels}} into capture.yaml"
        )
    loose = turn / settings.max_sigma_deg + place / settings.max_sigma_m
    worst = int(np.argmax(loose))
    known = f"{names[worst]} is known to ±{turn[worst]:.1f}° and ±{place[worst]:.2f} m"
    if turn.max() > settings.max_sigma_deg or place.max() > settings.max_sigma_m:
        found.append(f"camera {known} only: let somebody walk all over the floor, use more frames, or bring a calibration")
    hopeless = turn.max() > _HOPELESS * settings.max_sigma_deg or place.max() > _HOPELESS * settings.max_sigma_m
    if hopeless or max((s for _, s in free), default=0.0) > _HOPELESS * settings.max_focal_sigma:
        raise Refusal(f"the cameras are undetermined, and no film can be made of them: {'; '.join(found)}")
    return found


def mean_body(body: BodyModel) -> np.ndarray:
    """(12, 3) stable keypoints of the body of mean shape, metres: adults' bones differ from it by about 5 %, and so may the scene."""
    return body.keypoints(STABLE_KEYPOINTS, np.zeros((1, 72)), np.zeros(body.shapes), np.zeros((1, 3)))[0]


def _pinhole(name: str, wh: tuple[int, int], focal_px: float | None, hfov_deg: float) -> Camera:
    focal = focal_px or 0.5 * max(wh) / np.tan(np.radians(hfov_deg) / 2)
    return Camera(name, wh, np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]]), np.eye(4))


def _complete(found: Sequence[Rig], names: Sequence[str]) -> None:
    if not found:
        raise Refusal(
            "the cameras are undetermined: no two cameras see enough of one person at once to find out where they stand; check that the "
            "videos are synchronised, or bring a calibration"
        )
    missing = [n for v, n in enumerate(names) if v not in found[0].cameras]
    if missing:
        raise Refusal(
            f"camera {', '.join(missing)} is undetermined: it shares too little of any person with the others; leave it out with "
            "train: [...] in capture.yaml, or bring a calibration"
        )


def _no_rival(found: Sequence[Rig], names: Sequence[str], settings: PeopleRigSettings) -> None:
    for other in found[1:]:
        if len(other.cameras) < len(names) or other.support < settings.rival_share * found[0].support:
            continue
        turned = [_relative_turn(found[0], other, v) for v in range(1, len(names))]
        if max(turned) > _SAME_DEG:
            raise Refusal(
                f"the cameras are undetermined: two arrangements fit the people about equally well ({found[0].support} and {other.support} "
                f"keypoints) and differ by {max(turned):.0f}°; use more frames, or bring a calibration"
            )


def _relative_turn(first: Rig, second: Rig, view: int) -> float:
    a = first.cameras[view].camera_from_world[:3, :3] @ first.cameras[0].camera_from_world[:3, :3].T
    b = second.cameras[view].camera_from_world[:3, :3] @ second.cameras[0].camera_from_world[:3, :3].T
    return float(np.degrees(angle(a, b)))


def _self_calibrated(rig: Rig, seen: Any, template_m: np.ndarray, focal_sigma: float, settings: Settings) -> tuple[Rig, Adjusted]:
    """Poses and focal lengths together, with the groups formed anew after every change, until the focal lengths stay."""
    result, _ = adjusted(rig, LensPrior(focal_sigma, 0.0), settings.limits)
    for _ in range(_SELF_CALIBRATION_ROUNDS):
        before = np.array([rig.cameras[v].focal_px[0] for v in sorted(rig.cameras)])
        after = np.array([c.focal_px[0] for c in result.cameras])
        again = settled(seen, dict(enumerate(result.cameras)), template_m, settings.refine_gate_m, settings.limits)
        if again is None:
            break
        rig = again
        if np.abs(after / before - 1).max() < _SETTLED_SHARE:
            break
        result, _ = adjusted(rig, LensPrior(focal_sigma, 0.0), settings.limits)
    return rig, adjusted(rig, LensPrior(focal_sigma, 0.0), settings.limits)[0]


def _settled_in_the_world(result: Adjusted, rig: Rig, template_m: np.ndarray) -> tuple[list[Camera], int, str]:
    used = rig.points.verified if len(result.cameras) > 2 else rig.points.valid
    points = np.full_like(rig.points.points_m, np.nan)
    points[used] = result.points_m
    factor = bone_factor(points, rig.points, rig.seen, template_m) or 1.0
    found = world_from_people(points * factor, rig.seen.group, rig.seen.frame, rig.seen.keypoint)
    if found is None:
        raise Refusal(
            "nobody was seen from ankles to shoulders, so nothing says which way is up; set the cameras back, or bring a calibration"
        )
    world_from_rig, how = found
    cameras = []
    for camera in result.cameras:
        pose = scaled(camera, factor).camera_from_world @ np.linalg.inv(world_from_rig)
        cameras.append(replace(camera, camera_from_world=pose))
    return cameras, int(used.sum()), how


def run(settings: Settings, sightings: list[Path], sizes: list[Path], clocks: Path, body: Path, focal_px: str, calibration: Path) -> None:
    """Pose the cameras of ``sightings`` (npz, pixels of the videos whose ``sizes`` are JSON); write ``calibration`` (JSON).

    ``focal_px``: JSON, camera → focal length in pixels of the video, for as many cameras as the user knows.
    """
    common = read_clocks(clocks)
    if common.refusal:
        raise Refusal(common.refusal)
    size_of = {v["camera"]: (int(v["wh"][0]), int(v["wh"][1])) for v in map(read_json, sizes)}
    detections = [on_common_clock(d, common, size_of[d.camera][1]) for d in map(read_detections, sightings)]
    wh = [size_of[d.camera] for d in detections]
    if blind := [d.camera for d in detections if not len(d.frame)]:
        raise Refusal(f"camera {', '.join(blind)} sees nobody, and without a calibration cameras can only be found from people")
    warn("there is no calibration: the cameras are found from the people (cameras.source)")
    cameras, report = pose_cameras(detections, wh, json.loads(focal_px or "{}"), common.frames, mean_body(BodyModel.load(body)), settings)
    notes = [
        f"the cameras were found from people in {report['frames']} frames: {report['median_px']:.1f} px median",
        f"the rotation between any two cameras is known to ±{report['between_deg']:.1f}°, places to "
        f"±{2 * max(report['sigma_m'].values()):.2f} m (95 %, a detector's own errors counted in)",
        "lengths come from people's bones, taken to be those of the mean body: all of them may "
        "be 5 % off; set cameras.scale after measuring one",
        report["world"],
        "focal lengths: " + ", ".join(f"{n} {f:.0f} px ± {report['focal_sigma'][n]:.1%}" for n, f in report["focal_px"].items()),
    ]
    for note in notes:
        say(note)
    for sentence in report["uncertain"]:
        warn(f"uncertain cameras: {sentence}")
    notes += [f"UNCERTAIN: {sentence}" for sentence in report["uncertain"]]
    # In the pixels that the footage's maps speak of, so that everybody after this reads keypoints in the same ones.
    maps = {v["camera"]: v.get("pixel_map") for v in map(read_json, sizes)}
    lenses = [
        mapped_lens(Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)), maps[c.name])
        for c in cameras
    ]
    content = {"source": "people", "format": "found from people", "lenses": [lens.as_json() for lens in lenses]}
    write_json(calibration, {**content, "floor_known": True, "notes": notes, "people_rig": report})
