# SPDX-License-Identifier: Apache-2.0
"""People who walk about in front of distorting cameras, as detectors with human errors report them: planted truth for
cameras without a calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from studiorecon.geometry.distortion import distort, fold_radius
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import in_coco, look_at

# Lengths of the mean body at 1.70 m between keypoints, metres: half the shoulders and hips, trunk, limbs.
SHOULDER, HIP, TRUNK, UPPER_ARM, LOWER_ARM, THIGH, SHANK = 0.156, 0.095, 0.503, 0.269, 0.246, 0.398, 0.397
ANKLE_M = 0.08


@dataclass(frozen=True)
class MadeCapture:
    """What ``made_capture`` plants and what detectors report of it.

    Attributes:
        cameras: true pinholes; ``radial``: (V,) their k1.
        detections: in distorted pixels.
        frames: of the capture.
    """

    cameras: list[Camera]
    radial: np.ndarray
    detections: list[Detections]
    frames: int


def walker(rng: np.random.Generator, frames: int, fps: float, lengths: np.ndarray, reach_m: float = 1.6) -> np.ndarray:
    """(T, 12, 3) stable keypoints of somebody who strolls within ``reach_m`` of the middle at about 1 m/s."""
    shoulder, hip, trunk, upper_arm, lower_arm, thigh, shank = lengths
    heading, at, turning = rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1, 2), 0.0
    found = np.empty((frames, 12, 3))
    for t in range(frames):
        turning = 0.9 * turning + rng.normal(0, 0.25)
        home = np.arctan2(-at[1], -at[0])
        if np.linalg.norm(at) > reach_m:
            turning += 0.8 * np.sin(home - heading)
        heading += turning * 3 / fps
        at = at + np.array([np.cos(heading), np.sin(heading)]) / fps
        phase, lean = 2 * np.pi * 0.9 * t / fps, 0.05 * np.sin(0.3 * t / fps)
        local = np.empty((6, 2, 3))
        for side, sign in enumerate((1.0, -1.0)):
            swing, bend = sign * 0.42 * np.sin(phase), 0.35 * (1 + np.sin(sign * phase + 1.5))
            local[3, side] = [0, sign * hip, 0]
            local[4, side] = local[3, side] + thigh * np.array([np.sin(swing), 0, -np.cos(swing)])
            local[5, side] = local[4, side] + shank * np.array([np.sin(swing - bend), 0, -np.cos(swing - bend)])
            local[0, side] = [trunk * np.sin(lean), sign * shoulder, trunk * np.cos(lean)]
            reach = -sign * 0.35 * np.sin(phase)
            local[1, side] = local[0, side] + upper_arm * np.array([np.sin(reach), 0.1 * sign, -np.cos(reach)])
            local[2, side] = local[1, side] + lower_arm * np.array([np.sin(reach + 0.5), 0, -np.cos(reach + 0.5)])
        local[..., 2] += ANKLE_M - local[5, :, 2].min()
        c, s = np.cos(heading), np.sin(heading)
        flat = local.reshape(12, 3) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
        found[t] = flat + np.append(at, 0.0)
    return found


def reported(
    camera: Camera,
    radial: float,
    people: list[np.ndarray],
    rng: np.random.Generator,
    noise_px: float = 2.5,
    shared_m: float = 0.015,
) -> Detections:
    """``people`` as a camera's detector reports them: 5 % of joints missing, 2 % elsewhere.

    Errors are ``noise_px`` in every frame, and ``shared_m`` that depends only on the joint and on the side from which
    the body is seen.
    """
    frames, tracks, keypoints = [], [], []
    for track, p in enumerate(rng.permutation(len(people))):
        joints = people[p]
        across = joints[:, 0] - joints[:, 1]
        seen_from = np.arctan2(across[:, 1], across[:, 0]) - np.arctan2(*(joints.mean(1) - camera.centre_m)[:, 1::-1].T)
        waves = np.stack([np.ones_like(seen_from), *(f(k * seen_from) for k in (1, 2) for f in (np.cos, np.sin))])
        shape = np.random.default_rng([int(1e6 * number) for number in np.abs(joints[0, :2]).ravel()])
        bias_m = np.einsum("kt,kjc->tjc", waves, shape.normal(0, shared_m / np.sqrt(3), (5, 12, 2)))
        pixels, depth = camera.project(joints)
        focal, principal = np.array(camera.focal_px), np.array(camera.principal_px)
        normal = (pixels - principal) / focal + bias_m / depth[..., None]
        coefficients = np.array([radial, 0, 0, 0, 0, 0, 0, 0])
        inside = np.linalg.norm(normal, axis=-1) < 0.98 * fold_radius("opencv", coefficients)
        pixels = distort(normal, "opencv", coefficients) * focal + principal
        pixels = pixels + rng.normal(0, noise_px, pixels.shape)
        wild = rng.random(pixels.shape[:2]) < 0.02
        pixels[wild] += rng.normal(0, 40, pixels.shape)[wild]
        inside &= (depth > 0.1) & (pixels >= 0).all(-1) & (pixels < camera.wh).all(-1)
        inside &= rng.random(inside.shape) > 0.05
        for t in np.flatnonzero(inside.sum(-1) >= 6):
            frames.append(t)
            tracks.append(track)
            keypoints.append(in_coco(np.where(inside[t, :, None], pixels[t], np.nan), inside[t]))
    order = np.argsort(frames, kind="stable")
    return Detections(
        camera.name,
        "coco17",
        np.array(frames, dtype=int)[order],
        np.array(tracks, dtype=int)[order],
        np.array(keypoints).reshape(-1, 17, 3)[order],
    )


def made_capture(
    seed: int,
    k1: float,
    similar: bool = True,
    views: int = 4,
    people: int = 1,
    seconds: float = 25.0,
    fps: float = 10.0,
    principal_share: float = 0.0,
    around: float = 1.0,
) -> MadeCapture:
    """Cameras around people who walk for ``seconds``; ``alike``: of one make, otherwise each has its own lens.

    Lenses of one make differ by 0.5 % in focal length and 0.005 in k1; principal points are off by ``principal_share``
    of the width (a standard deviation). ``around``: share of the circle that the cameras are on.
    """
    rng = np.random.default_rng([seed, 54])
    wh, frames = (1280, 720), int(seconds * fps)
    angles = 2 * np.pi * around * (np.arange(views) / views) + rng.uniform(-0.3, 0.3, views)
    hfov_deg = rng.uniform(60, 90) if similar else rng.uniform(60, 90, views)
    focal = np.broadcast_to(wh[0] / 2 / np.tan(np.radians(hfov_deg) / 2), views) * np.exp(rng.normal(0, 0.005, views))
    radial = k1 + rng.normal(0, 0.005 if similar else 0.06, views)
    cameras = []
    for v, angle in enumerate(angles):
        # From further away with a longer lens: the people stay in the picture.
        away = rng.uniform(3.4, 4.4) * max(1.0, focal[v] / 900)
        centre = np.array([away * np.cos(angle), away * np.sin(angle), rng.uniform(1.2, 2.4)])
        camera = look_at(f"c{v}", centre, np.append(rng.uniform(-0.3, 0.3, 2), 0.9), wh, focal[v])
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, 2] += rng.normal(0, principal_share * wh[0] if principal_share else 0.0, 2)
        cameras.append(replace(camera, intrinsics=intrinsics))
    usual = np.array([SHOULDER, HIP, TRUNK, UPPER_ARM, LOWER_ARM, THIGH, SHANK])
    lengths = [usual * np.exp(rng.normal(0, 0.02, len(usual))) for _ in range(people)]
    moving = [walker(rng, frames, fps, own) for own in lengths]
    seen = [reported(c, k, moving, rng) for c, k in zip(cameras, radial)]
    assert len(STABLE_KEYPOINTS) == moving[0].shape[1]
    return MadeCapture(cameras, np.asarray(radial), seen, frames)
