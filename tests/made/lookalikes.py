# SPDX-License-Identifier: Apache-2.0
"""Pictures of people in the synthetic studio: posters, screens, mirrors; and an animal. Filmed as a capture is, and
looked at as one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, MASK_PX
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import detect_people, keypoints_with_confidence
from studiorecon.footage.video import write_lossless
from studiorecon.geometry.rotations import exp, log
from studiorecon.keypoints.detections import detections_from_detector
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people import associate
from studiorecon.people.association.acceptance import TrackVerdict, identities_from_keypoints
from studiorecon.people.association.rejected_people import RejectedPerson
from studiorecon.people.pictures.coverage import CameraEvidence
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections, write_raw_detections
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import RESOURCES, Description, read_description
from studiorecon.studio.film import render_frame, touched_pixels, trace_backdrop
from studiorecon.studio.meshes import Mesh, box, lathe, plain_texture, pose_on_floor, transform_points
from studiorecon.studio.room import build_room
from studiorecon.studio.sensor import Sensor, develop
from studiorecon.studio.tracing import Tracer
from studiorecon.tracks import keypoints as tracks_keypoints

from tests.defaults import loaded

FPS, SECONDS = 12.0, 2.0
# Where a picture of somebody stands: opposite the arc of cameras, facing its middle.
PLACE_M, FACING_RAD = np.array([-1.45, -1.45, 0.0]), np.radians(45.0)
_PIECES = 40
SEAT_M = (-0.9, 0.6, 0.45)
Extra = Callable[[int], list[Mesh]]


def described(people: int) -> Description:
    """Four cameras on an arc of 120°, so that all of them see one side of a thing; the first ``people`` of the play."""
    whole = read_description(RESOURCES / "studio" / "defaults.yaml")
    cameras = replace(whole.cameras, layout="arc", arc_deg=120.0, held_out=0)
    frames = round(FPS * SECONDS)
    return replace(
        whole, seed=4, frames=frames, fps=FPS, size=(640, 360), supersampling=1, people=people, cameras=cameras
    )


@dataclass(frozen=True)
class Looked:
    """What was made of a film: detections per camera, a verdict per track, and who was left out.

    ``owners``: (camera, track) → number of the true person whose limbs the track lies on, -1 for none of them.
    """

    detections: list[Detections]
    verdicts: dict[tuple[str, int], TrackVerdict]
    left_out: list[RejectedPerson]
    owners: dict[tuple[str, int], int]

    @property
    def people(self) -> set[str]:
        return {verdict.person for verdict in self.verdicts.values() if verdict.person}

    def named(self, owner: int) -> set[str]:
        """Names of the tracks that lie on a true person, or (-1) on none."""
        return {self.verdicts[key].person for key, whose in self.owners.items() if whose == owner} - {""}

    @property
    def reasons(self) -> str:
        return "; ".join(one.reason for one in self.left_out)


def looked_at(
    people: int,
    extra: Extra,
    still: Sequence[Mesh],
    folder: Path,
    root: Path,
    changed: Callable[[Actors], None] = lambda cast: None,
) -> Looked:
    """Film the play, ``changed``, with ``still`` and moving ``extra`` things (frame → solids) in the room, detect and
    associate."""
    about = described(people)
    cameras = rig.cameras(about)
    lenses = rig.true_lenses(about, cameras)
    cast = Actors(about, BodyModel.load(RESOURCES / "body.npz"), np.arange(about.frames) / about.fps)
    changed(cast)
    files = [root / "resources/detector" / name for name in ("movenet_multipose.onnx", "pose_landmark_full.onnx")]
    detector, found, witnesses, videos = DetectorFiles(files).detector(), [], [], []
    for camera, lens in zip(cameras, lenses):
        pictures = filmed(about, lens, cast, extra, still)
        videos.append(folder / f"{camera.name}.mkv")
        write_lossless(videos[-1], pictures, FPS)
        rows = [
            (
                t,
                keypoints_with_confidence(one, camera.wh, {"visibility": [0.0, 1.0], "confidence": [0.0, 1.0]}),
                one.presence,
                one.points_m,
                one.mask,
                one.region.crop_from_picture(MASK_PX),
            )
            for t, seen in enumerate(detect_people(pictures, detector, FPS))
            for one in seen
        ]
        raw = RawDetections.of(camera.name, LAYOUT, LANDMARKS, rows, [(0, about.frames)], "made")
        write_raw_detections(folder / f"{camera.name}.npz", raw)
        footage = Footage(
            *(camera.name, False, camera.wh, camera.intrinsics.tolist(), FPS, about.frames, 0, "", "", camera.wh),
            *(0, 0.0, []),
        )
        found.append(detections_from_detector(raw, lens, footage, loaded(tracks_keypoints.Settings)))
        witnesses.append(CameraEvidence(lens, footage, folder / f"{camera.name}.npz"))
    options = loaded(associate.Settings)
    limits = options.association, options.triangulation
    table, _, left = identities_from_keypoints(*limits, cameras, found, videos, about.frames, FPS, witnesses)
    true_m = np.stack([cast.body.joints(a.poses, a.betas, a.trans_m) for a in cast.actors]) if people else None
    return Looked(found, table, left, owners_of(found, cameras, true_m))


def owners_of(found: Sequence[Detections], cameras: Sequence[Camera], true_m: np.ndarray | None) -> dict:
    """(camera, track) → the true person (P, T, 24, 3) within a tenth of whose height its points lie, -1 = nobody."""
    names = {"shoulder": (16, 17), "hip": (1, 2), "knee": (4, 5)}
    columns = [LAYOUTS[LAYOUT].keypoints.index(f"{side}_{n}") for n in names for side in ("left", "right")]
    joints = [j for pair in names.values() for j in pair]
    owners = {}
    for d, camera in zip(found, cameras):
        for track in np.unique(d.track):
            mine = d.track == track
            best = -1
            for p in range(0 if true_m is None else len(true_m)):
                pixels = camera.project(true_m[p][:, joints])[0][d.frame[mine]]
                gap = np.linalg.norm(d.keypoints[mine][:, columns, :2] - pixels, axis=-1)
                height = np.ptp(camera.project(true_m[p])[0][d.frame[mine]][..., 1], axis=1)
                if np.nanmedian(gap / height[:, None]) < 0.1:
                    best = p
            owners[d.camera, int(track)] = best
    return owners


def filmed(about: Description, lens: Lens, cast: Actors, extra: Extra, still: Sequence[Mesh]) -> list[np.ndarray]:
    """(H, W, 3) uint8 pictures of one camera."""
    solids = [*build_room(about.seed, 0.0), *still]
    scene, soles = trace_backdrop(lens, solids, about.supersampling), cast.soles_m()
    pictures = []
    for t in range(about.frames):
        moving = [*cast.at(t)[0], *extra(t)]
        touched = touched_pixels(lens, moving)
        light = render_frame(scene, Tracer(solids + moving), moving, touched, soles[t], about.effects)
        pictures.append(develop(light, Sensor.perfect(), t))
    return pictures


def keeping_still(cast: Actors) -> None:
    """The second of the play stands as at its beginning, all the time."""
    actor, count = cast.actors[1], len(cast.times_s)
    poses, places = np.repeat(actor.poses[:1], count, axis=0), np.repeat(actor.trans_m[:1], count, axis=0)
    cast.actors[1] = replace(actor, poses=poses, trans_m=places)


def sitting(cast: Actors) -> None:
    """The second of the play sits on a ``stool``, and breathes at most."""
    keeping_still(cast)
    actor = cast.actors[1]
    local = exp(actor.poses.reshape(-1, 24, 3))
    c, s = np.cos(FACING_RAD), np.sin(FACING_RAD)
    local[:, 0] = np.array([[-s, 0, c], [c, 0, s], [0, 1, 0]])
    for hip, knee, ankle in ((1, 4, 7), (2, 5, 8)):
        local[:, hip], local[:, knee], local[:, ankle] = (
            exp(np.array([angle, 0.0, 0.0])) for angle in (-1.5, 1.45, 0.05)
        )
    seat = np.array([*SEAT_M[:2], SEAT_M[2] + 0.09])
    poses = log(local).reshape(len(local), 72)
    cast.actors[1] = replace(actor, poses=poses, trans_m=np.repeat(seat[None], len(local), axis=0))


def portrait(number: int, time_s: float) -> np.ndarray:
    """(600, 400, 3) linear light: a picture of somebody of the play, head to foot, from the front."""
    about = replace(described(number + 1), frames=1)
    cast = Actors(about, BodyModel.load(RESOURCES / "body.npz"), np.array([time_s]))
    actor = replace(cast.actors[number], number=0)
    cast.actors = [actor]
    root = exp(actor.poses[0, :3])
    forward = (root @ [0, 0, 1.0]) * [1, 1, 0]
    forward /= np.linalg.norm(forward)
    centre = actor.trans_m[0] + 2.6 * forward
    right = np.cross(-forward, [0, 0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(-forward, right), -forward])
    pose[:3, 3] = -pose[:3, :3] @ np.array([centre[0], centre[1], 0.95])
    size = 400, 600
    intrinsics = np.array([[720.0, 0, size[0] / 2], [0, 720.0, size[1] / 2], [0, 0, 1]])
    lens = Lens("portrait", size, intrinsics, "opencv", np.zeros(5), pose, np.eye(2, 3))
    solids = build_room(about.seed, 0.0)
    scene = trace_backdrop(lens, solids, 1)
    moving = cast.at(0)[0]
    return render_frame(
        scene, Tracer(solids + moving), moving, touched_pixels(lens, moving), cast.soles_m()[0], about.effects
    )


def panel(picture: np.ndarray, height_m: float, above_m: float, glow: float = 0.0, mirror: float = 0.0) -> Mesh:
    """A flat thing at ``PLACE_M`` that shows ``picture`` (h, w, 3; linear light) in its own proportions."""
    width_m = height_m * picture.shape[1] / picture.shape[0]
    across = np.array([-np.sin(FACING_RAD), np.cos(FACING_RAD), 0.0])
    left = PLACE_M + np.array([0, 0, above_m]) - width_m / 2 * across
    # In small pieces: the film looks again at what is near the vertices of things that move.
    steps = np.linspace(0, 1, _PIECES + 1)
    corners = np.array([left + x * width_m * across + [0, 0, z * height_m] for z in steps for x in steps])
    first = (np.arange(_PIECES)[:, None] * (_PIECES + 1) + np.arange(_PIECES)).ravel()
    other = first + _PIECES + 1
    faces = np.concatenate([np.stack([first, first + 1, other + 1], 1), np.stack([first, other + 1, other], 1)])

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        # Seen from the front the picture's left is on the left.
        columns = np.clip((points - left) @ across / width_m, 0, 1 - 1e-9) * picture.shape[1]
        rows = np.clip(1 - (points[:, 2] - above_m) / height_m, 0, 1 - 1e-9) * picture.shape[0]
        return picture[rows.astype(int), columns.astype(int)]

    return Mesh("panel", corners, faces, paint, np.eye(4), emission=glow, mirror=mirror)


def stool() -> Mesh:
    """What ``sitting`` sits on."""
    return box(
        "stool",
        (0.4, 0.4, SEAT_M[2]),
        pose_on_floor((SEAT_M[0], SEAT_M[1], 0.0), FACING_RAD),
        plain_texture((0.2, 0.3, 0.1)),
    )


def dog(position_m: tuple[float, float], heading_rad: float, stride: float) -> list[Mesh]:
    """A large dog on four legs, 0.75 m at the shoulder; ``stride`` in [-1, 1] swings its legs."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    fur, dark = plain_texture((0.30, 0.18, 0.08)), plain_texture((0.10, 0.06, 0.03))

    def part(profile: list[tuple[float, float]], start: list[float], along: list[float], paint) -> Mesh:
        """A lathe whose axis goes from ``start`` along a direction, in the dog's own axes (x forward)."""
        axis = np.array(along) / np.linalg.norm(along)
        side = np.cross([0, 1, 0] if abs(axis[1]) < 0.9 else [1, 0, 0], axis)
        side /= np.linalg.norm(side)
        frame = np.eye(4)
        frame[:3, :3] = turn @ np.stack([side, np.cross(axis, side), axis], axis=1)
        frame[:3, 3] = turn @ np.array(start) + [*position_m, 0]
        straight = lathe("dog", profile, np.eye(4), paint, segments=24)
        return replace(straight, vertices_m=transform_points(straight.vertices_m, frame), world_from_solid=frame)

    trunk = [(0.0, 0.0), (0.13, 0.05), (0.16, 0.3), (0.14, 0.6), (0.17, 0.8), (0.0, 0.92)]
    leg = [(0.0, 0.0), (0.075, 0.02), (0.05, 0.3), (0.035, 0.52), (0.045, 0.56), (0.0, 0.58)]
    head = [(0.0, 0.0), (0.11, 0.05), (0.10, 0.16), (0.05, 0.24), (0.04, 0.34), (0.0, 0.36)]
    ear = [(0.0, 0.0), (0.045, 0.01), (0.0, 0.14)]
    solids = [
        part(trunk, [-0.5, 0, 0.62], [1, 0, 0.05], fur),
        part([(0.09, 0.0), (0.08, 0.32), (0.0, 0.34)], [0.36, 0, 0.68], [0.55, 0, 0.8], fur),
        part(head, [0.52, 0, 0.98], [1, 0, -0.15], fur),
        part(ear, [0.56, 0.07, 1.05], [-0.2, 0.3, 1], dark),
        part(ear, [0.56, -0.07, 1.05], [-0.2, -0.3, 1], dark),
        part([(0.0, 0.0), (0.03, 0.05), (0.02, 0.4), (0.0, 0.45)], [-0.48, 0, 0.68], [-0.8, 0.1, 0.5], dark),
    ]
    for k, (x, y) in enumerate(((0.3, 0.1), (0.3, -0.1), (-0.38, 0.1), (-0.38, -0.1))):
        swing = 0.35 * stride * (1 if k in (0, 3) else -1)
        solids.append(part(leg, [x, y, 0.58], [swing, 0, -1], fur))
    return solids
