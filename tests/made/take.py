# SPDX-License-Identifier: Apache-2.0
"""The synthetic studio's play as its cameras' detectors see it, without filming it: exact cameras, noisy keypoints,
shuffled tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.tracking import TrackingLimits, drop_duplicates, track_ids
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import RESOURCES, DetectionOptions, read_description
from studiorecon.studio.detections import detect
from studiorecon.studio.room import build_room
from studiorecon.studio.tracing import Tracer

LAYOUT = "body_25"
TRACKING = TrackingLimits()


def made_take(
    frames: int = 60,
    people: int = 2,
    noise: DetectionOptions | None = None,
    seed: int = 0,
    still: bool = False,
    occluded: bool = True,
) -> tuple[list[Camera], list[Detections]]:
    """Four true cameras (1280 × 704, a ring) and what their detectors report of ``people`` in ``frames`` frames, 3 px
    noise by default.

    ``still`` people keep their pose of frame 0. ``occluded`` traces rays, so that furniture and people hide each other.
    """
    noise = noise or DetectionOptions(recorded=True, noise_px=3.0, drop_outs=0.0, false_positives=0.0, shuffled=True)
    described = read_description(RESOURCES / "studio" / "defaults.yaml")
    described = replace(
        described, frames=frames, size=(1280, 704), people=people, cameras=replace(described.cameras, held_out=0)
    )
    times_s = np.arange(frames) / described.fps
    cast = Actors(described, BodyModel.load(RESOURCES / "body.npz"), 0 * times_s if still else times_s)
    points_m = cast.keypoints_m(LAYOUTS[LAYOUT].keypoints)
    cameras, solids = rig.cameras(described), build_room(described.seed, 0.0)
    tracers = [
        Tracer(solids + cast.at(t)[0] if occluded else []) for t in range(frames if occluded and not still else 1)
    ]
    found = []
    for v, (camera, lens) in enumerate(zip(cameras, rig.true_lenses(described, cameras))):
        rng = np.random.default_rng([seed, v])
        frame, keypoints = [], []
        for t in range(frames):
            for person in detect(points_m[t], lens, tracers[min(t, len(tracers) - 1)], len(solids), noise, rng):
                frame.append(t)
                keypoints.append(np.where(person[:, 2:] > 0.1, person, [np.nan, np.nan, 0.0]))
        frames_seen, points = np.array(frame, dtype=int), np.array(keypoints).reshape(len(frame), -1, 3)
        keep = drop_duplicates(frames_seen, points, TRACKING)
        frames_seen, points = frames_seen[keep], points[keep]
        found.append(
            Detections(
                camera.name, LAYOUT, frames_seen, track_ids(frames_seen, points, TRACKING, described.fps), points
            )
        )
    return cameras, found


def after_similarity(found: list[Camera], truth: list[Camera]) -> tuple[np.ndarray, np.ndarray, float]:
    """Turn in degrees and distance in metres of every camera from the truth after the best similarity (Umeyama 1991),
    and its scale."""
    ours, true = np.array([c.centre_m for c in found]), np.array([c.centre_m for c in truth])
    x, y = ours - ours.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(y.T @ x)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = u @ sign @ vt, float((s * np.diag(sign)).sum() / (x**2).sum())
    turns = [a.camera_from_world[:3, :3] @ rotation.T @ b.camera_from_world[:3, :3].T for a, b in zip(found, truth)]
    degrees = np.degrees([2 * np.arcsin(min(1.0, np.linalg.norm(r - np.eye(3)) / np.sqrt(8))) for r in turns])
    return degrees, np.linalg.norm(scale * x @ rotation.T - y, axis=-1), scale
