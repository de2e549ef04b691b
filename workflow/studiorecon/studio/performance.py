# SPDX-License-Identifier: Apache-2.0
"""The play: each person's walk, waves and squats over time, as body poses at any moment.

Continuous in time, so that a camera with a clock offset films its true moment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.studio.gait import FootTrack, Path, bone_frame, foot_track, pelvis_distance, reach_knee

if TYPE_CHECKING:
    from jaxtyping import Float

NEVER = float("inf")
_TOE_OUT_RAD = np.radians(6)
_SQUAT_M, _SQUAT_BACK_M, _SQUAT_LEAN_RAD = 0.40, 0.19, np.radians(36)
_LEFT, _UP, _FORWARD = np.eye(3)


@dataclass(frozen=True)
class MotionPart:
    """One person's motion.

    Attributes:
        path: their walk; a path of length 0 is a place to stand.
        stride_m, cadence_hz: length of two steps, and how many of those a second.
        clock: position in the stride at the start of the clip.
        waves_s, squats_s: start times of the right hand's waves, and of squats.
    """

    path: Path
    stride_m: float
    cadence_hz: float
    clock: float
    waves_s: float
    squats_s: float


# The first walks a circle and begins to wave; the second crosses it, stops so that the first passes close behind, and
# squats.
PARTS = (
    MotionPart(Path((0.1, -0.1), 1.0, np.radians(270), -NEVER, NEVER), 1.18, 0.90, 0.10, 0.8, NEVER),
    MotionPart(Path((1.05, 0.68), 0.0, np.radians(214), -NEVER, 1.25), 1.16, 0.92, -0.10, NEVER, 1.35),
    MotionPart(Path((-1.75, -0.55), 0.0, np.radians(15), 0.0, 0.0), 1.2, 0.9, 0.0, 0.2, NEVER),
    MotionPart(Path((0.2, 1.75), 0.0, np.radians(260), 0.0, 0.0), 1.2, 0.9, 0.0, NEVER, 0.2),
)


def random_betas(seed: int, number: int) -> Float[np.ndarray, " 10"]:
    """Betas of one person: people alternate between tall and short, the rest is drawn within one standard deviation."""
    rng = np.random.default_rng([seed, 21, number])
    betas = np.clip(rng.normal(0, 0.5, 10), -1, 1)
    betas[0] = (0.75, -0.55, 0.3, -0.9)[number]
    return betas


def perform(
    part: MotionPart, body: BodyModel, betas: Float[np.ndarray, " 10"], times_s: Float[np.ndarray, " T"]
) -> tuple[Float[np.ndarray, "T 72"], Float[np.ndarray, "T 3"]]:
    """Poses axis-angle and pelvis positions of one person at the given moments."""
    clock = part.clock + part.cadence_hz * times_s
    feet = [foot_track(clock, phase, part.stride_m, part.path) for phase in (0.0, 0.5)]
    walking = _smooth_amplitude(part, clock)
    squat = _squat(times_s - part.squats_s)
    wave = _ease((times_s - part.waves_s) / 0.5) * (times_s >= part.waves_s)
    distance = pelvis_distance(clock, part.stride_m, part.path)
    ground, heading = part.path.at(distance)
    swing = np.cos(2 * np.pi * clock) * walking

    lean = np.radians(4) * walking + _SQUAT_LEAN_RAD * squat
    twist = np.radians(5) * swing
    world_from_upright = _upright(heading)
    root = world_from_upright @ _turn(_UP, -twist) @ _turn(_LEFT, lean)

    rest = body.rest_joints(betas)
    ankles, foot_frames, toes = _feet(part, feet, rest, _sole(body, betas))
    forward, left = world_from_upright[:, :, 2], world_from_upright[:, :, 0]
    weight_shift = 0.018 * np.sin(2 * np.pi * (clock - 0.06)) * walking
    pelvis = np.zeros((len(times_s), 3))
    pelvis[:, :2] = ground + weight_shift[:, None] * left[:, :2] - (_SQUAT_BACK_M * squat)[:, None] * forward[:, :2]
    pelvis[:, 2] = _pelvis_height(pelvis, root, rest, ankles, squat)

    local = np.broadcast_to(np.eye(3), (len(times_s), 24, 3, 3)).copy()
    local[:, 0] = root
    for side, (hip, knee, ankle, toe) in enumerate(((1, 4, 7, 10), (2, 5, 8, 11))):
        thigh, shin = rest[knee] - rest[hip], rest[ankle] - rest[knee]
        hip_m = pelvis + (root @ (rest[hip] - rest[0]))
        # Knees point with the toes, a little outwards when squatting.
        outward = (1, -1)[side] * (0.10 + 0.35 * squat)[:, None] * left
        knee_m, hinge = reach_knee(
            hip_m, ankles[side], _length(thigh), _length(shin), foot_frames[side][:, :, 2] + forward + outward
        )
        hip_global = bone_frame(knee_m - hip_m, hinge) @ bone_frame(thigh, _LEFT).T
        knee_global = bone_frame(ankles[side] - knee_m, hinge) @ bone_frame(shin, _LEFT).T
        local[:, hip] = _transpose(root) @ hip_global
        local[:, knee] = _transpose(hip_global) @ knee_global
        local[:, ankle] = _transpose(knee_global) @ foot_frames[side] @ _turn(_LEFT, feet[side].pitch_rad)
        local[:, toe] = _turn(_LEFT, toes[side])
    _upper_body(local, times_s, swing, twist, lean, squat, wave, walking)
    return rotations.log(local).reshape(len(times_s), 72), pelvis


def _upper_body(
    local: np.ndarray,
    times_s: np.ndarray,
    swing: np.ndarray,
    twist: np.ndarray,
    lean: np.ndarray,
    squat: np.ndarray,
    wave: np.ndarray,
    walking: np.ndarray,
) -> None:
    """Fill spine, head and arms of the local rotations (T, 24, 3, 3) in place."""
    breath = np.radians(0.8) * np.sin(2 * np.pi * 0.27 * times_s)
    for joint, share in ((3, 0.5), (6, 0.6), (9, 0.7)):
        local[:, joint] = _turn(_UP, share * 1.3 * twist) @ _turn(_LEFT, breath * share - 0.12 * lean)
    for joint in (12, 15):
        local[:, joint] = _turn(_UP, -0.15 * twist) @ _turn(_LEFT, -0.38 * lean + breath)
    waving = np.sin(2 * np.pi * 1.6 * times_s)
    for sign, collar, shoulder, elbow, wrist, raised in ((1, 13, 16, 18, 20, 0 * wave), (-1, 14, 17, 19, 21, wave)):
        # Hanging: the arm points down and a little out; walking swings it against the leg of its side.
        reach = sign * swing * np.radians(24) - np.radians(72) * squat - np.radians(4) * walking
        hang = _turn(_LEFT, reach) @ _turn(_FORWARD, np.full_like(reach, -sign * np.radians(74)))
        bend = np.radians(16) + np.radians(12) * walking - sign * swing * np.radians(9)
        hanging_elbow = _turn(_UP, -sign * bend)
        # Raised: the upper arm level and forward, the forearm up, swaying from side to side.
        raise_arm = _turn(_UP, np.full_like(reach, -sign * np.radians(22))) @ _turn(
            _FORWARD, np.full_like(reach, sign * np.radians(8))
        )
        raised_elbow = _turn(_FORWARD, sign * (np.radians(82) + np.radians(22) * waving))
        local[:, collar] = _turn(_FORWARD, sign * np.radians(6) * raised)
        local[:, shoulder] = rotations.slerp(hang, raise_arm, raised)
        local[:, elbow] = rotations.slerp(hanging_elbow, raised_elbow, raised)
        local[:, wrist] = _turn(_UP, sign * raised * np.radians(14) * waving) @ _turn(
            _FORWARD, sign * np.radians(6) * (1 - raised)
        )


def _feet(
    part: MotionPart, feet: list[FootTrack], rest: np.ndarray, sole: tuple[float, float]
) -> tuple[list, list, list]:
    """Ankle positions (T, 3), flat foot frames world_from_body (T, 3, 3) and toe bends (T,), left foot first."""
    sole_height, heel_forward = sole
    ankles, frames, toes = [], [], []
    for side, (track, ankle, toe) in enumerate(zip(feet, (7, 8), (10, 11))):
        sign = (1, -1)[side]
        # Distance of the feet from the path.
        print_m, heading = part.path.at(track.distance_m, sign * 0.085)
        flat = _upright(heading + sign * _TOE_OUT_RAD)
        down = sole_height - rest[ankle, 1]
        ball = np.array([0.0, down, rest[toe, 2] - rest[ankle, 2]])
        heel = np.array([0.0, down, heel_forward - rest[ankle, 2]])
        pivot = np.where((track.pitch_rad > 0)[:, None], ball, heel)
        turned = np.einsum("tij,tj->ti", _turn(_LEFT, track.pitch_rad), pivot)
        ankle_m = np.concatenate([print_m, (track.lift_m - down)[:, None]], axis=1) + np.einsum(
            "tij,tj->ti", flat, pivot - turned
        )
        ankles.append(ankle_m)
        frames.append(flat)
        toes.append(-np.maximum(track.pitch_rad, 0))
    return ankles, frames, toes


def _pelvis_height(
    pelvis: np.ndarray, root: np.ndarray, rest: np.ndarray, ankles: list[np.ndarray], squat: np.ndarray
) -> np.ndarray:
    """(T,) as high as both legs allow, slightly bent, and lower by the squat: a smooth minimum over the two legs."""
    heights = []
    for hip, knee, ankle, ankle_m in ((1, 4, 7, ankles[0]), (2, 5, 8, ankles[1])):
        longest = 0.992 * (_length(rest[knee] - rest[hip]) + _length(rest[ankle] - rest[knee]))
        offset = root @ (rest[hip] - rest[0])
        away = np.linalg.norm(ankle_m[:, :2] - pelvis[:, :2] - offset[:, :2], axis=1)
        away = np.minimum(away, 0.6 * longest)
        heights.append(ankle_m[:, 2] + np.sqrt(longest**2 - away**2) - offset[:, 2])
    softness_m = 0.012
    return -softness_m * np.logaddexp(-heights[0] / softness_m, -heights[1] / softness_m) - _SQUAT_M * squat


def _smooth_amplitude(part: MotionPart, clock: np.ndarray) -> np.ndarray:
    """(T,) share of a full stride, smoothed over half a stride."""
    shifts = np.linspace(-0.3, 0.3, 13)
    tracks = [foot_track(clock + s, phase, part.stride_m, part.path).amplitude for s in shifts for phase in (0.0, 0.5)]
    return np.mean(tracks, axis=0)


def _squat(since_s: np.ndarray) -> np.ndarray:
    """(T,) depth 0..1: down and up again within 2.4 s, repeatedly."""
    return np.where(since_s > 0, 0.5 - 0.5 * np.cos(2 * np.pi * np.where(since_s > 0, since_s, 0) / 2.4), 0.0)


def _sole(body: BodyModel, betas: np.ndarray) -> tuple[float, float]:
    """Height of the soles and forward position of the heels in the shaped rest pose, body axes."""
    vertices = body.rest_vertices(betas)
    feet = vertices[vertices[:, 1] < vertices[:, 1].min() + 0.02]
    return float(feet[:, 1].min()), float(feet[:, 2].min())


def _upright(heading_rad: np.ndarray) -> np.ndarray:
    """(T, 3, 3) world_from_body of a body upright in the z-up world."""
    c, s, zero = np.cos(heading_rad), np.sin(heading_rad), np.zeros_like(heading_rad)
    rows = [np.stack([-s, zero, c], -1), np.stack([c, zero, s], -1), np.stack([zero, zero + 1, zero], -1)]
    return np.stack(rows, axis=-2)


def _turn(axis: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations about one body axis."""
    return rotations.exp(np.asarray(angle_rad)[:, None] * axis)


def _ease(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def _length(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))


def _transpose(matrices: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrices, -1, -2)
