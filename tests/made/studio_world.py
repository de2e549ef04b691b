# SPDX-License-Identifier: Apache-2.0
"""A made scene in which one effect at a time is planted: a textured box room, cameras on a ring, somebody who walks in
a circle.

Everything is an exact function of the ray, so nothing but what is planted departs from the model: noise of 1 grey level
in pictures and of 2 px (at 1280 wide) in keypoints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.rig.body_points import Tracks
from studiorecon.scene.camera import Camera
from studiorecon.survey.clips import Film
from studiorecon.survey.evidence import SurveyInput
from studiorecon.survey.exposures import ExposureView

from tests.made.cameras import look_at

FPS, FRAMES = 30.0, 100
WH, FOCAL_PX = (288, 192), 165.0
HALF_M, HEIGHT_M = 4.0, 3.0
NAMES = LAYOUTS["body_25"].keypoints
PICTURES = np.r_[0:6, 47:53, 94:100]
NOISE_LEVELS, KEYPOINT_NOISE = 1.0, 2.0 / 1280
# What "planted" means for each effect: about two to three times the threshold, in its own unit.
PLANTED: Mapping[str, dict] = {
    "moving_cameras": {"shift_px": 0.8},
    "people": {"people": 0},
    "hands": {"film_px": 10.0},
    "exposure": {"gain": 1.03},
    "changing_light": {"light": 0.06},
    "defocus": {"edges": 0.12, "blur_px": 1.2},
    "closed_path": {"azimuths_deg": (0, 40, 80, 120)},
    "view_synthesis": {"azimuths_deg": tuple(range(0, 360, 24)), "focal_px": 120.0},
    "view_dependent_colour": {"specularity": 0.5},
    "moving_shadows": {"shadow": 0.3},
    "dynamic_objects": {"ball_px": 7.0},
}
# What other steps estimate and take out, and no effect is: lens, clock, readout.
OTHERWISE: Mapping[str, dict] = {"lens": {"k1": 0.06}, "clock": {"lag_frames": 0.5}, "readout": {"readout": 0.9}}


@dataclass(frozen=True)
class Plan:
    """What is planted; the defaults are none of it."""

    azimuths_deg: tuple[float, ...] = (5, 95, 185, 275)
    focal_px: float = FOCAL_PX
    working_px: int = WH[0]
    people: int = 1
    speed_m_s: float = 1.5
    shift_px: float = 0.0
    gain: float = 1.0
    light: float = 0.0
    k1: float = 0.0
    lag_frames: float = 0.0
    readout: float = 0.0
    specularity: float = 0.0
    shadow: float = 0.0
    ball_px: float = 0.0
    edges: float = 0.0
    blur_px: float = 0.0
    film_px: float = 1.0
    known_depth: bool = True
    texture: float = 1.0


def cameras_of(plan: Plan) -> list[Camera]:
    scale = plan.working_px / WH[0]
    wh = (plan.working_px, round(WH[1] * scale))
    turn = np.radians(plan.azimuths_deg)
    return [
        look_at(
            f"c{i}", np.array([3 * np.cos(a), 3 * np.sin(a), 1.7]), np.array([0, 0, 0.9]), wh, plan.focal_px * scale
        )
        for i, a in enumerate(turn)
    ]


def surface(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Points (h, w, 3) of the room and depth (h, w) seen by a camera inside the box."""
    origin, rays = camera.rays()
    low, high = np.array([-HALF_M, -HALF_M, 0.0]), np.array([HALF_M, HALF_M, HEIGHT_M])
    with np.errstate(divide="ignore"):
        far = np.maximum((low - origin) / rays, (high - origin) / rays)
    depth = far.min(axis=-1)
    return origin + depth[..., None] * rays, depth


def paint(points: np.ndarray, rng_seed: int, texture: float, edges: float = 0.0) -> np.ndarray:
    """(h, w, 3) colours of room points: waves of 2 m down to 0.4 m, and tiles of 0.6 m that differ by ``edges``."""
    rng = np.random.default_rng([rng_seed, 1])
    colour = np.full(points.shape, 0.45)
    for length_m, height in ((2.0, 0.1), (1.0, 0.06), (0.4, 0.03)):
        for _ in range(3):
            wave = rng.normal(size=3)
            wave *= 2 * np.pi / length_m / np.linalg.norm(wave)
            colour += texture * height * np.sin((points @ wave)[..., None] + rng.uniform(0, 6, 3))
    # Off the walls' own planes, where rounding would choose the tile.
    tile = np.floor((points + 0.131) / 0.6).sum(axis=-1, keepdims=True) % 2
    return colour + edges * (tile - 0.5)


def out_of_focus(picture: np.ndarray, plan: Plan, view: int) -> np.ndarray:
    """The picture of the third camera, which alone is blurred by ``blur_px`` of a width of 288."""
    if not plan.blur_px or view != 2:
        return picture
    return cv2.GaussianBlur(picture, (0, 0), plan.blur_px * picture.shape[1] / WH[0])


def highlight(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(h, w) how much of a lamp below the ceiling the floor mirrors towards a camera at ``centre``."""
    lamp = np.array([0.4, -0.3, 2.8])
    half = _unit(_unit(lamp - points) + _unit(centre - points))
    return np.where(points[..., 2] < 1e-6, half[..., 2] ** 12, 0.0)


def walk(plan: Plan, seed: int, times: np.ndarray) -> np.ndarray:
    """(N, J, 3) joints at ``times`` (N,) in frames, of somebody who walks a circle of 1 m and swings every limb a
    little."""
    rng = np.random.default_rng([seed, 2])
    rest = np.stack(
        [rng.uniform(-0.25, 0.25, len(NAMES)), rng.uniform(-0.25, 0.25, len(NAMES)), rng.uniform(0.3, 1.7, len(NAMES))],
        -1,
    )
    height = {"ankle": 0.1, "wrist": 0.95, "nose": 1.6, "heel": 0.03, "toe": 0.03}
    for joint, name in enumerate(NAMES):
        rest[joint, 2] = next((z for part, z in height.items() if part in name), rest[joint, 2])
    phase, swing = rng.uniform(0, 6, len(NAMES)), rng.uniform(0.02, 0.1, (len(NAMES), 3))
    turn = rng.uniform(0, 6) + plan.speed_m_s / FPS * times
    middle = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    return middle[:, None] + rest + swing * np.sin(0.25 * plan.speed_m_s * times[:, None] + phase)[..., None]


def seen_keypoints(plan: Plan, seed: int, cameras: list[Camera]) -> Tracks:
    """What a detector that errs by 2 px (at 1280) sees in every camera, with the planted lens, clock and readout in the
    last one."""
    rng = np.random.default_rng([seed, 3])
    times = np.arange(FRAMES, dtype=float)
    pixels = np.full((len(cameras), plan.people, FRAMES, len(NAMES), 2), np.nan)
    for view, camera in enumerate(cameras):
        for person in range(plan.people):
            last = view == len(cameras) - 1
            moment = np.repeat(times[:, None], len(NAMES), axis=1) + (plan.lag_frames if last else 0.0)
            for _ in range(3 if last and plan.readout else 1):
                flat = walk(plan, seed + person, moment.reshape(-1)).reshape(FRAMES, len(NAMES), len(NAMES), 3)
                points = flat[:, np.arange(len(NAMES)), np.arange(len(NAMES))]
                there = camera.project(points)[0]
                if last and plan.readout:
                    moment = times[:, None] + plan.lag_frames + plan.readout * (there[..., 1] / camera.wh[1] - 0.5)
            if last and plan.k1:
                normal = (there - camera.principal_px) / camera.focal_px
                there = (
                    normal * (1 + plan.k1 * (normal**2).sum(-1, keepdims=True)) * camera.focal_px + camera.principal_px
                )
            pixels[view, person] = there + rng.normal(0, KEYPOINT_NOISE * max(camera.wh), there.shape)
    inside = np.isfinite(pixels).all(-1) & (pixels > 0).all(-1) & (pixels < np.array(cameras[0].wh)).all(-1)
    return Tracks(np.where(inside[..., None], pixels, np.nan), np.where(inside, 0.9, 0.0), tuple(NAMES))


def scene(seed: int, **planted: object) -> SurveyInput:
    """A scene with what is ``planted`` (names of ``Plan``)."""
    plan = replace(Plan(), **planted)
    rng = np.random.default_rng([seed, 4])
    cameras = cameras_of(plan)
    tracks = seen_keypoints(plan, seed, cameras)
    views, films = [], []
    for view, camera in enumerate(cameras):
        points, depth = surface(camera)
        plate = _empty(plan, seed, camera, view, points)
        noisy = np.clip(plate + rng.normal(0, NOISE_LEVELS / 255 / 4, plate.shape), 0, 1).astype(np.float32)
        known = np.ones(camera.hw, bool)
        depth = depth if plan.known_depth else 0 * depth
        views.append(ExposureView(camera, noisy, known, depth.astype(np.float32)))
        films.append(_film(plan, seed, camera, view, rng, (points, plate) if camera.wh == WH else None))
    people = [f"p{i}" for i in range(plan.people)]
    return SurveyInput(cameras, people, views, films, tracks, 0.0, FPS, [plan.film_px] * len(cameras))


def _empty(plan: Plan, seed: int, camera: Camera, view: int, points: np.ndarray) -> np.ndarray:
    """(h, w, 3) the room without anybody, whose ``points`` (h, w, 3) a camera sees."""
    gain = plan.gain if view == 1 else 1.0
    plate = paint(points, seed, plan.texture, plan.edges)
    return out_of_focus((plate + plan.specularity * highlight(points, camera.centre_m)[..., None]) * gain, plan, view)


def _film(
    plan: Plan,
    seed: int,
    camera: Camera,
    view: int,
    rng: np.random.Generator,
    seen: tuple[np.ndarray, np.ndarray] | None,
) -> Film:
    """What a camera films; ``seen`` are the points of the room and the empty picture, where it has that size."""
    small = camera.resized(WH)
    points = surface(small)[0] if seen is None else seen[0]
    empty = _empty(plan, seed, small, view, points) if seen is None else seen[1]
    pictures, free = [], []
    floor = points[..., 2] < 1e-6
    for t in PICTURES:
        picture = empty * (1 + plan.light * np.sin(0.05 * t))
        covered = np.zeros((WH[1], WH[0]), np.uint8)
        for person in range(plan.people):
            joints = walk(plan, seed + person, np.array([float(t)]))[0]
            if plan.shadow:
                beside = joints.mean(axis=0) + np.array([0.5, 0.2, 0])
                distance = np.hypot(points[..., 0] - beside[0], points[..., 1] - beside[1])
                picture = picture * (1 - plan.shadow * floor * np.clip(2 - 4 * distance, 0, 1))[..., None]
            there, z = small.project(joints)
            if np.isfinite(there).all() and (z > 0.3).all():
                hull = cv2.convexHull(np.rint(there).astype(np.int32))
                body = cv2.fillConvexPoly(np.zeros_like(covered), hull, 1)
                picture[body > 0] = 0.6, 0.3, 0.2
                covered |= cv2.dilate(body, np.ones((9, 9), np.uint8))
        if plan.ball_px and view < 2:
            ball = cv2.circle(
                np.zeros_like(covered),
                (30 + 4 * int(t) % 220, 30 + int(12 * np.sin(0.4 * t))),
                int(plan.ball_px),
                1,
                -1,
            )
            picture[ball > 0] = 0.9, 0.2, 0.1
        if plan.shift_px and view == 2 and t > 20:
            move = np.array([[1, 0, plan.shift_px], [0, 1, 0]], float)
            picture = cv2.warpAffine(picture, move, WH, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        noisy = picture * 255 + NOISE_LEVELS * rng.standard_normal(picture.shape, np.float32)
        pictures.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        free.append(covered == 0)
    return Film(small, PICTURES, np.stack(pictures), np.stack(free), camera.wh[0] / WH[0])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
